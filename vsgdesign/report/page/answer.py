"""What every page shows first: one row for each subject, with met or missed for each of its targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from markupsafe import Markup

MET, MISSED, UNKNOWN, OPEN, FACT = "met", "missed", "unknown", "open", "fact"
"""Marks of a cell: a target that is met, one that is missed, one that was asked for and cannot be judged, nothing that
was asked for, and a figure that has no target. Each has its colour and, because colours alone are not enough, its sign
and its words."""

SIGNS = {MET: "✓", MISSED: "✗", UNKNOWN: "?", OPEN: "–", FACT: ""}


@dataclass(frozen=True)
class Cell:
    """One answer: its mark, the words beside it, the figure behind it, and perhaps a small picture."""

    mark: str
    words: str
    detail: str = ""
    picture: Markup | None = None

    @property
    def sign(self) -> str:
        """The sign in front of the words."""
        return SIGNS[self.mark]


@dataclass(frozen=True)
class Row:
    """The answers for one subject. ``key`` is a sample of its curve, where the page's figures have one."""

    name: str
    cells: tuple[Cell, ...]
    key: Markup | None = None


@dataclass(frozen=True)
class Answer:
    """Rows of answers under one head (as long as the cells of a row), with notes below."""

    title: str
    head: tuple[str, ...]
    rows: tuple[Row, ...]
    subject: str = "Controller"
    notes: tuple[str, ...] = ()
    pictures: bool = False
    """Whether each cell is a picture with its words below, in one line."""


def counted(met: Sequence[bool], detail: str, otherwise: str = "not asked for") -> Cell:
    """A cell of several verdicts on the same target: ``met[k]`` for each that was judged, ``otherwise`` for none."""
    if not met:
        return Cell(OPEN, otherwise, detail)
    good = sum(met)
    if good == len(met):
        return Cell(MET, f"met {good} of {good}" if good > 1 else "met", detail)
    bad = len(met) - good
    return Cell(MISSED, f"missed {bad} of {len(met)}" if len(met) > 1 else "missed", detail)


def without_empty(answer: Answer) -> Answer:
    """The same without the columns in which no row has an answer: what nobody asked for is not worth a column."""
    used = [k for k in range(len(answer.head)) if any(row.cells[k].mark != OPEN for row in answer.rows)]
    rows = tuple(replace(row, cells=tuple(row.cells[k] for k in used)) for row in answer.rows)
    return replace(answer, head=tuple(answer.head[k] for k in used), rows=rows)
