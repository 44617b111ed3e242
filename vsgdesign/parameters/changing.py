"""Studies in Python: built or changed as documents, so that one reader checks them all."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.parameters.inner_loops import InnerLoopSource
from vsgdesign.parameters.loading import FILES, merge, study_from_document
from vsgdesign.parameters.reader import Asked
from vsgdesign.parameters.study import InnerLoopRequest, Study, StudyOrigin
from vsgdesign.parameters.units import UnitError, parse_quantity

AFTER_THE_LAST_EVENT = 3.0
"""Seconds that a run goes on where a study built in Python says no duration: the loops settle in about one."""

ONE_CONTROLLER = ({"name": "scheduled", "kind": "scheduled"},)
"""The controllers of a study built in Python that names none: the closed form on the true impedance."""


def complete(document: Mapping[str, Any]) -> dict[str, Any]:
    """A document with what a study built in Python may leave out: controllers, references (0) and duration.

    A study file has to say them; here a system alone (a packaged case) is enough for a first run.
    """
    simulation = document.get("simulation", {})
    if not isinstance(simulation, Mapping):
        return dict(document)  # the reader says what is wrong with it
    given = {"P_ref": 0.0, "Q_ref": 0.0, **simulation}
    if "duration" not in given:
        given["duration"] = AFTER_THE_LAST_EVENT + max(map(_time_of, _tables(document, "events")), default=0.0)
    return {"controllers": list(ONE_CONTROLLER), **document, "simulation": given}


def plain_document(value: Any) -> Any:
    """A copy as TOML would have given it: NumPy's numbers as numbers, tuples and arrays as lists, paths as texts."""
    if isinstance(value, Mapping):
        return {str(key): plain_document(item) for key, item in value.items()}
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value)
    if hasattr(value, "tolist"):
        return plain_document(value.tolist())
    return [plain_document(item) for item in value] if isinstance(value, list | tuple | range) else value


def built(
    document: Mapping[str, Any],
    origin: StudyOrigin,
    changes: Mapping[str, Any],
    inner_loops: InnerLoopSource | None,
    asked: dict[str, Asked] | None = None,
) -> Study:
    """The study of a merged document with changes; the origin that it keeps says what was written, not what was
    filled in. ``asked`` collects every quantity that is read, by its full name. Raises StudyError with every fault."""
    written = merge(document, _absolute(plain_document(changes)))
    study = study_from_document(complete(written), origin, inner_loops, asked)
    return replace(study, origin=replace(origin, document=written))


def changed_with_same_inner_loops(
    study: Study, changes: Mapping[str, Any], asked: dict[str, Asked] | None = None
) -> Study:
    """The study with changes, as :meth:`vsgdesign.parameters.study.Study.with_changes`, but with the inner-loop gains
    that it has, also where they were designed for data that the changes alter.

    ``asked`` collects every quantity that is read, by its full name. Raises StudyError with every fault.
    """
    origin = _origin_of(study)
    gains = study.inner_gains, study.omega_t
    after = built(origin.document, origin, changes, lambda _: gains, asked)
    return replace(after, files=study.files)


def _origin_of(study: Study) -> StudyOrigin:
    if study.origin is None:
        raise StudyError(
            study.name,
            [Fault("study", "", "was built from its parts and not read from a document", "Use vd.load.")],
        )
    return study.origin


def changed(study: Study, changes: Mapping[str, Any]) -> Study:
    """:meth:`vsgdesign.parameters.study.Study.with_changes`."""
    origin = _origin_of(study)

    def same_gains(request: InnerLoopRequest) -> tuple[InnerLoopGains, float]:
        if request == study.inner_request:
            return study.inner_gains, study.omega_t
        raise StudyError(
            origin.source,
            [
                Fault(
                    "inner_loops",
                    "",
                    "the gains were designed for data that differ from those of the changed study",
                    "Make the change in vd.load, which designs them again, or give the gains.",
                )
            ],
        )

    unchanged = built(origin.document, origin, {}, same_gains)
    if replace(unchanged, files=study.files) != study:
        raise StudyError(
            study.name,
            [
                Fault(
                    "study",
                    "",
                    "some of its fields were replaced directly, and a change of its document would lose them",
                    "Make every change with with_changes, with_controllers or with_events.",
                )
            ],
        )
    after = built(origin.document, origin, changes, same_gains)
    return replace(after, files=study.files)


def _tables(document: Mapping[str, Any], section: str) -> list[Mapping[str, Any]]:
    found = document.get(section, [])
    return [table for table in found if isinstance(table, Mapping)] if isinstance(found, list | tuple) else []


def _time_of(event: Mapping[str, Any]) -> float:
    try:
        return parse_quantity(event.get("time"), "s")
    except UnitError:
        return 0.0  # the reader says what is wrong with it


def _absolute(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes with the files that they name made absolute: what is written in Python is relative to where it runs."""
    found = dict(changes)
    for section, field in FILES:
        tables = found.get(section)
        for table in tables if isinstance(tables, list) else [tables]:
            if isinstance(table, dict) and isinstance(table.get(field), str):
                named = table[field]
                if field != "recipe" or named.endswith(".toml"):
                    table[field] = os.path.abspath(named)
    return found
