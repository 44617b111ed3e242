"""Designed inner loops as a file: the gains that every verb uses, what they were designed for, what they keep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.guarded_file import GuardedFile, content_hash, is_number
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.study.parameters.study import InnerLoopRequest

KIND = "vsgdesign inner loops"
SCHEMA = 1


@dataclass(frozen=True)
class KeptPromise:
    """The worst value of one promise over the grids of the design, and the grid at which it occurs."""

    name: str
    value: float | None
    """None: there is none, since a loop is unstable."""
    target: float | None
    scr: float | None
    x_over_r: float | None


@dataclass(frozen=True)
class InnerLoopsRecord:
    """Gains of the inner loops as designed, in SI."""

    request: dict[str, Any]
    """What they were designed for, in JSON's types: converter, filter, grids, settling time, seed."""
    gains: InnerLoopGains
    omega_t: float
    """Corner of the transient impedance, rad/s."""
    score: float
    """The least share of its target that a promise reaches; at 1 or more all promises are kept."""
    limiting: str
    """The promise that reaches the least share."""
    promises: tuple[KeptPromise, ...]

    @property
    def hash(self) -> str:
        """SHA-256 of the content."""
        return content_hash(_document(self))


def request_document(request: InnerLoopRequest) -> dict[str, Any]:
    """A request in JSON's types. Equal documents are designed alike; those of one converter are as they always were."""
    document = plain(request)
    if request.decay_apart == 0.0:
        del document["decay_apart"]
    return document


def differing_fields(request: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """Dotted names of the fields in which two requests differ, with both values: "filter.L_1 (0.001, now 0.002)"."""
    ours, theirs = dict(_flat(request)), dict(_flat(other))
    names = [name for name in {**ours, **theirs} if ours.get(name) != theirs.get(name)]
    return [f"{name} ({_shown(ours.get(name))}, now {_shown(theirs.get(name))})" for name in names]


def write_inner_loops(record: InnerLoopsRecord, path: str | Path) -> None:
    """The record as JSON with its sha256: equal designs give equal bytes. Whole or not at all. Raises ArtifactError."""
    INNER_LOOPS_FILE.write(record, path)


def read_inner_loops_file(path: str | Path) -> InnerLoopsRecord:
    """A record from its file.

    Raises ArtifactError with what to do where the file is missing, cut short, of another kind or a newer schema,
    changed since it was written, or holds what are no gains.
    """
    return INNER_LOOPS_FILE.read(path)


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flat(item, f"{name}.{key}" if name else key)
    else:
        yield name, value


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _document(record: InnerLoopsRecord) -> dict[str, Any]:
    return {
        "kind": KIND,
        "schema": SCHEMA,
        "gains": plain(record.gains._asdict()) | {"omega_t": float(record.omega_t)},
        "score": float(record.score),
        "limiting": record.limiting,
        "promises": [plain(promise) for promise in record.promises],
        "request": record.request,
    }


def _from_document(document: dict[str, Any]) -> InnerLoopsRecord:
    gains = dict(document["gains"])
    omega_t = gains.pop("omega_t")
    return InnerLoopsRecord(
        request=document["request"],
        gains=InnerLoopGains(**gains),
        omega_t=omega_t,
        score=document["score"],
        limiting=document["limiting"],
        promises=tuple(KeptPromise(**promise) for promise in document["promises"]),
    )


def _faults(record: InnerLoopsRecord) -> Iterator[str]:
    for name, value in (*record.gains._asdict().items(), ("omega_t", record.omega_t)):
        if not is_number(value):
            yield f"gains.{name}: {value!r} must be a number"
        elif name in ("K_pv", "K_iv", "K_pc", "K_ic", "omega_t") and value <= 0.0:
            yield f"gains.{name}: {value!r} must be positive"
    if not isinstance(record.request, dict):
        yield "request: must be a table"
    if not is_number(record.score):
        yield f"score: {record.score!r} must be a number"


INNER_LOOPS_FILE = GuardedFile(
    kind=KIND,
    schema=SCHEMA,
    what="a file of designed inner loops",
    origin='written by "vsgdesign inner"',
    again="design them again",
    document=_document,
    build=_from_document,
    faults=_faults,
)
