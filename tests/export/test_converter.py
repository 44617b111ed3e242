"""The exported converter as a whole: connected to a live grid, it learns the grid and follows it, with nothing lent."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.export.exchange import written
from tests.export.live_grid import LiveGrid
from vsgdesign.export import compile_c
from vsgdesign.export.c_code import export_c
from vsgdesign.export.c_content import Origin
from vsgdesign.export.compiled import OPEN, PROBE_OFF, TRIPPED, VALID, WAITS, CompiledConverter
from vsgdesign.export.field import converter_constants
from vsgdesign.runtime import load_scheduler
from vsgdesign.study.parameters import Grid, study_from_text

STUDY = """
base = "case:hoang2025_5kva"
grid = { scr_basis = "impedance", scr = 3, x_over_r = 3 }
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
inner_loops = { transient_resistance_pu = 0.08 }
power_loops = { tau_P = "5 ms", tau_Q = "5 ms" }
controllers = [{ name = "any", kind = "fixed" }]
simulation = { duration = "1 s", P_ref = "0 W", Q_ref = "0 var" }
"""


class Connected:
    """The converter at its live grid, with a background task that answers some samples after a cycle has ended."""

    def __init__(self, folder: Path) -> None:
        self.study = study_from_text(STUDY)
        self.grid, self.rng = LiveGrid(self.study), np.random.default_rng(1)
        self.converter: CompiledConverter = compile_c(folder, flags=("-O0",)).converter()

    def run(self, duration: float, inputs: int = 0) -> np.ndarray:
        """Largest |i_s| and |i_g| over rated."""
        most, waited = np.zeros(2), 0
        scale = np.array([1e-3 / self.grid.I_pk * 155.0] * 2 + [1e-3] * 4) * self.grid.I_pk
        for _ in range(round(duration / self.grid.settings.T_s)):
            measured = self.grid.measured
            measured = measured._replace(
                **dict(zip(measured._fields, measured + scale * self.rng.normal(size=6), strict=True))
            )
            if inputs & (OPEN | TRIPPED):
                v_g = self.grid.v_g
                self.converter.synchronise(v_g.real, v_g.imag, measured)
            output, due = self.converter.sample(measured, inputs)
            waited = waited + 1 if due else 0
            if waited == 4:
                answer = self.converter.cycle(round(self.grid.t_s * 1e6))
                assert answer is not None
            most = np.maximum(most, self.grid.currents)
            self.grid.step(output.v_b_alpha + 1j * output.v_b_beta)
        return most

    def error(self, grid: Grid) -> float:
        """|Ẑ − Z|/|Z|."""
        e, omega = self.converter.estimate, self.study.converter.omega_n
        Z = complex(grid.R_g, omega * grid.L_g)
        return abs(complex(e.R_g, omega * e.L_g) - Z) / abs(Z)

    @property
    def gains_for(self) -> float:
        """Length of the impedance that the gains in force are for, Ω."""
        grid = self.converter.data.control.grid
        return math.hypot(grid.R_g, self.study.converter.omega_n * grid.L_g)


@pytest.fixture(scope="module")
def connected(tmp_path_factory: pytest.TempPathFactory) -> Connected:
    place, study = tmp_path_factory.mktemp("converter"), study_from_text(STUDY)
    origin = Origin("t", "0" * 64, "s", "0" * 64, limiter=study.current_limiter)
    made = export_c(load_scheduler(written(place)[0]), origin, place / "c", converter=converter_constants(study))
    return Connected(made.folder)


def test_from_an_open_breaker_to_a_followed_grid(connected: Connected) -> None:
    """Connect without a surge, learn, ramp up, follow a jump of the grid, and stop with a trip."""
    one = connected
    assert one.run(0.3, OPEN)[1] <= 1e-3
    assert one.converter.status() & WAITS
    first = one.study.grid
    one.grid.connect(first)
    assert np.max(one.run(0.6)) <= 0.6  # the droops' powers of a grid of 1.04 pu that is 0.5 Hz off
    assert one.converter.status() == VALID
    assert one.error(first) <= 0.06
    Z_first = math.hypot(first.R_g, one.study.converter.omega_n * first.L_g)
    assert abs(one.gains_for / Z_first - 1.0) <= 0.1
    one.converter.data.control.refs.P_ref = 1500.0
    one.run(0.3)
    one.grid.connect(Grid(first.R_g / 2.5, first.L_g / 2.5))
    assert np.max(one.run(0.7)) <= 1.35  # the limit is 1.2
    assert one.converter.status() & VALID
    assert abs(one.gains_for / (Z_first / 2.5) - 1.0) <= 0.15
    one.run(0.01, PROBE_OFF)
    assert (one.converter.data.field.u_d, one.converter.data.field.u_q) == (0.0, 0.0)
    output, _ = one.converter.sample(one.grid.measured, TRIPPED)
    assert (output.v_b_alpha, output.v_b_beta) == (0.0, 0.0)
    assert one.converter.data.control.state.xi_vd == 0.0
    assert one.converter.status(TRIPPED) & WAITS
