"""The exported controller in closed loop for 3 s: in double precision the EMT's own run, in single close to it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.compilers import require_compiler
from tests.export.exchange import written
from vsgdesign.equations.controller_data import flat_settings, flat_state
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.export import export_c_files
from vsgdesign.export.compiled import STRICT, run_compiler
from vsgdesign.linear.operating_point.plant import plant_step
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation import GainChange, Simulation, build_timeline, simulate
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters import Study, study_from_text

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
    """What the program reads: the start of the simulation, and the circuit, source and gains after every change."""
    c, timeline = study.converter, run.timeline
    first = run.log[0]
    refs = timeline.references_at(0.0)
    instants = sorted({0.0, *(event.t_s for event in study.events), *(change.t_s for change in gains)})
    changes = [_change(study, gains, timeline, t_s) for t_s in instants]
    return np.concatenate(
        [
            [round(study.simulation.duration / c.T_s), c.delay_samples, study.filter.R_c],
            first[:6],
            first[6:8],
            [np.cos(c.omega_n * c.T_s), np.sin(c.omega_n * c.T_s)],
            run.controller_log[0],
            study.inner_gains,
            refs,
            flat_settings(study.controller_settings()),
            [len(changes)],
            *changes,
        ]
    )


def _change(study: Study, gains: list[GainChange], timeline: Timeline, t_s: float) -> np.ndarray:
    """One change as the program reads it."""
    c, late = study.converter, t_s + 1e-9
    circuit = plant_step(study.circuit(timeline.grid_at(late)), c.T_s, c.omega_n, edges=False)
    response = circuit.source[0]
    turned = 1.0 + 0.0j
    if t_s > 0.0:
        before, after = timeline.source_at(t_s - 1e-9).at(t_s), timeline.source_at(late).at(t_s)
        turned = after.V_g_rms / before.V_g_rms * np.exp(1j * (after.phase - before.phase))
    present = max((change for change in gains if change.t_s <= late), key=lambda change: change.t_s)
    grid = present.grid or study.grid
    return np.concatenate(
        [
            [round(t_s / c.T_s)],
            circuit.transition.ravel(),
            circuit.bridge,
            np.column_stack([response.real, response.imag]).ravel(),
            [turned.real, turned.imag],
            [float(0.0 < t_s == present.t_s)],
            present.gains,
            [grid.R_g, grid.L_g, timeline.references_at(late)[0]],
        ]
    )


COLUMNS = ("P", "Q", "omega", "i_s_alpha", "i_s_beta")


def sizes(study: Study) -> np.ndarray:
    """What the errors of COLUMNS are relative to."""
    c = study.converter
    return np.array([c.S_rated, c.S_rated, c.omega_n, c.I_rated_pk, c.I_rated_pk])


def built(folder: Path, build: Path, double: bool) -> Path:
    require_compiler()
    program = build / f"closed_loop_{double}"
    sources = [str(Path(__file__).with_name("closed_loop.c")), str(folder / "vsg_control.c")]
    precision = ["-DVSG_DOUBLE"] if double else []
    run_compiler(["gcc", *STRICT, "-O2", *precision, f"-I{folder}", *sources, "-o", str(program), "-lm"])
    return program


def told(program: Path, given: np.ndarray, build: Path) -> np.ndarray:
    """P, Q, omega and the converter's current of every sample."""
    given.tofile(build / "given.bin")
    subprocess.run([str(program), str(build / "given.bin"), str(build / "told.bin")], check=True)
    return np.fromfile(build / "told.bin").reshape(-1, 5)


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
    size = sizes(study)
    simulated = np.column_stack([run.column(name) for name in COLUMNS])
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


EVENTS = {
    "jump SCR 1.5 to 20": {"grid": {"scr": 20, "x_over_r": 5}},
    "phase jump of 60 degrees": {"phase_jump": "60 deg"},
    "sag to 0.05 pu": {"V_g_pu": 0.05},
}


@pytest.fixture(scope="module")
def limited_programs(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Path]:
    build = tmp_path_factory.mktemp("limited_loop")
    table_file, _ = written(build)
    folder = export_c_files(table_file, build / "c", limiter="projection").folder
    return {double: built(folder, build, double) for double in (True, False)}


@pytest.mark.parametrize("event", EVENTS)
def test_as_simulated_while_it_limits(event: str, limited_programs: dict[bool, Path], tmp_path: Path) -> None:
    """A disturbance through the exported controller with the projection limiter, rescheduled 20 ms after a jump."""
    text = """
base = "case:hoang2025_5kva"
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
inner_loops = { transient_resistance_pu = 0.08 }
grid = { scr_basis = "impedance", scr = 1.5, x_over_r = 5 }
power_loops = { structure = "angle_damped", tau_P = "5 ms", tau_Q = "5 ms" }
simulation = { duration = "1.6 s", bridge = "averaged", log_interval = "50 us", P_ref = "2.5 kW", Q_ref = "0 var" }
controllers = [{ name = "any", kind = "scheduled" }]
"""
    later = [{"time": "0.35 s", "V_g_pu": 1.0}] if "sag" in event else []
    study = study_from_text(text).with_events({"time": "0.1 s", **EVENTS[event]}, *later)
    timeline = build_timeline(study)
    law = gain_law(study, study.controllers[0])
    gains = [
        GainChange(t_s, PowerLoopGains(*map(float, law(grid.R_g, grid.L_g, 2.5e3, 0.0, 110.0))), grid)
        for t_s, grid in ((0.0, study.grid), (0.12, timeline.grid_at(0.2)))
    ]
    run = simulate(study, gains, log_states=1)
    given = inputs(study, gains, run)
    double, single = (told(limited_programs[kind], given, tmp_path) for kind in (True, False))
    simulated = np.column_stack([run.column(name) for name in COLUMNS])
    assert run.column("limited_samples")[-1] > 200
    assert np.max(np.abs(double - simulated) / sizes(study)) <= 1e-9  # 5e-12 at worst
    assert np.max(np.abs(single - double) / sizes(study)) <= 3e-4  # 3e-5 at worst
