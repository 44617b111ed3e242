"""The full-order linear model against the EMT, sample by sample, after small steps of P and Q.

The model is the derivative of the simulator's own map, so all that parts them is nonlinearity: its share is
proportional to the size of the step, which the second test shows by halving it. Unstable cells are compared while the
deviation stays small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.stability.studies import PUBLISHED, Situation, case_study, designed, random_situations, situation
from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS
from vsgdesign.linear.operating_point.full_order import Cell
from vsgdesign.linear.stability.step_responses import full_order_step
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import Event

Array = NDArray[np.float64]

SIGNALS = ("P", "Q", "omega", "V")
COUNT = 20
STEP_PU = 1e-5
"""Of rating: the nonlinear share is then some 1e-5 of the step, and rounding (1e-12 of rating) 1e-7."""

BOUND = 1e-3
LARGEST = 3e-4
"""Deviation in per unit of rating up to which an unstable cell is compared."""

START = 10
"""Sample of the step."""


@pytest.fixture(scope="module")
def situations() -> list[Situation]:
    return random_situations(COUNT, seed=1)


@dataclass(frozen=True)
class Comparison:
    """Errors per signal over the largest deviation so far, and how long the comparison lasted."""

    errors: dict[str, float]
    samples: int


def linear_response(s: Situation, input_: str, size: float, samples: int) -> Array:
    """(samples, 4) deviations of SIGNALS from the step on, by plain recursion of the model's matrices."""
    A, B, C, D = (m[0] for m in (s.model.A, s.model.B, s.model.C, s.model.D))
    column, rows = INPUTS.index(input_), [OUTPUTS.index(name) for name in SIGNALS]
    b = B[:, column] * size
    states = np.zeros((samples, len(A)))
    for k in range(1, samples):
        states[k] = A @ states[k - 1] + b
    return states @ C[rows].T + D[rows, column] * size


def emt_response(s: Situation, input_: str, size: float, samples: int) -> Array:
    """The same from the averaged EMT, as the difference from its first sample."""
    study, cell = s.study, s.cell
    T_s = study.converter.T_s
    reference = {input_: size + getattr(cell, input_)}
    spec = replace(study.simulation, duration=(START + samples) * T_s, P_ref=cell.P_ref, Q_ref=cell.Q_ref)
    study = replace(
        study,
        grid=cell.grid,
        grid_source=cell.source or study.grid_source,
        simulation=spec,
        events=(Event(START * T_s, "step", **reference),),
    )
    run = simulate(study, [GainChange(0.0, cell.gains)], bridge="averaged")
    values = np.stack([run.column(name) for name in ("P", "Q", "omega", "V_rms")], axis=1)
    return values[START:] - values[0]


def compare(s: Situation, input_: str, step_pu: float, seconds: float) -> Comparison:
    """EMT against prediction over a time, or until the prediction leaves LARGEST."""
    S = s.study.converter.S_rated
    samples = round(seconds / s.study.converter.T_s)
    predicted = linear_response(s, input_, step_pu * S, samples)
    large = np.flatnonzero(np.abs(predicted[:, :2]).max(axis=1) > LARGEST * S)
    if large.size:
        samples = int(large[0])
        predicted = predicted[:samples]
    simulated = emt_response(s, input_, step_pu * S, samples)
    so_far = np.maximum.accumulate(np.abs(predicted), axis=0)
    # A signal that has hardly begun to move is measured by what it is about to do.
    floor = np.maximum(so_far, 0.01 * np.abs(predicted).max(axis=0))
    errors = np.max(np.abs(simulated - predicted) / floor, axis=0)
    return Comparison(dict(zip(SIGNALS, errors.tolist(), strict=True)), samples)


@pytest.mark.parametrize("input_", ["P_ref", "Q_ref"])
def test_every_sample_of_the_emt_is_predicted(situations: Sequence[Situation], input_: str) -> None:
    """Twenty random cells, stable and unstable, P, Q, ω and V within 0.1 % of their deviation so far."""
    unstable = [s for s in situations if s.growth > 0.0]
    assert 5 <= len(unstable) <= COUNT - 8
    worst = 0.0
    for k, s in enumerate(situations):
        found = compare(s, input_, STEP_PU, seconds=1.0)
        # Whatever the growth, two of its time constants are seen (measured: 2.5 to 13).
        assert found.samples * s.model.T_s > 0.99 * min(1.0, 2.0 / max(s.growth, 1e-9)), k
        worst = max(worst, *found.errors.values())
        assert max(found.errors.values()) < BOUND, (k, s.growth, found)
    print(f"{input_}: worst error {worst:.1e} of the deviation so far")


def test_what_is_left_is_nonlinearity(situations: Sequence[Situation]) -> None:
    """Halving the step halves the relative error: the linear part itself has none that can be seen."""
    mild = [s for s in situations if s.growth < 5.0]  # the same time for both steps
    assert len(mild) > 8
    for s in mild[::2]:
        whole, half = (compare(s, "P_ref", pu, seconds=0.2) for pu in (1e-4, 5e-5))
        # Rounding in a run is 1e-12 of rating, so 1e-8 of the step and more of ω, which moves little.
        assert whole.samples == half.samples
        for name in SIGNALS:
            assert half.errors[name] < 0.6 * whole.errors[name] + 2e-6, (name, whole, half)
        largest = max(whole.errors, key=lambda name: whole.errors[name])
        expected = pytest.approx(0.5 * whole.errors[largest], rel=0.1, abs=1e-6)
        assert half.errors[largest] == expected, (largest, whole, half)


def test_full_order_step_is_the_recursion(situations: Sequence[Situation]) -> None:
    """The library's step response against the recursion that the EMT was held against."""
    s = situations[0]
    t, y = full_order_step(s.model, "Q_ref", "omega", 0.2)
    expected = linear_response(s, "Q_ref", 1.0, len(t))[:, SIGNALS.index("omega")]
    np.testing.assert_allclose(t, np.arange(len(t)) * s.model.T_s, rtol=1e-14)
    np.testing.assert_allclose(y[0], expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


def test_frequency_and_voltage_of_the_source() -> None:
    """The other two inputs: a step of ω_g and of V_g at a sample, in EMT and predicted."""
    study = case_study(PUBLISHED)
    grid = Place(4.0, 2.0, study.scr_basis).grid(study.converter)
    s = situation(study, Cell(grid, designed(study, grid, 0.5), 2000.0, 300.0))
    T_s, samples = study.converter.T_s, 6000
    source = study.grid_source
    for input_, size, event in (
        ("omega_g", 1e-4, Event(START * T_s, "step", omega_g=source.omega_g + 1e-4)),
        ("V_g", 1e-3, Event(START * T_s, "step", V_g_rms=source.V_g_rms + 1e-3)),
    ):
        spec = replace(study.simulation, duration=(START + samples) * T_s, P_ref=2000.0, Q_ref=300.0)
        moved = replace(study, grid=grid, simulation=spec, events=(event,))
        run = simulate(moved, [GainChange(0.0, s.cell.gains)], bridge="averaged")
        values = np.stack([run.column(name) for name in ("P", "Q", "omega", "V_rms")], axis=1)
        predicted = linear_response(s, input_, size, samples)
        error = np.abs(values[START:] - values[0] - predicted).max(axis=0) / np.abs(predicted).max(axis=0)
        print(input_, error)
        assert np.all(error < BOUND), (input_, error)
