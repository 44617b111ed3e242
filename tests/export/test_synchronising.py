"""The exported controller connects to a live grid: breaker open, synchronised, closed, without a surge."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.export.conftest import built
from tests.export.exchange import written
from tests.export.live_grid import LiveGrid
from tests.simulation.finding import found_in
from tests.simulation.test_connecting import run_of, tripped
from vsgdesign.equations.controller_data import Measurement
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.export import CompiledC, export_c_files
from vsgdesign.study.parameters import Study, study_from_text

CASES = ("hoang2025_5kva", "lab_12kva_lcl", "utility_1mva_60hz")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> CompiledC:
    place = tmp_path_factory.mktemp("synchronising")
    return built(export_c_files(written(place)[0], place / "c", limiter="projection").folder, False, "-O2")


class Bench:
    """One converter of the exported C at a live grid."""

    def __init__(self, study: Study, compiled: CompiledC) -> None:
        self.study, self.compiled, self.grid = study, compiled, LiveGrid(study)
        c = study.converter
        J = jacobian_from_powers(0.0, 0.0, c.V_rated_rms, *study.path_to_grid())
        aim = NormalisedGains(15.8, 6.6, 4.0, 0.0, 0.5, 1.0)
        droops = c.S_rated / (0.05 * c.omega_n), c.S_rated / (0.5 * c.V_rated_rms)
        gains = STRUCTURES["angle_damped"].gains(*J, aim, *droops, c.S_rated, c.omega_n, False)
        self.control = compiled.control(
            PowerLoopGains(*map(float, gains)),
            study.inner_gains,
            GridEstimate(study.grid.R_g, study.grid.L_g),
            References(0.0, 0.0, c.omega_n, c.V_rated_rms),
            self.grid.settings,
        )

    def run(self, duration: float, watch: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """|i_s| and |i_g| over rated of every sample, and whether the breaker may close."""
        currents, ready = [], []
        for _ in range(round(duration / self.grid.settings.T_s)):
            measured = self.grid.measured
            if watch is not None:
                v_g = self.grid.v_g
                ready.append(self.control.synchronise(watch, v_g.real, v_g.imag, measured))
            output = self.control.step(measured)
            assert self.control.used
            currents.append(self.grid.currents)
            self.grid.step(output.v_b_alpha + 1j * output.v_b_beta)
        return np.array(currents), np.array(ready)


@pytest.fixture(scope="module", params=CASES)
def bench(request: pytest.FixtureRequest, compiled: CompiledC) -> Bench:
    text = f"""
base = "case:{request.param}"
grid = {{ scr = 20, x_over_r = 5 }}
controllers = [{{ name = "any", kind = "fixed" }}]
simulation = {{ duration = "1 s", P_ref = "0 W", Q_ref = "0 var" }}
converter = {{ current_limit_pu = 1.2, current_limiter = "projection" }}
inner_loops = {{ transient_resistance_pu = 0.08 }}
"""
    return Bench(study_from_text(text), compiled)


def test_connects_without_a_surge(bench: Bench) -> None:
    """At SCR 20. From 0.3 s on the breaker may close; behind it flow the droops' own powers and the harmonics."""
    watch = bench.control.grid_watch()
    currents, ready = bench.run(0.4, watch)
    settled = round(0.3 / bench.grid.settings.T_s)
    assert np.all(ready[settled:])
    assert not np.all(ready)  # with an empty capacitor it may not
    assert abs(watch.omega - bench.grid.omega) <= 2.0 * np.pi * 0.05
    assert np.max(currents[settled:, 1]) <= 1e-6  # the breaker is open
    bench.grid.connect(bench.study.grid)
    currents, _ = bench.run(0.4)
    # The fifth harmonic and the unbalance meet the filter: 0.21 pu in the 5 kVA converter, which has the largest.
    assert np.max(currents[: round(0.02 / bench.grid.settings.T_s), 1]) <= 0.25
    assert np.max(currents) <= 0.5


def test_without_synchronising_there_is_a_surge(bench: Bench) -> None:
    """The same, a radian late: this is what the test above would see."""
    other = Bench(bench.study, bench.compiled)
    other.run(0.4, other.control.grid_watch())
    other.control.data.state.theta -= 1.0
    other.grid.connect(other.study.grid)
    currents, _ = other.run(0.02)
    assert np.max(currents) > 1.0


def test_the_exported_code_sets_the_same_angle_and_closes_at_the_same_sample(
    compiled: CompiledC,
) -> None:
    """A converter that trips and connects again in the EMT. The compiled C, in single precision, is given the
    samples of that run."""
    study = tripped("utility_1mva_60hz")
    found = found_in(study)
    run, c = run_of(found), study.converter
    closing = next(event for event in found.events if event.name == "breaker closes in step")
    control = compiled.control(
        run.gain_changes[0].gains,
        study.inner_gains,
        GridEstimate(study.grid.R_g, study.grid.L_g),
        References(0.0, 0.0, c.omega_n, c.V_rated_rms),
        study.controller_settings(),
    )
    watch, circuit = control.grid_watch(), study.circuit()
    first, end = math.ceil(0.0701 / c.T_s - 1e-6), round(closing.t_s / c.T_s)
    ready = []
    for k in range(first, end):
        x = run.log[k]
        v = [float(capacitor_node_voltage(x[a], x[2 + a], x[4 + a], circuit)) for a in (0, 1)]
        ready.append(control.synchronise(watch, x[6], x[7], Measurement(*v, *map(float, (*x[0:2], *x[4:6])))))
        assert abs(math.remainder(control.data.state.theta - run.column("theta")[k], 2.0 * math.pi)) < 1e-5
        assert pytest.approx(run.column("V_rms")[k], rel=1e-5, abs=1e-3) == control.data.state.V
    held = round(0.2 / c.T_s)
    assert all(ready[-held:])
    assert not ready[-held - 1]
    # Behind the breaker flows nothing until it closes, and then only what the harmonics drive through the filter.
    current = np.hypot(run.column("i_g_alpha"), run.column("i_g_beta")) / c.I_rated_pk
    assert current[first + 1 : end].max() < 1e-9
    assert 1e-3 < current[end:].max() < 0.3
