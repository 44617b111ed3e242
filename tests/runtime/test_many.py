"""Many schedulers at once: the bits of as many single ones, whatever comes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.gain_tables import PUBLISHED_BASE, table
from vsgdesign.equations.frames import base_impedance
from vsgdesign.equations.scheduler_data import NO_ESTIMATE, NO_REASON, SATURATED
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime import (
    ClosedFormSchedule,
    GainLookup,
    Scheduler,
    box_settings,
    gain_lookup,
    settings_of,
    table_schedule,
)
from vsgdesign.runtime.guards import REASONS, STATUSES, SchedulerSettings
from vsgdesign.runtime.many import ManyCovariances, ManySchedulers
from vsgdesign.runtime.updating import advance, given_input, told_state

OMEGA = PUBLISHED_BASE.omega_n
Z_BASE = base_impedance(5e3, 110.0)
GRADED = {"k_1": np.linspace(10.0, 20.0, 16).reshape(4, 4), "share_P": np.linspace(0.2, 1.0, 16).reshape(4, 4)}
SHORT: dict[str, Any] = {"stale_ticks": 90_000, "lost_ticks": 250_000}
"""So that a sequence of a hundred updates becomes stale and lost."""


def of_table(structure: str, law: str = "poles", **changes: Any) -> tuple[GainLookup, SchedulerSettings]:
    status = np.full((4, 4), "met", dtype="<U8")
    status[0, 2:], status[1, 3] = "outside", "outside"
    graded = GRADED if law == "poles" else {"H": np.linspace(1.0, 3.0, 16).reshape(4, 4)}
    made = table(structure, law, parameters=graded, status=status, **changes)
    return gain_lookup(table_schedule(made), V_n_rms=110.0), settings_of(made, **SHORT)


def of_closed_form() -> tuple[GainLookup, SchedulerSettings]:
    schedule = ClosedFormSchedule(
        P=0.0,
        Q=0.0,
        V_g_rms=110.0,
        omega=OMEGA,
        settling_time=1.0,
        damping_ratio=1.0,
        droop_ratio=0.01,
        S_rated=5e3,
        structure="angle_damped",
        D_p=318.3,
        D_q=90.9,
        R_2=0.02,
        L_2=5e-4,
    )
    settings = box_settings(
        scr=(1.5, 20.0),
        r_over_x=(0.1, 3.3),
        P=(-4500.0, 4500.0),
        Q=(-2000.0, 2000.0),
        V_rms=(93.5, 137.5),
        S_rated=5e3,
        V_rated_rms=110.0,
        omega=OMEGA,
        **SHORT,
    )
    return gain_lookup(schedule, V_n_rms=110.0, S_rated=5e3), settings


CASES = {
    "published": lambda: of_table("published"),
    "decoupled": lambda: of_table("decoupled"),
    "angle-damped": lambda: of_table("angle_damped"),
    "inertia, reactance": lambda: of_table(
        "angle_damped", "inertia", base=replace(PUBLISHED_BASE, scr_basis="reactance", L_2=5e-4, R_2=0.02)
    ),
    "closed form": of_closed_form,
}


class Inputs:
    """Random updates of ``count`` lanes: mostly good ones, and every kind of bad one."""

    def __init__(self, seed: int, count: int) -> None:
        self.rng, self.count = np.random.default_rng(seed), count
        self.ticks = self.rng.integers(0, 2**32, count)
        self.scr, self.x_over_r = self._grids()

    def _grids(self) -> tuple[Any, Any]:
        return np.exp(self.rng.uniform(0.2, 3.2, self.count)), np.exp(self.rng.uniform(-1.5, 2.5, self.count))

    def some(self, share: float) -> Any:
        return self.rng.random(self.count) < share

    def next(self) -> dict[str, Any]:
        rng, n = self.rng, self.count
        jumped, (scr, x_over_r) = self.some(0.05), self._grids()
        self.scr, self.x_over_r = np.where(jumped, scr, self.scr), np.where(jumped, x_over_r, self.x_over_r)
        self.ticks = self.ticks + np.where(self.some(0.03), rng.integers(-60_000, 90_000, n), 20_000)
        R_g = Z_BASE / self.scr / np.hypot(1.0, self.x_over_r) * rng.normal(1.0, 0.01, n)
        L_g = R_g * self.x_over_r / OMEGA * rng.normal(1.0, 0.01, n)
        said = np.where(self.some(0.15) | (self.scr > 15.0), NO_ESTIMATE, NO_REASON)
        R_g, L_g = np.where(said == NO_ESTIMATE, np.nan, R_g), np.where(said == NO_ESTIMATE, 0.0, L_g)
        said = np.where(self.some(0.01), SATURATED, said)
        R_g, L_g = np.where(self.some(0.01), 1e3, R_g), np.where(self.some(0.01), np.inf, L_g)
        sigma_R, sigma_L = np.abs(rng.normal(0.0, 0.15, n)), np.abs(rng.normal(0.0, 0.15, n)) / OMEGA
        cov = rng.uniform(-1.0, 1.0, n) * sigma_R * sigma_L * np.where(self.some(0.03), 2.0, 1.0)
        unknown = self.some(0.4)
        covariance = ManyCovariances(
            *(
                np.where(unknown, np.nan, value)
                for value in (sigma_R**2, cov, np.where(self.some(0.01), -1, sigma_L**2))
            )
        )
        covariance.cov_RL[self.some(0.01)] = np.inf
        P, Q, V_rms = rng.uniform(-5e3, 5e3, n), rng.uniform(-2.2e3, 2.2e3, n), rng.uniform(90.0, 140.0, n)
        P, V_rms = np.where(self.some(0.01), np.nan, P), np.where(self.some(0.01), 1e4, V_rms)
        told = {name: self.some(0.04) for name in ("limited", "surprised", "changed")}
        given = {"R_g": R_g, "L_g": L_g, "P": P, "Q": Q, "V_rms": V_rms, "ticks": self.ticks}
        return given | told | {"said": said, "covariance": covariance}


def one(given: Any, lane: int) -> Any:
    """The same of one lane, as Python's numbers."""
    if isinstance(given, tuple):
        found = tuple(float(value[lane]) for value in given)
        return None if np.isnan(found).all() else found
    return given[lane].item()


@pytest.mark.parametrize("name", CASES)
def test_bits_of_single_schedulers(name: str) -> None:
    lookup, settings = CASES[name]()
    count, updates = 25, 120
    many, inputs = ManySchedulers(lookup, settings, count), Inputs(7, count)
    states = [Scheduler(lookup, settings)._state for _ in range(count)]
    statuses, reasons = 0, set()
    for _ in range(updates):
        given = inputs.next()
        gains = many.update(**given)
        answers = many.answers
        assert answers is not None
        for lane in range(count):
            x = {key: one(value, lane) for key, value in given.items()}
            states[lane] = told_state(states[lane], x.pop("limited") + 2 * x.pop("surprised") + 4 * x.pop("changed"))
            states[lane], answer = advance(lookup, settings, states[lane], given_input(**x))
            found = tuple(value[lane] for value in answers[1:]), tuple(value[lane] for value in gains)
            assert found == (answer[1:], answer.gains)
            statuses |= answer.status
            reasons.add(answer.reason)
    for field, values in many.state._asdict().items():
        expected = [getattr(state, field) for state in states]
        np.testing.assert_array_equal(np.transpose(values) if field == "gains" else values, expected, err_msg=field)
    # Every guard had its say. A closed form is designed everywhere.
    assert statuses == sum(STATUSES)
    assert len(reasons) == len(REASONS) - (name == "closed form")


def test_some_lanes_at_a_time() -> None:
    """An estimator concludes in a few lanes: the others keep every bit."""
    lookup, settings = CASES["angle-damped"]()
    whole, part = ManySchedulers(lookup, settings, 12), ManySchedulers(lookup, settings, 12)
    inputs, lanes = Inputs(3, 12), np.array([1, 4, 5, 11])
    others = np.setdiff1d(np.arange(12), lanes)
    for _ in range(40):
        before, given = part.gains, inputs.next()
        some: dict[str, Any] = {key: value[lanes] for key, value in given.items() if key != "covariance"}
        some["covariance"] = ManyCovariances(*(item[lanes] for item in given["covariance"]))
        found = part.update(**some, lanes=lanes)
        expected = whole.update(**given)
        for k, gain in enumerate(part.gains):
            np.testing.assert_array_equal(gain[others], before[k][others])
            np.testing.assert_array_equal(gain[lanes], expected[k][lanes])
            np.testing.assert_array_equal(found[k], expected[k][lanes])
    np.testing.assert_array_equal(part.grid[1][lanes], whole.grid[1][lanes])


@pytest.mark.parametrize("nearest", [False, True])
def test_starts_on_known_grids_or_at_the_safe_place(nearest: bool) -> None:
    lookup, settings = CASES["decoupled"]()
    L_g = np.array([2e-3, 5e-3, 1e-6, 0.0, np.nan, 15e-3])
    R_g = np.array([0.5, 1.0, 0.5, 0.5, 0.5, 0.1])
    many = ManySchedulers(lookup, settings, len(L_g))
    known = many.start(R_g, L_g, nearest=nearest)
    for lane in range(len(L_g)):
        single = Scheduler(lookup, settings)
        try:
            single.start(float(R_g[lane]), float(L_g[lane]), nearest=nearest)
            assert known[lane]
        except ArtifactError:
            assert not known[lane]
        assert tuple(gain[lane] for gain in many.gains) == single.gains
        assert tuple(value[lane] for value in many.grid) == single.grid
        assert many.state.age[lane] == single._state.age  # type: ignore[index]
    assert 0 < known.sum() < len(known)


def test_no_estimate_is_a_hold() -> None:
    """Without reasons of its own, an update takes an estimate that is not a number as none."""
    lookup, settings = CASES["published"]()
    many, single = ManySchedulers(lookup, settings, 2), Scheduler(lookup, settings)
    nothing = np.full(2, np.nan)
    P, Q, V_rms = np.full(2, 1e3), np.full(2, 200.0), np.full(2, 111.0)
    for k in range(3):
        gains = many.update(nothing, nothing, P, Q, V_rms, 20_000 * k)
        answer = single.hold(1e3, 200.0, 111.0, 20_000 * k)
        assert many.answers is not None
        assert (many.answers.reason[1], many.answers.status[1]) == (NO_ESTIMATE, answer.status)
        assert tuple(gain[1] for gain in gains) == answer.gains
