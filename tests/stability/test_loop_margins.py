"""Gain, phase and delay margins of each loop with the other closed, against python-control."""

from __future__ import annotations

from collections.abc import Iterator

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from tests.stability.loops_by_control import balanced, open_full_order, open_reduced
from tests.stability.studies import PUBLISHED, Situation, case_study, designed, random_situations
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.model.coupled import CoupledModel
from vsgdesign.linear.stability.maps import cell_set, reduced_cells
from vsgdesign.linear.stability.margins import full_order_margins, reduced_margins
from vsgdesign.study.parameters.grid import Place

Array = NDArray[np.float64]
NAMES = ("gain_margin_db", "phase_margin_deg", "delay_margin_s")


def reduced_models(count: int) -> Iterator[CoupledModel]:
    """Random grids, gains and filters of the published converter."""
    rng = np.random.default_rng(31)
    while count > 0:
        tau_P, tau_Q = (float(rng.choice([0.0, 10.0 ** rng.uniform(-3.0, -1.0)])) for _ in "PQ")
        study = case_study(PUBLISHED, tau_P=tau_P, tau_Q=tau_Q)
        scr, ratio = float(10.0 ** rng.uniform(0.2, 1.4)), float(10.0 ** rng.uniform(-0.4, 1.0))
        grid = Place(scr, ratio, study.scr_basis).grid(study.converter)
        gains = designed(study, grid, float(10.0 ** rng.uniform(-0.3, 0.3)), float(rng.uniform(0.3, 1.5)))
        gains = PowerLoopGains(*(float(g * 10.0 ** rng.uniform(-0.3, 0.3)) for g in gains))
        P, Q = float(rng.uniform(-3e3, 4.5e3)), float(rng.uniform(-1e3, 1e3))
        cells = cell_set(study, grid.R_g, grid.L_g, P, Q, gains)
        if cells.good[0]:
            count -= 1
            yield reduced_cells(study, cells)


def least(GM: Array, PM: Array, w_p: Array) -> dict[str, float]:
    """What matters of every crossing that python-control reports."""
    delays = np.mod(np.radians(PM), 2.0 * np.pi) / w_p
    return {
        "gain_margin_db": float(np.min(np.abs(20.0 * np.log10(GM)), initial=np.inf)),
        "phase_margin_deg": float(np.min(np.abs(PM), initial=np.inf)),
        "delay_margin_s": float(np.min(delays, initial=np.inf)),
    }


def test_reduced_margins_against_control() -> None:
    """40 random models: control.stability_margins of the loop in state space, every crossing: ≤ 1e-8 relative.

    A margin that one side has at a frequency beyond the grid (1e-3 to 1e4 rad/s) is left out.
    """
    worst, compared, finite_gain_margins = 0.0, 0, 0
    for model in reduced_models(40):
        table = reduced_margins(model)
        if not table.stable[0]:
            assert np.isnan(table.loop_P.phase_margin_deg[0])
            continue
        for k, ours in enumerate((table.loop_P, table.loop_Q)):
            loop = balanced(open_reduced(model, 0, "output")).channel(k)
            GM, PM, _, w_g, w_p, _ = control.stability_margins(loop, returnall=True)
            inside_g, inside_p = (w_g > 1e-3) & (w_g < 1e4), (w_p > 1e-3) & (w_p < 1e4)
            expected = least(GM[inside_g], PM[inside_p], w_p[inside_p])
            for name in NAMES:
                got = float(getattr(ours, name)[0])
                if np.isinf(expected[name]) or np.isinf(got):
                    assert got == expected[name], (name, k)
                    continue
                compared += 1
                finite_gain_margins += name == "gain_margin_db"
                error = abs(got - expected[name]) / max(abs(expected[name]), 1e-300)
                worst = max(worst, error)
                assert error < 1e-8, (name, k, got, expected[name])
    print(f"reduced: {compared} margins, {finite_gain_margins} of gain, worst {worst:.1e}")
    assert compared > 100
    assert finite_gain_margins > 10


def crossings(loop: control.StateSpace, high: float) -> dict[str, float]:
    """Margins of a sampled loop from python-control's frequency response: scanned finely, then Brent's method."""
    omega = np.geomspace(1e-3, high, 6000)
    L: NDArray[np.complex128] = loop(np.exp(1j * omega * loop.dt)).ravel()

    def at(w: float) -> complex:
        return complex(loop(np.exp(1j * w * loop.dt)))

    def located(values: Array, function) -> list[float]:
        change = np.flatnonzero(np.signbit(values[1:]) != np.signbit(values[:-1]))
        return [
            root_scalar(function, bracket=(omega[k], omega[k + 1]), method="brentq", xtol=1e-14, rtol=1e-14).root
            for k in change
        ]

    w_g = located(L.imag, lambda w: at(w).imag)
    GM = np.array([-1.0 / at(w).real for w in w_g if at(w).real < 0.0])
    w_p = np.array(located(np.log(np.abs(L)), lambda w: np.log(abs(at(w)))))
    PM = np.degrees([np.angle(-at(w)) for w in w_p])
    return least(GM, PM, w_p)


@pytest.fixture(scope="module")
def situations() -> list[Situation]:
    return [s for s in random_situations(24, seed=32) if s.growth < 0.0]


def test_full_order_margins_against_control(situations: list[Situation]) -> None:
    """Sampled loops as discrete systems of python-control: ≤ 5e-6 relative.

    S is a sum over modes, whose eigenvectors have a condition of up to 3e7 here: S is right to 1e-9, and a margin where
    the loop is flat to 1e-6 (measured).
    """
    worst, compared = 0.0, 0
    for s in situations:
        table = full_order_margins(s.model)
        for k, ours in enumerate((table.loop_P, table.loop_Q)):
            expected = crossings(open_full_order(s.model, 0, "output").channel(k), 0.999 * np.pi / s.model.T_s)
            for name in NAMES:
                got = float(getattr(ours, name)[0])
                if np.isinf(got) and np.isinf(expected[name]):
                    continue
                compared += 1
                error = abs(got / expected[name] - 1.0)
                worst = max(worst, error)
                assert error < 5e-6, (name, k, got, expected[name])
    print(f"full order: {len(situations)} cells, {compared} margins, worst {worst:.1e}")
    assert compared > 40


def test_the_scan_agrees_with_controls_own_margins(situations: list[Situation]) -> None:
    """The oracle above against control.stability_margins on interpolated frequency data: 1e-3 is what that has."""
    s = situations[0]
    for k in (0, 1):
        loop = open_full_order(s.model, 0, "output").channel(k)
        omega = np.geomspace(1e-2, 0.99 * np.pi / s.model.T_s, 5000)
        L: NDArray[np.complex128] = loop(np.exp(1j * omega * loop.dt)).ravel()
        data = (np.abs(L), np.degrees(np.unwrap(np.angle(L))), omega)
        GM, PM, _, _, w_p, _ = control.stability_margins(data, returnall=True)
        expected = least(GM, PM, w_p)
        for name, value in crossings(loop, omega[-1]).items():
            assert value == pytest.approx(expected[name], rel=1e-3), name


def test_a_delay_or_a_gain_beyond_the_margin_destabilises() -> None:
    """What the margins mean: at 0.999 of the gain or phase margin the loop is stable, at 1.001 of it not.

    The phase is turned by a constant factor, whose sign is the crossing's.
    """
    for model in reduced_models(12):
        table = reduced_margins(model)
        if not table.stable[0]:
            continue
        loop = open_reduced(model, 0, "output")
        for k, ours in enumerate((table.loop_P, table.loop_Q)):
            PM = np.radians(ours.phase_margin_deg[0])
            if np.isfinite(PM):
                for share, stable in ((0.999, True), (1.001, False)):
                    growth = []
                    for sign in (1.0, -1.0):
                        factors = np.ones(2, complex)
                        factors[k] = np.exp(sign * 1j * share * PM)
                        growth.append(loop.growth(factors))
                    assert (max(growth) < 0.0) is stable, (k, share, growth)
            GM = 10.0 ** (ours.gain_margin_db[0] / 20.0)
            if np.isfinite(GM):
                for share, stable in ((0.999, True), (1.001, False)):
                    growth = []
                    for factor in (GM**share, GM**-share):
                        factors = np.ones(2)
                        factors[k] = factor
                        growth.append(loop.growth(factors))
                    assert (max(growth) < 0.0) is stable, (k, share, growth)
