"""The gain scheduler as it runs on the controller. It turns an estimate into guarded gains with a status."""

from __future__ import annotations

from functools import cached_property
from math import inf, nan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import (
    IMPLAUSIBLE,
    NO_ESTIMATE,
    NO_REASON,
    NOT_FINITE,
    SATURATED,
    TOLD_CHANGED,
    TOLD_LIMITED,
    TOLD_SURPRISED,
    SchedulerInput,
    SchedulerState,
)
from vsgdesign.errors import ArtifactError
from vsgdesign.identification import Estimate, Estimator, Probe
from vsgdesign.identification.feeding import FedEstimator
from vsgdesign.identification.interface import KnowsItsError
from vsgdesign.identification.neural import NeuralEstimator, neural_estimator
from vsgdesign.runtime.guards import SchedulerSettings, searching_settings, settings_of, window_settings
from vsgdesign.runtime.schedule import ClosedFormSchedule
from vsgdesign.runtime.table import table_schedule
from vsgdesign.runtime.updating import (
    Answer,
    Covariance,
    GainLookup,
    advance,
    first_state,
    gain_lookup,
    given_input,
    start_state,
    state_document,
    state_of,
    told_state,
)

if TYPE_CHECKING:
    from pathlib import Path

    from vsgdesign.artifacts.gain_table import GainTable
    from vsgdesign.study.parameters.study import Study

SAID = {
    "ok": NO_REASON,
    "not finite": NOT_FINITE,
    "saturated": SATURATED,
    "outside": IMPLAUSIBLE,
    "implausible": IMPLAUSIBLE,
}
"""The reason that the guards are given for a status of an estimate. Any other status means that there was no
estimate."""


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
    def present(self) -> SchedulerState:
        """The state after the last update."""
        return self._state

    def go_on(self, state: SchedulerState) -> None:
        """Goes on from a state of another scheduler of the same table and settings."""
        self._state = state

    @property
    def grid(self) -> tuple[float, float]:
        """R_g (Ω) and L_g (H) of the place for which the present gains are made."""
        return self.lookup.grid(self._state.scr, self._state.r_over_x)

    def tell(self, *, limited: bool = False, surprised: bool = False, changed: bool = False) -> None:
        """Says what happened since the last update; the next one takes it into account (:func:`advance`).

        ``limited``: the converter limited its current. ``surprised``: the estimator, or anything else, has seen that
        the grid changed, and there is no estimate of the new one yet. ``changed``: the estimator has decided that the
        impedance of the grid changed. This confirms the next estimate, however far away it is.
        """
        told = TOLD_LIMITED * bool(limited) | TOLD_SURPRISED * bool(surprised) | TOLD_CHANGED * bool(changed)
        if told:
            self._state = told_state(self._state, told)

    def update_estimate(
        self,
        R_g: float,
        L_g: float,
        P: float,
        Q: float,
        V_rms: float,
        ticks: int | np.integer[Any] | None = None,
        covariance: tuple[float, float, float] | None = None,
        changed: bool = False,
    ) -> Answer:
        """Updates the gains with an estimate in Ω and H and the measured P, Q and V, as in :func:`advance`.

        Without ``ticks`` the scheduler assumes that one nominal period has passed. ``covariance`` is (var R_g in Ω²,
        cov(R_g, L_g) in Ω·H, var L_g in H²) of the estimate's error: the goal then follows the estimate fully only if
        its 95 % set fits the errors for which the schedule is designed, otherwise by the share that fits. Without it,
        the estimate is followed fully. ``changed`` is as in :meth:`tell`.

        The values of the numbers never raise an exception: a value that is not a number (True, a text, None) or not
        finite is refused with a reason. Raises ValueError if ``ticks`` is not a whole number, or if ``covariance`` is
        not three values.
        """
        if changed:
            self.tell(changed=True)
        return self._advance(NO_REASON, as_number(R_g), as_number(L_g), P, Q, V_rms, ticks, _three(covariance))

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
        self.tell(surprised=found.surprised, changed=found.changed)
        said = SAID.get(found.status, NO_ESTIMATE)
        return self._advance(said, found.R_g, found.L_g, P, Q, V_rms, ticks, covariance_of(found, self.estimator))

    def start(self, R_g: float, L_g: float, *, nearest: bool = False) -> PowerLoopGains:
        """Starts on a known grid instead of the safe place. Raises ArtifactError if the grid is not in the box.

        With ``nearest``, a grid outside the box is taken for the nearest place in it, as every update takes it.
        """
        c, R_g, L_g = self.settings, as_number(R_g), as_number(L_g)
        state, known = self._started(R_g, L_g, nearest)
        if not known:
            raise ArtifactError(
                f"R_g = {R_g:g} Ω, L_g = {L_g * 1e3:g} mH: the grid is not in the schedule's box (SCR {c.scr[0]:g} to "
                f"{c.scr[1]:g}, R/X {c.r_over_x[0]:g} to {c.r_over_x[1]:g}). Start without."
            )
        self._state = state
        return state.gains

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
        self,
        said: int,
        R_g: float,
        L_g: float,
        P: float,
        Q: float,
        V_rms: float,
        ticks: int | np.integer[Any] | None,
        covariance: Covariance | None = None,
    ) -> Answer:
        if ticks is None:
            ticks = self._state.ticks + self.settings.update_ticks
        elif type(ticks) is not int:
            ticks = _whole(ticks)
        powers = as_number(P), as_number(Q), as_number(V_rms)
        given = given_input(said, R_g, L_g, *powers, ticks, covariance)
        self._state, answer = self._updated(given)
        return answer

    def _updated(self, given: SchedulerInput) -> tuple[SchedulerState, Answer]:
        return advance(self.lookup, self.settings, self._state, given)

    def _started(self, R_g: float, L_g: float, nearest: bool) -> tuple[SchedulerState, bool]:
        return start_state(self.lookup, self.settings, R_g, L_g, nearest)


def covariance_of(found: Estimate, estimator: Estimator | None) -> Covariance | None:
    """The covariance of an estimate, if there is one and its estimator is calibrated."""
    if found.covariance is None or not (isinstance(estimator, KnowsItsError) and estimator.calibrated):
        return None
    (var_R, cov_RL), (_, var_L) = found.covariance.tolist()
    return var_R, cov_RL, var_L


def _three(covariance: Any) -> Covariance | None:
    if covariance is None:
        return None
    try:
        var_R, cov_RL, var_L = covariance
    except (TypeError, ValueError):
        raise ValueError(
            f"covariance = {covariance!r}: must be three values, var R_g in Ω², cov(R_g, L_g) in Ω·H and var L_g in H²."
        ) from None
    return as_number(var_R), as_number(cov_RL), as_number(var_L)


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
    """The scheduler of a table. ``changes`` to its settings are as in :func:`vsgdesign.runtime.guards.settings_of`.

    It waits for an estimator that is calibrated as long as this may be silent.
    """
    if isinstance(estimator, KnowsItsError):
        changes = searching_settings(estimator.finds_within) | changes
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


def load_neural_estimator(path: str | Path, **fit: Any) -> NeuralEstimator:
    """The estimator of a weights file. ``fit`` is as in :func:`vsgdesign.identification.neural.neural_estimator`.

    Raises ArtifactError where the file is damaged or its weights do not fit.
    """
    from vsgdesign.artifacts.network_weights import read_network_weights

    return neural_estimator(read_network_weights(path), **fit)


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
