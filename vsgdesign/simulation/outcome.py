"""The outcome of a run: it settled, did not settle, rests at its current limit, has no steady state, diverged, or the
outcome is not known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.metrics.events import MEASURED, NO_STEADY_STATE, NOT_SETTLED, UNSTABLE, EventMetrics
from vsgdesign.study.parameters.study import Study
from vsgdesign.study.parameters.units import format_quantity

if TYPE_CHECKING:
    from vsgdesign.simulation.gains import GainChange
    from vsgdesign.simulation.rest import Rest

Array = NDArray[np.float64]

RunStatus = Literal["settled", "not settled", "limited", "infeasible", "diverged", "not known"]
"""``limited`` means that it rests where its current limiter acts. ``infeasible`` means that there is no steady state.
``diverged`` means that a quantity left every sensible bound and the simulation ended there. ``not known`` means that
the simulated time is too short, or that nothing happens in it."""

BOUND_PU = 1e3
"""A current, a voltage or a frequency beyond this many times its rated value has diverged. A circuit with the
converter's limited voltage stays far below it even at resonance."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run with its reason."""

    status: RunStatus
    reason: str | None = None
    """The reason in words; None if the run settled."""
    t_s: float | None = None
    """Time up to which the run is valid, s; None if it is valid to its end."""


@dataclass(frozen=True)
class Divergence:
    """The instant at which a run was ended because it diverged. Nothing from t_s on is kept."""

    t_s: float
    reason: str


RESTING_S = 0.4
"""Length of the end of a run in which it must rest at its current limit, s."""

_ACTS = 0.05
"""Share of the samples from which on a limiter counts as acting: a rest at its edge is limited in some samples only."""

_MOVES = 0.02
"""Largest difference between the mean powers of the two halves of a rest, of the rating."""


class LimitedRest(NamedTuple):
    """A rest at the current limit: mean powers at the PCC over the end of the run, W and var."""

    P: float
    Q: float


def limited_rest(
    study: Study, t_s: Array, P: Array, Q: Array, limited_samples: Array, since_s: float
) -> LimitedRest | None:
    """The rest of a run whose current limiter acts; None if the limiter does not act, or if the run still moves.

    Arrays of a run: time (s), the powers at the PCC (W, var), and how many samples were limited up to each row.
    ``since_s``: the last event; the end of the run that is looked at begins after it.
    """
    begin = int(np.searchsorted(t_s, t_s[-1] - RESTING_S))
    middle = (begin + len(t_s)) // 2
    if t_s[begin] < since_s or t_s[-1] < RESTING_S:
        return None
    samples = (t_s[-1] - t_s[begin]) / study.converter.T_s
    if limited_samples[-1] - limited_samples[begin] < _ACTS * samples:
        return None
    for power in (P, Q):
        if abs(power[begin:middle].mean() - power[middle:].mean()) > _MOVES * study.converter.S_rated:
            return None
    return LimitedRest(float(P[begin:].mean()), float(Q[begin:].mean()))


_INNER = "The inner loops are unstable on this grid: slow them down (inner_loops response times) or sample faster"
_POWER = "The power loops are unstable: lower their gains"


def outside(study: Study, x: NDArray[np.float64], state: ControllerState) -> str | None:
    """What has diverged, and what to do: the circuit's state x (2n) and the controller's are no numbers or beyond every
    sensible bound. None where all is well."""
    c = study.converter
    circuit = x.tolist()
    # A sum is finite only if every number is.
    numbers = (*circuit, *flat_state(state))
    if not math.isfinite(sum(numbers)) and not all(map(math.isfinite, numbers)):
        return (
            "a quantity is no longer a number. The inner loops are unstable on this grid (slow them down, "
            "inner_loops response times, or sample faster), or the power loops are (lower their gains)"
        )
    if abs(state.omega_i) > BOUND_PU * c.omega_n:
        return f"the frequency is beyond {BOUND_PU:g} times its nominal value. {_POWER}"
    if abs(state.V) > BOUND_PU * c.V_rated_rms:
        return f"the voltage of the Q loop is beyond {BOUND_PU:g} times its rated value. {_POWER}"
    if max(map(abs, circuit[0:2] + circuit[4:6])) > BOUND_PU * c.I_rated_pk:
        return f"a current is beyond {BOUND_PU:g} times its rated value. {_INNER}"
    if max(map(abs, circuit[2:4])) > BOUND_PU * c.V_rated_rms:
        return f"the capacitor voltage is beyond {BOUND_PU:g} times its rated value. {_INNER}"
    return None


def good_rows(study: Study, rows: NDArray[Any]) -> int:
    """How many rows of a run's log come before the first that is no number or beyond the bound."""
    c = study.converter
    amps, volts = c.I_rated_pk, c.V_rated_rms
    # In the order of LOG_COLUMNS up to V_rms; a power may be as large as a current and a voltage together.
    power = BOUND_PU * c.S_rated
    rated = np.array([*[amps] * 2, *[volts] * 2, *[amps] * 2, *[volts] * 2, power, power, c.omega_n, volts])
    bad = ~np.isfinite(rows).all(axis=1) | (np.abs(rows[:, : len(rated)]) > BOUND_PU * rated).any(axis=1)
    return int(np.argmax(bad)) if bad.any() else len(rows)


def unanswered(study: Study, changes: Sequence[GainChange]) -> dict[float, str]:
    """Which set points a controller does not answer, and why, by the time of the event, s."""
    found = {}
    for event in study.events:
        gains = [change.gains for change in changes if change.t_s <= event.t_s or change.t_s == 0.0][-1]
        deaf = [kind for kind in event.changed if kind.answers and getattr(gains, kind.answers) == 0.0]
        if deaf:
            needs, names = " and ".join(kind.needs for kind in deaf), " and ".join(kind.name for kind in deaf)
            found[event.t_s] = f"the controller has no {needs}, so it does not answer {names}"
    return found


def outcome_of(
    divergence: Divergence | None,
    found: Sequence[Rest],
    events: Sequence[EventMetrics],
    at_limit: LimitedRest | None = None,
) -> Outcome:
    """The outcome of a run: from its divergence, or else from the rest after its last event and the figures of this
    event.

    ``at_limit`` is the rest of a run whose current limiter acts.
    """
    if divergence is not None:
        return Outcome("diverged", divergence.reason, divergence.t_s)
    if not found:
        return Outcome("not known", "the controller has no gains on some grid of the scenario")
    last = found[-1]
    if last.ramping:
        return Outcome("not known", last.obstacle)
    if at_limit is not None:
        P, Q = (float(f"{power:.3g}") for power in at_limit)
        place = f"P = {format_quantity(P, 'W')} and Q = {format_quantity(Q, 'var')}"
        why = last.obstacle or "A steady state without the limit exists, but this run does not return to it."
        return Outcome("limited", f"it rests at its current limit with {place}. {why[0].upper()}{why[1:]}")
    if not last.modelled:
        return Outcome("not known", last.obstacle)
    measured = [event for event in events if event.t_s == last.t_s]
    for statuses, status in (
        ((NO_STEADY_STATE,), "infeasible"),
        ((UNSTABLE, NOT_SETTLED), "not settled"),
    ):
        for event in measured:
            if event.status in statuses:
                return Outcome(status, event.reason)  # type: ignore[arg-type]
    if last.mode is None:
        return Outcome("infeasible", last.obstacle)
    if not last.stable:
        return Outcome("not settled", last.end_state("P_pcc", False, 1.0).obstacle)
    if not measured:
        return Outcome("not known", f"there is no measurement after {last.name}")
    short = next((event for event in measured if event.status != MEASURED), None)
    return Outcome("settled") if short is None else Outcome("not known", short.reason)
