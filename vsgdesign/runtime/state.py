"""How the state of a scheduler is saved and restored."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import SchedulerState
from vsgdesign.errors import ArtifactError

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
