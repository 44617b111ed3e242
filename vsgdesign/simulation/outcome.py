"""The outcome of a run: it settled, did not settle, is unstable, rests at a limit, has no steady state, diverged, or is
not known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.metrics.events import MEASURED, NO_STEADY_STATE, NOT_SETTLED, EventMetrics
from vsgdesign.study.parameters.reader import format_quantity
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.simulation.gains import GainChange
    from vsgdesign.simulation.rest import Rest
    from vsgdesign.simulation.run import Simulation

Array = NDArray[np.float64]

RunStatus = Literal["settled", "not settled", "unstable", "limited", "infeasible", "diverged", "blocked", "not known"]
"""``limited`` means that it rests where a limit acts. ``unstable`` means that the full-order model is unstable at the
rest. ``infeasible`` means that there is no steady state. ``diverged`` means that a quantity left every sensible bound
and the simulation ended there. ``blocked`` means that the dc link left its limits and the simulation ended there.
``not known`` means that the simulated time is too short, or that nothing happens in
it."""

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
    limits: tuple[str, ...] = ()
    """The limits that act at the end of a run that comes to no other rest: names of :data:`LIMITS`."""


@dataclass(frozen=True)
class Divergence:
    """The instant at which a run was ended because it diverged or its bridge blocked. Nothing from t_s on is kept."""

    t_s: float
    reason: str
    blocked: bool = False
    """Whether the bridge blocked because its dc link left its limits."""
    unit: str = ""
    """Of a plant: whose bridge blocked."""


RESTING_S = 1.0
"""Length of the end of a run in which it must rest where a limit acts, s."""

ACTS = 0.05
"""Share of the samples from which on a limit counts as acting: a rest at its edge is limited in some samples only."""

PARTS = 4
MOVES = 0.02
"""The means of the powers over so many parts of the end of a run differ by at most this share of the rating at rest."""

NEAR = 0.9
"""Where the bridge's voltage is at its limit, a limiter acts on a current that the voltage is not enough for. Its own
limit acts as well only from this share of the current limit on."""

CURRENT, BRIDGE, VOLTAGE = LIMITS = "current", "bridge voltage", "limiter's voltage"
"""What may limit a run: the current, the voltage of the bridge, and the voltage to which a limiter holds the Q loop."""

IN_WORDS = {
    CURRENT: "its current limit",
    BRIDGE: "the limit of its bridge's voltage",
    VOLTAGE: "a limit that its limiter sets to the voltage",
}


class LimitedSamples(NamedTuple):
    """Whether a limit acts in each row of a run, (n,) each, as a share of the samples since the row before."""

    current: Array
    bridge: Array
    voltage: Array


class LimitedEnd(NamedTuple):
    """The end of a run in which limits act."""

    P: float
    """Mean power at the PCC over the end of the run, W."""
    Q: float
    """var"""
    limits: tuple[str, ...]
    """Names of :data:`LIMITS`, the one that decides first."""
    spread: float
    """Largest difference between the means of P or Q over quarters of this end, of the rating."""

    @property
    def rests(self) -> bool:
        """Whether the powers rest."""
        return self.spread <= MOVES

    @property
    def where(self) -> str:
        """The limits in words."""
        return " and ".join(IN_WORDS[name] for name in self.limits)


def limited_samples(study: Study, run: Simulation) -> LimitedSamples:
    """The limits that act in the rows of a run. ``study`` has the limit and the limiter of the controller."""
    c, settings = study.converter, study.controller_settings()
    every = max(round(float(run.t_s[1] - run.t_s[0]) / c.T_s), 1) if len(run.t_s) > 1 else 1
    counted, at_bridge, V = (run.column(name) for name in ("limited_samples", "at_bridge", "V_rms"))
    current = np.diff(counted, prepend=counted[:1]) / every
    if c.current_limit_pu is not None:
        near = np.hypot(run.column("i_s_alpha"), run.column("i_s_beta")) >= NEAR * c.current_limit_pu * c.I_rated_pk
        current = np.where((at_bridge > 0.0) & ~near, 0.0, current)
    voltage = np.zeros(len(V))
    for end in ("V_low", "V_high"):
        if (limit := getattr(settings.limiter, end, None)) is not None:
            voltage += np.isclose(V, limit, rtol=SAME, atol=0.0)
    return LimitedSamples(current, at_bridge, voltage)


SAME = 1e-9
"""A voltage that differs from a limit by less than this share of it is at the limit."""


def limited_end(
    study: Study, t_s: Array, P: Array, Q: Array, acting: LimitedSamples, since_s: float
) -> LimitedEnd | None:
    """The end of a run in which limits act; None if none does, or if the last event was later than its beginning.

    Arrays of a run: time (s), the powers at the PCC (W, var), and what limits it. ``since_s``: the last event.
    """
    if t_s[-1] < RESTING_S:
        return None
    rows = np.array_split(np.arange(int(np.searchsorted(t_s, t_s[-1] - RESTING_S)), len(t_s)), PARTS)
    begin = rows[0][0]
    if t_s[begin] < since_s or any(part.size == 0 for part in rows):
        return None
    limits = tuple(name for name, one in zip(LIMITS, acting, strict=True) if one[begin:].mean() >= ACTS)
    if not limits:
        return None
    spread = max(float(np.ptp([power[part].mean() for part in rows])) for power in (P, Q)) / study.converter.S_rated
    return LimitedEnd(float(P[begin:].mean()), float(Q[begin:].mean()), limits, spread)


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
    at_limit: LimitedEnd | None = None,
    S_rated: float = math.inf,
) -> Outcome:
    """The outcome of a run: from its divergence, or else from the rest after its last event and the figures of this
    event.

    ``at_limit`` is the end of a run in which limits act, ``S_rated`` the rating in VA.
    """
    if divergence is not None:
        return Outcome("blocked" if divergence.blocked else "diverged", divergence.reason, divergence.t_s)
    if not found:
        return Outcome("not known", "the controller has no gains on some grid of the scenario")
    last = found[-1]
    if last.ramping:
        return Outcome("not known", last.obstacle)
    if not last.stable:
        return Outcome("unstable", last.end_state("P_pcc", False, 1.0).obstacle)
    limited = None if at_limit is None else _limited(at_limit, last, S_rated)
    if limited is not None:
        return limited
    if not last.modelled:
        return Outcome("not known", last.obstacle)
    measured = [event for event in events if event.t_s == last.t_s]
    for wanted, status in ((NO_STEADY_STATE, "infeasible"), (NOT_SETTLED, "not settled")):
        for event in measured:
            if event.status == wanted:
                return Outcome(status, event.reason)  # type: ignore[arg-type]
    if last.mode is None:
        return Outcome("infeasible", last.obstacle)
    if not measured:
        return Outcome("not known", f"there is no measurement after {last.name}")
    short = next((event for event in measured if event.status != MEASURED), None)
    return Outcome("settled") if short is None else Outcome("not known", short.reason)


RESTS_AT, MOVES_AT = (
    "it rests at {} with P = {} and Q = {}",
    "in the last second it is at {} and does not rest: the means of P or Q over its quarters differ by {:.3g} % of the "
    "rating",
)
"""What is said of a run at whose end limits act, first, whether it rests there or not."""


def _limited(end: LimitedEnd, last: Rest, S_rated: float) -> Outcome | None:
    """The outcome of a run at whose end limits act; None if it is at a rest without them, or on its way there."""
    if last.point is not None:
        away = max(abs(end.P - last.P_pcc), abs(end.Q - last.Q_pcc)) > MOVES * S_rated
        # Ripple and harmonics may touch the limit of the bridge at a rest as well.
        if not (end.rests and away and CURRENT in end.limits):
            return None
    why = last.obstacle or "A steady state without the limit exists, but this run does not return to it."
    why = f"{why[0].upper()}{why[1:]}"
    if end.rests:
        P, Q = (float(f"{power:.3g}") for power in (end.P, end.Q))
        said = RESTS_AT.format(end.where, format_quantity(P, "W"), format_quantity(Q, "var"))
        return Outcome("limited", f"{said}. {why}", limits=end.limits)
    return Outcome("not settled", f"{MOVES_AT.format(end.where, 100.0 * end.spread)}. {why}", limits=end.limits)
