"""The grids of a page without a server, and what the linear model says of every controller on each of them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.cells import full_order_cells
from vsgdesign.linear.stability.step_responses import full_order_settling
from vsgdesign.report.explore.columns import Columns
from vsgdesign.report.explore.linear import OF_MODEL, figures_of, finite, row_of
from vsgdesign.report.explore.maps import cells_at, limit_use
from vsgdesign.report.explore.scene import Shown, at_source, held_grid, shown_of
from vsgdesign.report.explore.state import PlaceOfState, State
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import Study

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
