"""What a verb without a page prints on a terminal: what differs between two results."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from vsgdesign.errors import counted
from vsgdesign.report.drawing.quantities import DASH
from vsgdesign.report.page.blocks import Block, Table, Where, words

_LONGEST = 60
"""Letters of a value that a terminal shows."""

_MOST_FIGURES = 40
"""Changed figures that a terminal shows, the largest changes first."""


def diff_blocks(document: dict[str, Any]) -> list[Block]:
    """What changed between two results: inputs, verdicts, then figures with both values."""
    inputs, verdicts, figures = (document[name] for name in ("inputs", "verdicts", "figures"))
    marks = {True: "worse", False: "better"}
    by_size = sorted(figures, key=_relative_size, reverse=True)
    head = ("A", "B")
    return [
        words(diff_sentence(document), on=Where.TERMINAL),
        *_changed("inputs", inputs, head, lambda _: ()),
        *_changed("verdicts", verdicts, (*head, ""), lambda one: (marks[one["worse"]],)),
        *_changed("figures, the largest changes first", by_size, (*head, "change"), lambda one: (_change(one),)),
    ]


def diff_sentence(document: dict[str, Any]) -> str:
    """How much changed, and whether a verdict got worse."""
    counts = [(len(document[f"{word}s"]), word) for word in ("input", "verdict", "figure")]
    changed = ", ".join(counted(count, word) for count, word in counts if count)
    worse = f"{counted(document['worse'], 'verdict')} got worse" if document["worse"] else "No verdict got worse"
    return f"Changed: {changed}. {worse}." if changed else "Nothing changed."


def _changed(
    title: str,
    changes: Sequence[dict[str, Any]],
    head: tuple[str, ...],
    more: Callable[[dict[str, Any]], tuple[str, ...]],
) -> list[Block]:
    rows = tuple((" › ".join(one["place"]), _shown(one["a"]), _shown(one["b"]), *more(one)) for one in changes)
    rest = len(rows) - _MOST_FIGURES
    found: list[Block] = [Table(title, ("what", *head), rows[:_MOST_FIGURES], on=Where.TERMINAL)] if rows else []
    return [*found, words(f"… and {rest} more: --json gives all." if rest > 0 else "", on=Where.TERMINAL)]


def _shown(value: Any) -> str:
    if value is None:
        return DASH
    if isinstance(value, dict):
        return "there"
    if isinstance(value, float):
        return f"{value:.6g}"
    text = ", ".join(map(_shown, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _change(one: dict[str, Any]) -> str:
    size = _relative(one)
    return DASH if not math.isfinite(size) else f"{100.0 * size:+.3g} %"


def _relative_size(one: dict[str, Any]) -> float:
    return abs(_relative(one))


def _relative(one: dict[str, Any]) -> float:
    """(b - a)/|a|; infinite where one of them is no number, or a is zero."""
    a, b = one["a"], one["b"]
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (a, b))
    return (b - a) / abs(a) if numbers and a else math.inf
