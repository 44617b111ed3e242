"""Measured errors of an estimator as a file that guards itself: what a gain table's page holds against its error set.

Every error is relative to the magnitude of the true grid's impedance at the rated frequency: (R̂ − R)/|Z|, (X̂ − X)/|Z|,
with R/|Z| of the grid beside it. ``evidence/field.py`` measures them and writes the file that the package ships.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.guarded_file import GuardedFile, rows_on_a_line
from vsgdesign.study.given_files import WEIGHTS_BYTES

Array = NDArray[np.float64]
Pair = tuple[float, float]

KIND = "vsgdesign measured estimate errors"
SCHEMA = 1

SHIPPED = Path(__file__).with_name("measured_errors.json")
"""The file of the package."""


@dataclass(frozen=True, eq=False)
class GridBin:
    """Errors at rest on the grids of a range of SCR (of |Z|) and X/R, ends included."""

    scr: Pair
    x_over_r: Pair
    runs: int
    answers: int
    """Answers, valid or held, of which ``errors`` are some, evenly."""
    valid: float
    """Share of the answers that are valid."""
    errors: Array
    """(n, 3): error of R, error of X, and R of the true grid, each over |Z|."""


@dataclass(frozen=True, eq=False)
class JumpInstant:
    """Errors of what a schedule has so long after a jump of the grid, valid or held, over all jumps."""

    t_s: float
    errors: Array
    """(n, 3) as in :class:`GridBin`, about the new grid; NaN where nothing was ever estimated."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredErrors:
    """Errors of one estimator on some converters in one background."""

    estimator: str
    converters: tuple[str, ...]
    background: str
    """In words."""
    runs: int
    seed: int
    """The first."""
    bins: tuple[GridBin, ...]
    jumps: tuple[JumpInstant, ...] = ()
    provenance: dict[str, str] = field(default_factory=dict)


def shipped_errors() -> MeasuredErrors | None:
    """The errors that the package ships; None where it ships none. Raises ArtifactError where the file is damaged.

    A process reads the file once: to check it takes longer than to draw a figure. The arrays cannot be written to.
    """
    return _read_once(SHIPPED) if SHIPPED.exists() else None


@functools.cache
def _read_once(path: Path) -> MeasuredErrors:
    measured = MEASURED_FILE.read(path)
    for one in (*measured.bins, *measured.jumps):
        one.errors.flags.writeable = False
    return measured


def _document(measured: MeasuredErrors) -> dict[str, Any]:
    found = {"kind": KIND, "schema": SCHEMA} | {
        name: getattr(measured, name)
        for name in ("estimator", "converters", "background", "runs", "seed", "provenance")
    }
    found["bins"] = [asdict(one) | {"errors": _rows(one.errors)} for one in measured.bins]
    found["jumps"] = [{"t_s": one.t_s, "errors": _rows(one.errors)} for one in measured.jumps]
    return plain(found)


def _rows(errors: Array) -> list[list[float | None]]:
    return [[float(value) if np.isfinite(value) else None for value in row] for row in errors]


def _from_document(document: dict[str, Any]) -> MeasuredErrors:
    own: dict[str, Any] = {name: value for name, value in document.items() if name not in ("kind", "schema")}
    bins = tuple(
        GridBin(
            **one | {"errors": _errors(one["errors"]), "scr": _pair(one["scr"]), "x_over_r": _pair(one["x_over_r"])}
        )
        for one in own.pop("bins")
    )
    jumps = tuple(JumpInstant(float(one["t_s"]), _errors(one["errors"])) for one in own.pop("jumps"))
    own |= {"converters": tuple(own["converters"]), "bins": bins, "jumps": jumps}
    return MeasuredErrors(**own)


def _errors(rows: list[list[float | None]]) -> Array:
    return np.array([[np.nan if value is None else value for value in row] for row in rows], dtype=float).reshape(-1, 3)


def _pair(values: list[float]) -> Pair:
    low, high = values
    return float(low), float(high)


def _faults(measured: MeasuredErrors) -> Iterator[str]:
    for k, one in enumerate(measured.bins):
        for name in ("scr", "x_over_r"):
            low, high = getattr(one, name)
            if not 0.0 < low <= high:
                yield f"bins[{k}].{name}: {low:g} {high:g} must be positive, the smaller first"
        if not np.isfinite(one.errors).all():
            yield f"bins[{k}].errors: must be numbers"
        elif len(one.errors) and not (np.abs(one.errors[:, 2]) <= 1.0).all():
            yield f"bins[{k}].errors: R over |Z| must be at most 1"
        if not 0.0 <= one.valid <= 1.0:
            yield f"bins[{k}].valid: {one.valid:g} must be a share"
    instants = [one.t_s for one in measured.jumps]
    if instants != sorted(set(instants)):
        yield "jumps: their t_s must increase"


MEASURED_FILE = GuardedFile(
    kind=KIND,
    schema=SCHEMA,
    what="a file of measured errors",
    origin='written by "python -m evidence field"',
    again="measure again",
    document=_document,
    build=_from_document,
    faults=_faults,
    most_bytes=WEIGHTS_BYTES,
    layout=rows_on_a_line,
)
