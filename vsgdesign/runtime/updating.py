"""One update of the scheduler on plain floats: :mod:`vsgdesign.equations.scheduling` with the data of a lookup,
and how the state is saved and restored."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import SchedulerInput, SchedulerState
from vsgdesign.equations.scheduling import begun, told_state, updated
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime.guards import REASONS, SchedulerSettings
from vsgdesign.runtime.lookup import GainLookup
from vsgdesign.runtime.schedule import on_floats

__all__ = ["Answer", "Covariance", "advance", "first_state", "given_input", "start_state", "told_state"]

_updated, _begun = on_floats(updated), on_floats(begun)

Covariance = tuple[float, float, float]
"""var R_g (Ω²), cov(R_g, L_g) (Ω·H) and var L_g (H²)."""

NOT_KNOWN = 0.0, 0.0, 0.0


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
    scr, r_over_x = settings.safe_scr, settings.safe_r_over_x
    if lookup.normalised(scr, r_over_x) is None:
        raise ArtifactError(
            f"safe place SCR {scr:g}, R/X {r_over_x:g}: the table has no design there. Give another (safe_scr, "
            "safe_r_over_x) on the strong side."
        )
    return start_state(lookup, settings, 0.0, 0.0)[0]


def start_state(
    lookup: GainLookup, settings: SchedulerSettings, R_g: float, L_g: float, nearest: bool = False
) -> tuple[SchedulerState, bool]:
    """The state on a known grid, R_g in Ω and L_g in H, and whether the grid is in the box; else it is the first one.

    With ``nearest``, a grid outside the box is taken for the nearest place in it.
    """
    state, known = _begun(lookup.table, settings.limits, R_g, L_g, nearest, lookup.functions_of_floats)
    return state, bool(known)


def given_input(
    said: int,
    R_g: float,
    L_g: float,
    P: float,
    Q: float,
    V_rms: float,
    ticks: int,
    covariance: Covariance | None = None,
) -> SchedulerInput:
    """What an update is given. ``said`` is the reason why there is no estimate, or NO_REASON if R_g (Ω) and L_g (H) are
    an estimate, with its ``covariance`` if it is known. P (W), Q (var) and V (phase rms, V) are those of the power
    loops. ``ticks`` is the caller's 32-bit counter."""
    var_R, cov_RL, var_L = covariance or NOT_KNOWN
    known = 0 if covariance is None else 1
    return SchedulerInput(said, R_g, L_g, known, var_R, cov_RL, var_L, P, Q, V_rms, ticks & 0xFFFFFFFF)


def advance(
    lookup: GainLookup, settings: SchedulerSettings, state: SchedulerState, given: SchedulerInput
) -> tuple[SchedulerState, Answer]:
    """Makes one update. Returns the next state and the answer.

    Whatever the inputs are, the gains are those of a place and of powers within the box.
    """
    following, status, reason = _updated(lookup.table, settings.limits, state, given, lookup.functions_of_floats)
    return following, Answer(following.gains, status, reason, following.scr, following.r_over_x)


SCHEMA = 4

_WHOLE = ("started", "ticks", "age", "doubt", "told", "agreed", "refuted")


def state_document(state: SchedulerState, made_for: str) -> dict[str, Any]:
    """A state in JSON's types. ``made_for`` identifies the scheduler to which it belongs."""
    return {"schema": SCHEMA, "made_for": made_for} | state._asdict() | {"gains": list(state.gains)}


def state_of(document: dict[str, Any], made_for: str) -> SchedulerState:
    """The state of a document, with every number the same to the last bit.

    Raises ArtifactError if the state is not complete, has a newer schema, or was saved with another table.
    """
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        raise ArtifactError(f"state: it has schema {schema!r}, but this version reads {SCHEMA}; start afresh.")
    if document.get("made_for") != made_for:
        raise ArtifactError("state: it was saved with another table or other settings; start afresh.")
    values: dict[str, Any] = {}
    for name in SchedulerState._fields:
        value = document.get(name)
        if name == "gains":
            if not (isinstance(value, list) and len(value) == len(PowerLoopGains._fields) and all(map(_finite, value))):
                raise ArtifactError("state.gains: must be eight numbers; start afresh.")
            values[name] = PowerLoopGains(*map(float, value))
        elif name in _WHOLE:
            if not (isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**32):
                raise ArtifactError(f"state.{name} = {value!r}: must be a whole number of 32 bits; start afresh.")
            values[name] = value
        else:
            if not _finite(value):
                raise ArtifactError(f"state.{name} = {value!r}: must be a number; start afresh.")
            values[name] = float(value)  # type: ignore[arg-type]
    return SchedulerState(**values)


def _finite(value: object) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)
