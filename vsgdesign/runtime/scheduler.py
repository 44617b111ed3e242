"""The gain scheduler as it runs on the controller. It turns an estimate into guarded gains with a status.

The exported C does the same, line by line.
"""

from __future__ import annotations

from functools import cached_property
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import ArtifactError
from vsgdesign.identification import Estimate, Estimator, Probe
from vsgdesign.identification.feeding import FedEstimator
from vsgdesign.identification.neural import NeuralEstimator, neural_estimator
from vsgdesign.runtime.closed_form import ClosedFormSchedule
from vsgdesign.runtime.guards import (
    ARRIVED,
    CLAMPED,
    DOUBT,
    FALLBACK,
    FRESH,
    HELD,
    IMPLAUSIBLE,
    JUMP,
    LIMITED,
    NO_ESTIMATE,
    NO_REASON,
    NOT_FINITE,
    RANGE,
    REASONS,
    REFUSED,
    SATURATED,
    TIME,
    TOLD_LIMITED,
    TOLD_SURPRISED,
    UNDESIGNED,
    SchedulerSettings,
    limited,
    near,
    settings_of,
    window_settings,
)
from vsgdesign.runtime.lookup import GainLookup, gain_lookup
from vsgdesign.runtime.state import SchedulerState, state_document, state_of
from vsgdesign.runtime.table import table_schedule

if TYPE_CHECKING:
    from pathlib import Path

    from vsgdesign.artifacts.gain_table import GainTable
    from vsgdesign.parameters.study import Study

_MASK = 0xFFFFFFFF
_HALF = 0x80000000
_OLDEST = 0x7FFFFFFF

SAID = {
    "ok": NO_REASON,
    "not finite": NOT_FINITE,
    "saturated": SATURATED,
    "outside": IMPLAUSIBLE,
    "implausible": IMPLAUSIBLE,
}
"""The reason that the guards are given for a status of an estimate. Any other status means that there was no
estimate."""


class Answer(NamedTuple):
    """The gains from now on, with the status bits and the reason of :mod:`vsgdesign.runtime.guards`."""

    gains: PowerLoopGains
    status: int
    reason: int
    scr: float
    """The place for which the gains are made."""
    r_over_x: float

    @property
    def why(self) -> str:
        """The reason in words. It is empty if no guard refused the estimate."""
        return REASONS[self.reason]


def first_state(lookup: GainLookup, settings: SchedulerSettings) -> SchedulerState:
    """The first state: at the safe place, without load, and without an estimate so far.

    Raises ArtifactError if the table has no design at the safe place.
    """
    scr, r_over_x, V_rms = settings.safe_scr, settings.safe_r_over_x, lookup.V_n_rms
    V_rms = min(max(V_rms, settings.V_rms[0]), settings.V_rms[1])
    P = min(max(0.0, settings.P[0]), settings.P[1])
    Q = min(max(0.0, settings.Q[0]), settings.Q[1])
    normalised = lookup.normalised(scr, r_over_x)
    if normalised is None:
        raise ArtifactError(
            f"safe place SCR {scr:g}, R/X {r_over_x:g}: the table has no design there. Give another (safe_scr, "
            "safe_r_over_x) on the strong side."
        )
    gains = lookup.gains(normalised, scr, r_over_x, P, Q, V_rms)
    age = settings.lost_ticks + 1
    return SchedulerState(0, 0, age, 0, 0, 0, scr, r_over_x, scr, r_over_x, scr, r_over_x, P, Q, V_rms, gains)


def advance(
    lookup: GainLookup,
    c: SchedulerSettings,
    s: SchedulerState,
    said: int,
    R_g: float,
    L_g: float,
    P: float,
    Q: float,
    V_rms: float,
    ticks: int,
) -> tuple[SchedulerState, Answer]:
    """Makes one update. Returns the next state and the answer.

    ``said`` is the reason why there is no estimate, or NO_REASON if R_g (Ω) and L_g (H) are an estimate. P (W), Q (var)
    and V (phase rms, V) are those of the power loops. ``ticks`` is the caller's 32-bit counter. The guards act in this
    order: time and inputs, plausibility, jump (:eq:`place-band`), hysteresis, doubt and staleness, rate
    (:eq:`place-rate`), certified box, design. Whatever the inputs are, the gains are those of a place and of powers
    within the box.
    """
    status, reason = 0, said
    elapsed = (ticks - s.ticks) & _MASK if s.started else 0
    step = min(elapsed, c.longest_ticks)
    if elapsed >= _HALF:
        elapsed, step, status, reason = c.update_ticks, 0, REFUSED, TIME
    elif not (isfinite(P) and isfinite(Q) and isfinite(V_rms)):
        status, reason = REFUSED, NOT_FINITE
    elif not (abs(P) <= c.power_range and abs(Q) <= c.power_range and 0.0 <= V_rms <= c.voltage_range):
        status, reason = REFUSED, RANGE
    elif said in (NOT_FINITE, SATURATED):
        status = REFUSED
    elif said == NO_REASON and not (isfinite(R_g) and isfinite(L_g)):
        status, reason = REFUSED, NOT_FINITE

    if status:
        P, Q, V_rms = s.P, s.Q, s.V_rms
    else:
        asked = P, Q, V_rms
        P = min(max(P, c.P[0]), c.P[1])
        Q = min(max(Q, c.Q[0]), c.Q[1])
        V_rms = min(max(V_rms, c.V_rms[0]), c.V_rms[1])
        status = 0 if (P, Q, V_rms) == asked else CLAMPED

    goal_scr, goal_r, count = s.goal_scr, s.goal_r_over_x, 0
    candidate_scr, candidate_r = s.candidate_scr, s.candidate_r_over_x
    if reason == NO_REASON and not (c.R_g[0] <= R_g <= c.R_g[1] and c.L_g[0] <= L_g <= c.L_g[1]):
        reason = IMPLAUSIBLE
    if reason == NO_REASON:
        scr, r_over_x = lookup.coordinates(R_g, L_g)
        if not near(scr, r_over_x, goal_scr, goal_r, c.jump, c.ratio_floor):
            agrees = s.agreed > 0 and near(scr, r_over_x, candidate_scr, candidate_r, c.jump, c.ratio_floor)
            count = s.agreed + 1 if agrees else 1
            candidate_scr, candidate_r = scr, r_over_x
            if count < c.confirm:
                reason = JUMP
            else:
                count = 0
        if reason == NO_REASON and not near(scr, r_over_x, goal_scr, goal_r, c.hysteresis, c.ratio_floor):
            goal_scr, goal_r = scr, r_over_x

    age = min(s.age + elapsed, _OLDEST)
    doubt = 0
    if reason != NO_REASON and s.doubt > 0:
        doubt = min(s.doubt + elapsed, _OLDEST)
    elif reason != NO_REASON and (s.told != 0 or reason == JUMP):
        doubt = 1
    stale = reason != NO_REASON and (age > c.lost_ticks or doubt > c.stale_ticks)
    if stale:
        goal_scr, goal_r = c.safe_scr, c.safe_r_over_x

    factor = 1.0 + step * c.rate_per_tick
    scr, r_over_x = limited(goal_scr, s.scr, factor), limited(goal_r, s.r_over_x, factor)
    place_scr = min(max(scr, c.scr[0]), c.scr[1])
    place_r = min(max(r_over_x, c.r_over_x[0]), c.r_over_x[1])
    aim_scr, aim_r = min(max(goal_scr, c.scr[0]), c.scr[1]), min(max(goal_r, c.r_over_x[0]), c.r_over_x[1])
    moving = CLAMPED if aim_scr != goal_scr or aim_r != goal_r else 0
    if abs(place_scr - aim_scr) > ARRIVED * aim_scr or abs(place_r - aim_r) > ARRIVED * aim_r:
        moving |= LIMITED

    normalised = lookup.normalised(place_scr, place_r)
    refused = status & REFUSED
    if normalised is None:
        reason = UNDESIGNED if reason == NO_REASON else reason
        gains, place_scr, place_r, P, Q, V_rms = s.gains, s.scr, s.r_over_x, s.P, s.Q, s.V_rms
        status = refused
    else:
        gains = lookup.gains(normalised, place_scr, place_r, P, Q, V_rms)
        status |= moving
    status |= FALLBACK if stale else 0
    status |= DOUBT if doubt else 0
    if reason == NO_REASON:
        status, age = status | FRESH, 0
    else:
        status |= HELD
    following = SchedulerState(
        1,
        ticks & _MASK,
        age,
        doubt,
        0,
        count,
        place_scr,
        place_r,
        goal_scr,
        goal_r,
        candidate_scr,
        candidate_r,
        P,
        Q,
        V_rms,
        gains,
    )
    return following, Answer(gains, status, reason, place_scr, place_r)


class Scheduler:
    """A lookup with its settings, its state and, if there is one, an estimator. Two threads must not share it."""

    def __init__(self, lookup: GainLookup, settings: SchedulerSettings, estimator: Estimator | None = None) -> None:
        self.lookup, self.settings, self.estimator = lookup, settings, estimator
        self._state = first_state(lookup, settings)
        self._fed = None if estimator is None else FedEstimator(estimator)

    @property
    def gains(self) -> PowerLoopGains:
        """The present gains. Before the first update they are those of the safe place."""
        return self._state.gains

    @property
    def grid(self) -> tuple[float, float]:
        """R_g (Ω) and L_g (H) of the place for which the present gains are made."""
        return self.lookup.grid(self._state.scr, self._state.r_over_x)

    def tell(self, *, limited: bool = False, surprised: bool = False) -> None:
        """Says what happened since the last update; the next one takes it into account (:func:`advance`).

        ``limited``: the converter limited its current. ``surprised``: the estimator, or anything else, has seen that
        the grid changed, and there is no estimate of the new one yet.
        """
        told = TOLD_LIMITED * bool(limited) | TOLD_SURPRISED * bool(surprised)
        self._state = self._state._replace(told=self._state.told | told)

    def update_estimate(
        self, R_g: float, L_g: float, P: float, Q: float, V_rms: float, ticks: int | np.integer[Any] | None = None
    ) -> Answer:
        """Updates the gains with an estimate in Ω and H and the measured P, Q and V, as in :func:`advance`.

        Without ``ticks`` the scheduler assumes that one nominal period has passed. The values of the numbers never
        raise an exception: a value that is not a number (True, a text, None) or not finite is refused with a reason.
        Raises ValueError if ``ticks`` is not a whole number.
        """
        return self._advance(NO_REASON, as_number(R_g), as_number(L_g), P, Q, V_rms, ticks)

    def hold(self, P: float, Q: float, V_rms: float, ticks: int | np.integer[Any] | None = None) -> Answer:
        """Makes an update without an estimate. The place continues to move to its goal."""
        return self._advance(NO_ESTIMATE, 0.0, 0.0, P, Q, V_rms, ticks)

    @property
    def probe(self) -> Probe | None:
        """The probe that the converter is to inject from now on for the estimator; None if there is none."""
        return None if self._fed is None else self._fed.probe

    def update(
        self,
        v: Any,
        i: Any,
        P: float,
        Q: float,
        V_rms: float,
        ticks: int | np.integer[Any] | None = None,
        **measured: Any,
    ) -> Answer:
        """Updates the gains with a window of v (V) and i (A), in the shape that the estimator takes.

        ``measured`` is the other data of the window that the estimator needs, as in
        :meth:`vsgdesign.identification.feeding.FedEstimator.window`. Every estimator but a network needs ``omega``.
        Raises ArtifactError if the scheduler has no estimator.
        """
        self.tell(limited=measured.get("limited", 0) > 0)
        found = self._feeding.window(as_numbers(v), as_numbers(i), **measured)
        return self._advance_by(found, P, Q, V_rms, ticks)

    def push(self, v: Any, i: Any, **measured: Any) -> bool:
        """Takes one sample of v and i, or its components. Returns whether an answer is due.

        When a window is complete, further samples are ignored until :meth:`update_pushed` is called. ``measured`` is as
        in :meth:`vsgdesign.identification.feeding.FedEstimator.push`.
        """
        fed = self._feeding
        if measured.get("limited", False):
            self.tell(limited=True)
        v, i = (x if type(x) is float else as_numbers(x) for x in (v, i))
        return fed.push(v, i, **measured)

    def update_pushed(self, P: float, Q: float, V_rms: float, ticks: int | np.integer[Any] | None = None) -> Answer:
        """Makes an :meth:`update` with the samples that were pushed, or a :meth:`hold` while no answer is due."""
        return self._advance_by(self._feeding.answer(), P, Q, V_rms, ticks)

    def _advance_by(
        self, found: Estimate | None, P: float, Q: float, V_rms: float, ticks: int | np.integer[Any] | None
    ) -> Answer:
        if found is None:
            return self.hold(P, Q, V_rms, ticks)
        said = SAID.get(found.status, NO_ESTIMATE)
        return self._advance(said, found.R_g, found.L_g, P, Q, V_rms, ticks)

    def start(self, R_g: float, L_g: float) -> PowerLoopGains:
        """Starts on a known grid instead of the safe place. Raises ArtifactError if the grid is not in the box."""
        c, R_g, L_g = self.settings, as_number(R_g), as_number(L_g)
        scr, r_over_x = self.lookup.coordinates(R_g, L_g) if L_g > 0.0 and isfinite(R_g + L_g) else (0.0, 0.0)
        first = first_state(self.lookup, c)
        normalised = self.lookup.normalised(scr, r_over_x)
        inside = c.scr[0] <= scr <= c.scr[1] and c.r_over_x[0] <= r_over_x <= c.r_over_x[1]
        if not inside or normalised is None:
            raise ArtifactError(
                f"R_g = {R_g:g} Ω, L_g = {L_g * 1e3:g} mH: the grid is not in the schedule's box (SCR {c.scr[0]:g} to "
                f"{c.scr[1]:g}, R/X {c.r_over_x[0]:g} to {c.r_over_x[1]:g}). Start without."
            )
        gains = self.lookup.gains(normalised, scr, r_over_x, first.P, first.Q, first.V_rms)
        self._state = first._replace(
            scr=scr, r_over_x=r_over_x, goal_scr=scr, goal_r_over_x=r_over_x, gains=gains, age=0
        )
        return gains

    def state(self) -> dict[str, Any]:
        """The whole state in JSON's types. A restored scheduler continues with the same bits."""
        fed = None if self._fed is None else self._fed.document()
        return state_document(self._state, self._made_for) | {"estimator": fed}

    def restore(self, document: dict[str, Any]) -> None:
        """Continues from a document of :meth:`state`. Raises ArtifactError if it is no state of this scheduler."""
        state, c = state_of(document, self._made_for), self.settings
        box = ((state.scr, c.scr), (state.r_over_x, c.r_over_x), (state.P, c.P), (state.Q, c.Q), (state.V_rms, c.V_rms))
        if not all(low <= value <= high for value, (low, high) in box):
            raise ArtifactError("state: its place or powers are outside the schedule's box; start afresh.")
        fed = document.get("estimator")
        if self._fed is not None:
            self._fed.restore(fed)
        elif fed is not None:
            raise ArtifactError("state.estimator: there is no estimator to remember it; start afresh.")
        self._state = state

    @cached_property
    def _made_for(self) -> str:
        """Hash of the table, the settings and the estimator to which a saved state belongs."""
        import hashlib  # its import costs a third of all others, and only saving and restoring a state needs it

        title = () if self.estimator is None else (self.estimator.title,)
        return hashlib.sha256(repr((self.settings, self.lookup, *title)).encode()).hexdigest()

    @property
    def _feeding(self) -> FedEstimator:
        if self._fed is None:
            raise ArtifactError(
                "no network and no other estimator: load the scheduler with weights, build one of ESTIMATORS, or give "
                "estimates (update_estimate)."
            )
        return self._fed

    def _advance(
        self, said: int, R_g: float, L_g: float, P: float, Q: float, V_rms: float, ticks: int | np.integer[Any] | None
    ) -> Answer:
        if ticks is None:
            ticks = self._state.ticks + self.settings.update_ticks
        elif type(ticks) is not int:
            ticks = _whole(ticks)
        powers = as_number(P), as_number(Q), as_number(V_rms)
        self._state, answer = advance(self.lookup, self.settings, self._state, said, R_g, L_g, *powers, ticks)
        return answer


def as_number(value: Any) -> float:
    """A measurement as a float.

    It is NaN for anything but a number (True, a text, None) and infinite beyond the range.
    """
    if type(value) is float:
        return value
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        return nan
    try:
        return float(value)
    except OverflowError:
        return inf if value > 0 else -inf


def as_numbers(values: Any) -> NDArray[np.float64]:
    """Samples as floats. All are NaN if the samples are anything but numbers."""
    array = np.asarray(values)
    return array.astype(float, copy=False) if array.dtype.kind in "fiu" else np.full(array.shape, nan)


def _whole(ticks: Any) -> int:
    if isinstance(ticks, np.integer):
        return int(ticks)
    raise ValueError(f"ticks = {ticks!r}: must be a whole number, the value of a counter.")


def scheduler_of(table: GainTable, estimator: Estimator | None = None, **changes: Any) -> Scheduler:
    """The scheduler of a table. ``changes`` to its settings are as in :func:`vsgdesign.runtime.guards.settings_of`."""
    lookup = gain_lookup(table_schedule(table), V_n_rms=table.base.V_rated_rms)
    settings = settings_of(table, **changes)
    if isinstance(estimator, NeuralEstimator):
        _check_same_case(lookup, settings, estimator)
    return Scheduler(lookup, settings, estimator)


def closed_form_scheduler(
    schedule: ClosedFormSchedule,
    settings: SchedulerSettings,
    *,
    V_n_rms: float,
    S_rated: float = 0.0,
    scr_basis: str = "impedance",
    estimator: Estimator | None = None,
) -> Scheduler:
    """The scheduler of a closed form, which takes the Jacobian from the measured P, Q and V and needs no table.

    V_n_rms is the nominal voltage in V. S_rated (VA) and ``scr_basis`` define the SCR of the settings.
    """
    return Scheduler(gain_lookup(schedule, V_n_rms=V_n_rms, S_rated=S_rated, scr_basis=scr_basis), settings, estimator)


def load_scheduler(
    table: str | Path,
    weights: str | Path | None = None,
    *,
    fit: dict[str, Any] | None = None,
    study: Study | None = None,
    **changes: Any,
) -> Scheduler:
    """The scheduler of a gain table's file and, if given, a weights file.

    ``fit`` holds arguments of :func:`vsgdesign.identification.neural.neural_estimator`. With ``study``, a table that
    was not designed from this study is refused. Raises ArtifactError where a file is damaged or does not fit.
    """
    found = read_table_of(table, study)
    if weights is None:
        return scheduler_of(found, **changes)
    from vsgdesign.artifacts.network_weights import read_network_weights

    trained = read_network_weights(weights)
    window = window_settings(trained.window.period)
    return scheduler_of(found, neural_estimator(trained, **(fit or {})), **(window | changes))


def read_table_of(path: str | Path, study: Study | None = None) -> GainTable:
    """The table of a file.

    Raises ArtifactError if it is damaged, if a newer version wrote it, or if it was not designed from the study. In the
    last case the message names the fields that differ.
    """
    from vsgdesign.artifacts.design_inputs import study_differences
    from vsgdesign.artifacts.gain_table_file import read_table_file

    table = read_table_file(path)
    differences = [] if study is None else study_differences(table, study)
    if differences:
        raise ArtifactError(
            f"{path}: the table was not designed from this study. Give the table of this study, or design one: "
            "vsgdesign table build.\n" + "\n".join(f"  - {line}" for line in differences)
        )
    return table


def _check_same_case(lookup: GainLookup, settings: SchedulerSettings, estimator: NeuralEstimator) -> None:
    """Refuses a network that was trained for a converter of another size and knows none of the table's grids."""
    corners = [lookup.grid(scr, r_over_x) for scr in settings.scr for r_over_x in settings.r_over_x]
    (R_low, L_low), (R_high, L_high) = estimator.least, estimator.largest
    R_all, L_all = zip(*corners, strict=True)
    if R_low > max(R_all) or R_high < min(R_all) or L_low > max(L_all) or L_high < min(L_all):
        raise ArtifactError(
            f"the network was trained for R_g {R_low:g} to {R_high:g} Ω, L_g {L_low * 1e3:g} to {L_high * 1e3:g} mH. "
            "The table has none of these grids: they are of different converters. Give those of one case."
        )
