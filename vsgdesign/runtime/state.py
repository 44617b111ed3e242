"""The state of a scheduler between two updates, and how it is saved."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import ArtifactError

SCHEMA = 4

_WHOLE = ("started", "ticks", "age", "doubt", "told", "agreed", "refuted")


class SchedulerState(NamedTuple):
    """Everything, besides its inputs, on which the next answer depends."""

    started: int
    """Whether there was an update: 0 until the first one."""
    ticks: int
    """The caller's counter at the last update."""
    age: int
    """Ticks since the last estimate that was followed."""
    doubt: int
    """Ticks since the grid may have changed, or since the last surprise, without an estimate that was followed. 0:
    there is no doubt."""
    told: int
    """What was told since the last update: bits of TOLD_LIMITED, TOLD_SURPRISED and TOLD_CHANGED. The last one stays
    until an estimate is accepted. SURPRISED_BEFORE is kept here, too."""
    agreed: int
    """Windows that agree on a jump so far. While a confirmed jump is followed in part, it stays at their limit."""
    refuted: int
    """Ticks since the estimator decided that the grid has left its place. 0: that place may be returned to."""
    scr: float
    """The place for which the gains are made."""
    r_over_x: float
    goal_scr: float
    """The goal: the place to which the present place moves."""
    goal_r_over_x: float
    candidate_scr: float
    """A jump that waits to be confirmed, or is followed in part."""
    candidate_r_over_x: float
    left_scr: float
    """The place that the grid has left."""
    left_r_over_x: float
    P: float
    """Last good measurement, within the box: W, var, V."""
    Q: float
    V_rms: float
    gains: PowerLoopGains


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
