"""The exported controller in closed loop for 3 s: in double precision the EMT's own run, in single close to it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.compilers import require_compiler
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.export.compiled import STRICT, run_compiler
from vsgdesign.operating_point.plant import plant_step
from vsgdesign.parameters import Study, study_from_text
from vsgdesign.simulation import GainChange, Simulation, simulate

CASES = ("hoang2025_5kva", "lab_12kva_lcl", "utility_1mva_60hz")
"""Without and with a sample of delay, LC and LCL, 50 and 60 Hz, 5 kVA to 1 MVA; the last one with a notch."""
DURATION, STEP_AT, RETUNED_AT = 3.0, 0.5, 1.5


def scenario(case: str) -> tuple[Study, list[GainChange]]:
    """From 30 to 50 % of rated power, then other gains."""
    text = f"""
base = "case:{case}"
controllers = [{{ name = "fixed", kind = "fixed", structure = "angle_damped" }}]
power_loops = {{ power_filter = "{"notch" if case == CASES[-1] else "low_pass"}" }}
simulation = {{ duration = "{DURATION} s", bridge = "averaged", P_ref = "0 W", Q_ref = "0 var" }}
"""
    bare = study_from_text(text)
    S, V, omega = bare.converter.S_rated, bare.converter.V_rated_rms, bare.converter.omega_n
    study = bare.with_changes(simulation={"P_ref": f"{0.3 * S} W", "Q_ref": f"{0.1 * S} var"})
    study = study.with_events({"time": f"{STEP_AT} s", "P_ref": f"{0.5 * S} W"})
    J = jacobian_from_powers(0.4 * S, 0.1 * S, V, *study.path_to_grid())
    droops = S / (0.05 * omega), S / (0.5 * V)
    aims = NormalisedGains(21.3, 8.24, 3.91, 0.0, 1.0, 1.0), NormalisedGains(15.8, 6.6, 4.0, 0.0, 0.5, 1.0)
    gains = STRUCTURES["angle_damped"].gains
    first, second = (PowerLoopGains(*map(float, gains(*J, aim, *droops, S, omega, False))) for aim in aims)
    return study, [GainChange(0.0, first), GainChange(RETUNED_AT, second)]


def inputs(study: Study, gains: list[GainChange], run: Simulation) -> np.ndarray:
    """What the program reads: the circuit, and the state that the simulation began in."""
    c, S = study.converter, study.converter.S_rated
    circuit = plant_step(study.circuit(), c.T_s, c.omega_n, edges=False)
    first = run.log[0]
    refs = References(0.3 * S, 0.1 * S, c.omega_n, c.V_rated_rms)
    response = circuit.source[0]
    return np.concatenate(
        [
            [round(DURATION / c.T_s), c.delay_samples, round(STEP_AT / c.T_s), 0.5 * S, round(RETUNED_AT / c.T_s)],
            [study.filter.R_c],
            circuit.transition.ravel(),
            circuit.bridge,
            np.column_stack([response.real, response.imag]).ravel(),
            first[:6],
            first[6:8],
            [np.cos(c.omega_n * c.T_s), np.sin(c.omega_n * c.T_s)],
            run.controller_log[0],
            gains[0].gains,
            gains[1].gains,
            study.inner_gains,
            refs,
            study.controller_settings()[:-1],
        ]
    )


def built(folder: Path, build: Path, double: bool) -> Path:
    require_compiler()
    program = build / f"closed_loop_{double}"
    sources = [str(Path(__file__).with_name("closed_loop.c")), str(folder / "vsg_control.c")]
    precision = ["-DVSG_DOUBLE"] if double else []
    run_compiler(["gcc", *STRICT, "-O2", *precision, f"-I{folder}", *sources, "-o", str(program), "-lm"])
    return program


def told(program: Path, given: np.ndarray, build: Path) -> np.ndarray:
    """P, Q and omega of every sample."""
    given.tofile(build / "given.bin")
    subprocess.run([str(program), str(build / "given.bin"), str(build / "told.bin")], check=True)
    return np.fromfile(build / "told.bin").reshape(-1, 3)


@pytest.fixture(scope="module")
def programs(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Path]:
    build = tmp_path_factory.mktemp("closed_loop")
    return {double: built(folder, build, double) for double in (True, False)}


@pytest.mark.parametrize("case", CASES)
def test_as_simulated(case: str, programs: dict[bool, Path], folder: Path, tmp_path: Path) -> None:
    study, gains = scenario(case)
    run = simulate(study, gains, log_states=1)
    assert run.controller_log.shape[1] == len(flat_state(run.final_state)) == 17
    given = inputs(study, gains, run)
    double, single = (told(programs[kind], given, tmp_path) for kind in (True, False))
    every = round(study.simulation.log_interval / study.converter.T_s)
    S = study.converter.S_rated
    size = np.array([S, S, study.converter.omega_n])
    simulated = np.column_stack([run.column(name) for name in ("P", "Q", "omega")])
    assert np.ptp(simulated[:, 0]) > 0.19 * S  # the step of 20 % came
    assert np.max(np.abs(double[::every] - simulated) / size) <= 1e-9
    # 0.01 % of rated; 0.0012 % at worst.
    assert np.max(np.abs(single - double) / size) <= 1e-4
    if case == CASES[0]:  # without the compensated sums the same test sees more than a hundred times as much
        plain = tmp_path / "plain"
        shutil.copytree(folder, plain)
        laws = (plain / "vsg_laws.h").read_text(encoding="ascii")
        bent = laws.replace("*lost = (sum - x) - change;", "*lost = VSG_C(0.0);")
        assert bent != laws
        (plain / "vsg_laws.h").write_text(bent, encoding="ascii")
        lossy = told(built(plain, tmp_path, double=False), given, tmp_path)
        assert np.max(np.abs(lossy - double) / size) > 1e-3
