"""The grids of a page without a server, and what the linear model says of every controller on each of them.

The numbers are packed as columns: columns that are the same for all cells are one number, equal columns are kept once,
and neighbours are predicted from each other, so that little is left to deflate. ``page/columns.js`` reads it back.
Numbers that a simulation begins with keep all their bits; figures keep :data:`BITS` of them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.maps import full_order_cells
from vsgdesign.linear.stability.step_responses import full_order_settling
from vsgdesign.report.explore.linear import OF_MODEL, figures_of, finite, row_of
from vsgdesign.report.explore.maps import cells_at, limit_use
from vsgdesign.report.explore.scene import Shown, at_source, held_grid, shown_of
from vsgdesign.report.explore.state import PlaceOfState, State
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import Study

BITS = {"figure": 17, "shape": 11}
"""Bits of the mantissa of what is rounded, by its kind: 4e-6 of a figure, which is more than any digit that is shown,
and 2e-4 of what is only drawn or is a start of a refinement."""
SAME, EXACT, FIGURE, SHAPE, WHOLE = "s", "e", "f", "d", "w"
"""Kinds of columns, a letter each."""


@dataclass
class Columns:
    """Columns of numbers, one number for each cell. Cells are in rows of ``width``."""

    count: int
    width: int
    kinds: list[str] = field(default_factory=list)
    _known: dict[tuple[str, bytes], int] = field(default_factory=dict)
    _values: list[NDArray[Any]] = field(default_factory=list)

    def exact(self, values: ArrayLike) -> int:
        """The number of a column of which every bit is kept."""
        return self._add(EXACT, np.ascontiguousarray(values, dtype="<f8"))

    def figure(self, values: ArrayLike) -> int:
        """The number of a column of figures. What is not finite stays; None is NaN."""
        return self._add(FIGURE, rounded(np.asarray(values, dtype=float), BITS["figure"]))

    def shape(self, values: ArrayLike) -> int:
        """The number of a column of what is drawn."""
        return self._add(SHAPE, rounded(np.asarray(values, dtype=float), BITS["shape"]))

    def whole(self, values: ArrayLike) -> int:
        """The number of a column of whole numbers below 2^24."""
        return self._add(WHOLE, np.asarray(values, dtype="<u4"))

    def _add(self, kind: str, values: NDArray[Any]) -> int:
        if values.shape != (self.count,):
            raise ValueError(f"values = {values.shape}: a column has {self.count} numbers.")
        bits = values.view(np.uint64 if kind == EXACT else np.uint32)
        if (bits == bits[0]).all():
            kind, values = SAME, np.array([values[0]], dtype="<f8")
        key = kind, values.tobytes()
        if key not in self._known:
            self._known[key] = len(self.kinds)
            self.kinds.append(kind)
            self._values.append(values)
        return self._known[key]

    def document(self) -> dict[str, Any]:
        """What is needed to read :meth:`packed`."""
        return {
            "kinds": "".join(self.kinds),
            "count": self.count,
            "width": self.width,
            "dropped": _DROPPED,
        }

    def packed(self) -> bytes:
        """All columns: numbers that are the same, then the bytes of every other one, byte by byte of its numbers."""
        listed = list(zip(self.kinds, self._values, strict=True))
        parts = [np.array([values[0] for kind, values in listed if kind == SAME], dtype="<f8").tobytes()]
        for kind in (EXACT, FIGURE, SHAPE, WHOLE):
            for own, values in listed:
                if own == kind:
                    parts += self._planes(kind, values)
        return b"".join(parts)

    def _planes(self, kind: str, values: NDArray[Any]) -> list[bytes]:
        words = values.view("<u4").astype(np.uint32)
        if kind == EXACT:  # the lower half of a number is noise: it is kept as it is
            low, high = words[0::2], words[1::2]
            return [*_bytes_of(low, 4), *_bytes_of(self._left(high, 32), 4)]
        return _bytes_of(self._left(words >> np.uint32(_DROPPED[kind]), 8 * _PLANES[kind]), _PLANES[kind])

    def _left(self, words: NDArray[np.uint32], size: int) -> NDArray[np.uint32]:
        """What three neighbours leave of whole numbers of ``size`` bits, in the order 0, −1, 1, −2, …"""
        found = words.copy()
        for lag, sign in ((1, 1), (self.width, 1), (self.width + 1, -1)):
            if lag < len(words):
                found[lag:] = found[lag:] - words[:-lag] if sign > 0 else found[lag:] + words[:-lag]
        moved = found << np.uint32(32 - size)
        signs = (moved.view(np.int32) >> 31).view(np.uint32)
        return (((moved >> np.uint32(32 - size)) << np.uint32(1)) ^ signs) & np.uint32(2**size - 1)


_PLANES = {FIGURE: 4, SHAPE: 3, WHOLE: 3}
"""Bytes of a number."""
_DROPPED = {FIGURE: 23 - BITS["figure"], SHAPE: 23 - BITS["shape"], WHOLE: 0}
"""Bits that are zero."""


def _bytes_of(words: NDArray[np.uint32], planes: int) -> list[bytes]:
    """The first bytes of all numbers, then the second ones, and so on."""
    return [((words >> np.uint32(8 * k)) & np.uint32(0xFF)).astype(np.uint8).tobytes() for k in range(planes)]


def rounded(values: NDArray[Any], bits: int) -> NDArray[np.float32]:
    """Values as float32 with so many bits of the mantissa, to the nearest; what is not finite stays."""
    found = np.ascontiguousarray(values, dtype="<f4")
    drop = 23 - bits
    words = found.view(np.uint32)
    kept = ((words + np.uint32(1 << (drop - 1))) & np.uint32(0xFFFFFFFF << drop & 0xFFFFFFFF)).view("<f4")
    return np.where(np.isnan(found), np.float32(np.nan), np.where(np.isfinite(found) & np.isfinite(kept), kept, found))


LATTICE = (48, 32)
"""Numbers of SCR and of X/R of a page that is sent."""
QUICK_LATTICE = (16, 10)
"""Of a page that is made beside something else."""
PART_LATTICE = (10, 7)
"""Of a part of a report."""
MOST_SCR, MOST_X_OVER_R = 120, 80
"""Largest numbers of either."""

FIGURES = (*OF_MODEL, "settling_Q_s", "overshoot_Q", "droop_P", "droop_Q", "H_s")
"""Figures of a controller on a grid, in SI. Settling time and overshoot are those of a step of P, and of Q."""
STABLE = None, False, True
"""What the file says of stability, by its number."""


def lattice_counts(text: str) -> tuple[int, int]:
    """The numbers of SCR and X/R of a text such as "48x32". Raises StudyError."""
    match = re.fullmatch(r"(\d{1,6})\s*[x×]\s*(\d{1,6})", text.strip(), re.IGNORECASE)
    counts = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (2 <= counts[0] <= MOST_SCR and 1 <= counts[1] <= MOST_X_OVER_R):
        limit = f"must be two numbers such as 48x32: 2 to {MOST_SCR} of SCR, and 1 to {MOST_X_OVER_R} of X/R"
        raise StudyError("--lattice", [Fault("--lattice", text[:40], limit, "Give both numbers, or leave it out.")])
    return counts


@dataclass(frozen=True)
class Lattice:
    """Grids of a page."""

    scr: tuple[float, ...]
    x_over_r: tuple[float, ...]
    hold: PlaceOfState
    """The grid whose gains can be held."""

    @classmethod
    def around(cls, start: State, axes: Sequence[Sequence[float]], counts: tuple[int, int]) -> Lattice:
        """So many grids between the ends of the axes. The grid of the start is one of them."""
        scr, x_over_r = (
            [float(f"{value:.3g}") for value in np.geomspace(low, high, count)]
            for (low, high), count in zip(axes, counts, strict=True)
        )
        scr[_nearest(scr, start.scr)], x_over_r[_nearest(x_over_r, start.x_over_r)] = start.scr, start.x_over_r
        return cls(tuple(scr), tuple(x_over_r), PlaceOfState(start.scr, start.x_over_r))

    @property
    def places(self) -> Iterator[PlaceOfState]:
        """Its grids, SCR fastest."""
        return (PlaceOfState(scr, ratio) for ratio in self.x_over_r for scr in self.scr)

    def states(self, start: State, *, held: bool) -> list[State]:
        """A state for every grid, with gains that follow it or that are held."""
        hold = self.hold if held else None
        return [replace(start, scr=one.scr, x_over_r=one.x_over_r, hold=hold) for one in self.places]

    def columns(self) -> Columns:
        """Room for numbers of its grids."""
        return Columns(len(self.scr) * len(self.x_over_r), len(self.scr))


class Texts:
    """Texts that cells have, each kept once. 0 stands for none."""

    def __init__(self) -> None:
        self.known: dict[str, int] = {}

    def numbers(self, texts: Iterable[str | None]) -> list[int]:
        """The number of each text."""
        return [0 if not text else self.known.setdefault(text, len(self.known) + 1) for text in texts]


class CellsOf(NamedTuple):
    """What is known of one controller on several grids."""

    rows: list[dict[str, Any]]
    """As in the explorer's linear answer, with the figures of a step of Q."""
    limit_use: NDArray[np.float64]
    model: FullOrderModel | None
    """The model of those with a steady state."""


def cells_of(one: Shown, state: State, places: Sequence[PlaceOfState]) -> CellsOf:
    """What the linear model says of a controller on grids. The state gives the powers, and the grid whose gains are
    held."""
    study = one.study
    grids = [Place(at.scr, at.x_over_r, study.scr_basis).grid(study.converter) for at in places]
    if one.law is None:
        nothing = dict.fromkeys((*FIGURES, "stable", "outside")) | {"name": one.name, "why": one.why, "schedule": ""}
        return CellsOf([nothing | {"modes": [], "gains": {}} for _ in grids], np.full(len(grids), np.nan), None)
    R_g, L_g = np.array([(grid.R_g, grid.L_g) for grid in grids]).T
    cells = cells_at(one, state, R_g, L_g)
    held, error = held_grid(study, state) is not None, (state.error_R, state.error_X)
    rows = [
        dict.fromkeys(FIGURES) | row_of(one, cells, k, one.status(grid, held, error)) for k, grid in enumerate(grids)
    ]
    good = np.flatnonzero(cells.good)
    model = full_order_cells(study, cells)
    for k, fault in zip(good, model.faults, strict=True):
        rows[k]["why"] = fault
    if len(model.index):
        of_Q = zip(*full_order_settling(model, "Q_ref", "Q"), strict=True)
        for k, figures, (settling, overshoot) in zip(
            good[model.index], figures_of(model, "P", False), of_Q, strict=True
        ):
            rows[k] |= figures | {"settling_Q_s": finite(settling), "overshoot_Q": finite(overshoot)}
    return CellsOf(rows, limit_use(study, cells), model if len(model.index) else None)


def figures_document(columns: Columns, texts: Texts, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The columns of a controller's rows by what they say."""
    most = max(len(row["modes"]) for row in rows)

    def mode(k: int, part: str) -> int:
        return columns.shape([row["modes"][k][part] if k < len(row["modes"]) else math.nan for row in rows])

    schedules = list(dict.fromkeys(row["schedule"] for row in rows))
    return {
        "figures": {name: columns.figure([row[name] for row in rows]) for name in FIGURES},
        "gains": {name: columns.figure([row["gains"].get(name) for row in rows]) for name in PowerLoopGains._fields},
        "modes": [[mode(k, "re"), mode(k, "im")] for k in range(most)],
        "stable": columns.whole([STABLE.index(row["stable"]) for row in rows]),
        "schedule": columns.whole([schedules.index(row["schedule"]) for row in rows]),
        "schedules": schedules,
        "why": columns.whole(texts.numbers(row["why"] for row in rows)),
        "outside": columns.whole(texts.numbers(row["outside"] for row in rows)),
    }


def shown_in(study: Study, ready: Ready, state: State) -> tuple[Shown, ...]:
    """The controllers of a page, with their laws."""
    return shown_of(at_source(study, state), ready, state)


def _nearest(values: list[float], value: float) -> int:
    return int(np.argmin(np.abs(np.log(np.asarray(values) / value))))
