"""The exported controller connects to a live grid: breaker open, synchronised, closed, without a surge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from tests.export.conftest import built
from tests.export.exchange import written
from vsgdesign.equations.controller import Measurement
from vsgdesign.equations.filters import FilterGrid
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.export import CompiledC, export_c_files
from vsgdesign.frames import rms_to_peak
from vsgdesign.operating_point.plant import plant_step
from vsgdesign.parameters import Study, study_from_text

CASES = ("hoang2025_5kva", "lab_12kva_lcl", "utility_1mva_60hz")
OPEN = 1e6
"""H: the grid behind an open breaker."""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> CompiledC:
    place = tmp_path_factory.mktemp("synchronising")
    return built(export_c_files(written(place)[0], place / "c", limiter="projection").folder, double=False)


@dataclass
class Bench:
    """One converter, its filter, and a grid of 1.04 pu, half a hertz off, with 2 % of fifth harmonic and unbalance."""

    study: Study
    compiled: CompiledC

    def __post_init__(self) -> None:
        study = self.study
        c, self.settings = study.converter, study.controller_settings()
        self.V_pk, self.I_pk = rms_to_peak(c.V_rated_rms), c.I_rated_pk
        self.omega = c.omega_n + 2.0 * np.pi * 0.5
        self.parts = [(self.omega, 1.04 * self.V_pk * np.exp(1.0j)), (-self.omega, 0.01 * self.V_pk)]
        self.parts += [(-5.0 * self.omega, 0.02 * self.V_pk)]
        J = jacobian_from_powers(0.0, 0.0, c.V_rated_rms, *study.path_to_grid())
        aim = NormalisedGains(15.8, 6.6, 4.0, 0.0, 0.5, 1.0)
        droops = c.S_rated / (0.05 * c.omega_n), c.S_rated / (0.5 * c.V_rated_rms)
        gains = STRUCTURES["angle_damped"].gains(*J, aim, *droops, c.S_rated, c.omega_n, False)
        self.control = self.compiled.control(
            PowerLoopGains(*map(float, gains)),
            study.inner_gains,
            GridEstimate(study.grid.R_g, study.grid.L_g),
            References(0.0, 0.0, c.omega_n, c.V_rated_rms),
            self.settings,
        )
        self.x = np.zeros(3, complex)
        self.pending = 0.0j
        self.t_s = 0.0

    def circuit(self, closed: bool) -> list[Any]:
        circuit = self.study.circuit()
        circuit = circuit if closed else FilterGrid(*circuit[:-1], L_g=OPEN)
        return [plant_step(circuit, self.settings.T_s, omega, edges=False) for omega, _ in self.parts]

    def run(self, duration: float, closed: bool, watch: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """|i_s| and |i_g| over rated of every sample, and whether the breaker may close."""
        steps, currents, ready = self.circuit(closed), [], []
        for _ in range(round(duration / self.settings.T_s)):
            sources = [part * np.exp(1j * omega * self.t_s) for omega, part in self.parts]
            v = self.x[1] + self.study.filter.R_c * (self.x[0] - self.x[2])
            measured = Measurement(v.real, v.imag, self.x[0].real, self.x[0].imag, self.x[2].real, self.x[2].imag)
            if watch is not None:
                v_g = sum(sources)
                ready.append(self.control.synchronise(watch, v_g.real, v_g.imag, measured))
            output = self.control.step(measured)
            assert self.control.used
            currents.append(np.abs(self.x[[0, 2]]) / self.I_pk)
            v_b = output.v_b_alpha + 1j * output.v_b_beta
            now = self.pending if self.study.converter.delay_samples else v_b
            self.pending = v_b
            self.x = steps[0].transition @ self.x + steps[0].bridge * now
            for step, source in zip(steps, sources, strict=True):
                self.x = self.x + step.source[0] * source
            self.t_s += self.settings.T_s
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
    currents, ready = bench.run(0.4, closed=False, watch=watch)
    settled = round(0.3 / bench.settings.T_s)
    assert np.all(ready[settled:])
    assert not np.all(ready)  # with an empty capacitor it may not
    assert abs(watch.omega - bench.omega) <= 2.0 * np.pi * 0.05
    assert np.max(currents[settled:, 1]) <= 1e-6  # the breaker is open
    currents, _ = bench.run(0.4, closed=True)
    # The fifth harmonic and the unbalance meet the filter: 0.21 pu in the 5 kVA converter, which has the largest.
    assert np.max(currents[: round(0.02 / bench.settings.T_s), 1]) <= 0.25
    assert np.max(currents) <= 0.5


def test_without_synchronising_there_is_a_surge(bench: Bench) -> None:
    """The same, a radian late: this is what the test above would see."""
    other = Bench(bench.study, bench.compiled)
    other.run(0.4, closed=False, watch=other.control.grid_watch())
    other.control.data.state.theta -= 1.0
    currents, _ = other.run(0.02, closed=True)
    assert np.max(currents) > 1.0
