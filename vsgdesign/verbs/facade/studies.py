"""Studies: loaded from a file or a packaged case, or written in Python, and checked by one reader."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.study.parameters.building import GRID, Sections
from vsgdesign.study.parameters.controllers import CONTROLLER
from vsgdesign.study.parameters.events import event_fields
from vsgdesign.study.parameters.fields import Field, fields_of, picked
from vsgdesign.study.parameters.inner_loops import InnerLoopSource
from vsgdesign.study.parameters.loading import (
    built,
    files_of,
    merged_document,
    plain_document,
    read_document,
    type_text,
)
from vsgdesign.study.parameters.scenario import SimulationSpec
from vsgdesign.study.parameters.study import InnerLoopRequest, Study, StudyOrigin

_SIMULATION = ("P_ref", "Q_ref", "duration", "bridge", "start", "log_interval")
"""Fields of [simulation] that :func:`load` takes without their section."""

F = TypeVar("F", bound=Callable[..., Any])


def arguments() -> dict[str, tuple[Field, ...]]:
    """The fields that each function below takes by name. ``studies.pyi`` is written from them."""
    return {
        "load": (*picked(SimulationSpec, *_SIMULATION), *fields_of(Sections)),
        "grid": GRID,
        "event": event_fields(),
        "controller": CONTROLLER,
    }


def _with_arguments(function: F) -> F:
    """The function with a signature that names the fields it takes, for ``help`` and notebooks."""
    signature = inspect.signature(function)
    given = [one for one in signature.parameters.values() if one.kind is not inspect.Parameter.VAR_KEYWORD]
    named = [
        inspect.Parameter(one.name, inspect.Parameter.KEYWORD_ONLY, default=..., annotation=type_text(one))
        for one in arguments()[function.__name__]
        if one.name not in signature.parameters
    ]
    setattr(function, "__signature__", signature.replace(parameters=[*given, *named]))  # noqa: B010 - for pyright
    return function


@_with_arguments
def load(source: str | Path | Mapping[str, Any], **changes: Any) -> Study:
    """The study of a file, of a packaged case (``"case:NAME"``) or of a document (a mapping, as TOML would give it).

    ``changes`` are the sections of a study file: ``grid=vd.grid(scr=3, x_over_r=4)``, ``controllers=[...]``,
    ``events=[...]``, ``specification={...}``. ``P_ref``, ``Q_ref``, ``duration``, ``bridge``, ``start`` and
    ``log_interval`` of the simulation may be given without their section. Values are in SI units or texts with a unit
    ("4 kW"). Required fields that are left out get a default: one scheduled controller, references of zero, and a run
    that ends three seconds after the last event.

    If the source does not give the inner loops, they are designed. Those of a study file are kept beside it for the
    next time. Raises StudyError with every fault at once.
    """
    if not isinstance(source, Mapping) and not changes and not str(source).startswith("case:"):
        from vsgdesign.verbs.pipeline.opening import open_study

        return open_study(source)
    origin, files = _read(source)
    return replace(built(origin.document, origin, _sections(changes), _inner_loops(files)), files=files)


@_with_arguments
def grid(**fields: Any) -> dict[str, Any]:
    """A grid with ``scr`` and ``x_over_r``, or with ``R_g`` (Ω) and ``L_g`` (H).

    In an event, ``scr`` or ``x_over_r`` alone may be enough.
    """
    return fields


@_with_arguments
def event(time: float | str, **fields: Any) -> dict[str, Any]:
    """An event at a time in s, or at a text such as "2 s".

    The fields are those of [[events]] in a study file.
    """
    return {"time": time} | fields


@_with_arguments
def controller(name: str, kind: str = "scheduled", **fields: Any) -> dict[str, Any]:
    """A controller, ``scheduled`` or ``fixed``, with the fields of a study file's [[controllers]]."""
    return {"name": name, "kind": kind} | fields


def _sections(changes: Mapping[str, Any]) -> dict[str, Any]:
    """The changes by section. Fields of the simulation are moved into its section."""
    found = {key: value for key, value in changes.items() if key not in _SIMULATION}
    alone = {key: changes[key] for key in _SIMULATION if key in changes}
    if alone:
        found["simulation"] = {**found.get("simulation", {}), **alone}
    return found


def _read(source: str | Path | Mapping[str, Any]) -> tuple[StudyOrigin, tuple[str, ...]]:
    """The merged document of a source, and its files."""
    if isinstance(source, Mapping):
        document = merged_document(plain_document(source))
        return StudyOrigin(document, ".", "study", "study"), ()
    if str(source).startswith("case:"):
        name = str(source).removeprefix("case:")
        document = merged_document({"base": str(source)}, ".", str(source))
        return StudyOrigin(document, ".", str(source), name), ()
    return read_document(source), files_of(source)


def _inner_loops(files: tuple[str, ...]) -> InnerLoopSource:
    """Source of gains for a request: those kept beside the study's file if they fit, otherwise newly designed ones."""

    def gains(request: InnerLoopRequest) -> tuple[InnerLoopGains, float]:
        from vsgdesign.verbs.pipeline.opening import design_record, kept_record

        record = kept_record(request, files) or design_record(request)
        return record.gains, record.omega_t

    return gains
