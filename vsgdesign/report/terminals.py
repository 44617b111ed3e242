"""What verbs without a page print on a terminal: a survival measurement, and what differs between two results."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.errors import counted, share_percent
from vsgdesign.metrics.survival import HARDWARE_PU
from vsgdesign.report.drawing.quantities import DASH, plain
from vsgdesign.report.page.blocks import Block, Table, Where, words

_LONGEST = 60
"""Letters of a value that a terminal shows."""

_SHOWN = 8
"""Lost cases of each controller that a terminal names."""


def survival_blocks(document: dict[str, Any]) -> list[Block]:
    """One row for each controller, then the groups in which something was lost, and the first lost cases."""
    head = (
        "controller",
        "survived",
        "stale for ever",
        "left out",
        "largest current [pu]",
        "first 5 ms [pu]",
        "recovery [s]",
        "worst [s]",
        "swing [rad]",
    )
    title = f"{document['title']}: limit {document['limit_pu']:g} pu"
    rows = tuple(_row(name, one) for name, one in document["variants"].items())
    lines = [line for name, one in document["variants"].items() for line in (*_lost(name, one), *_beyond(name, one))]
    same = 'The same verdict on random disturbances, with a bound: vsgdesign verify, in its rows "Survival".'
    return [Table(title, head, rows, on=Where.TERMINAL), words(*lines, same, on=Where.TERMINAL)]


def _row(name: str, one: dict[str, Any]) -> tuple[str, ...]:
    near, ever, T = one["stale_to_1_s"], one["for_ever"], one["settling_time"]
    return (
        name,
        _share(near),
        _share(ever),
        str(sum(figures["cases"] - figures["judged"] for figures in (near, ever))),
        _number(near["peak_pu"]),
        _number(near["first_peak_pu"]),
        _number(near["recovery_median"], T),
        _number(near["recovery_worst"], T),
        _number(near["swing_rad"]),
    )


def _lost(name: str, one: dict[str, Any]) -> list[str]:
    lost = [
        f"{group} {figures['judged'] - figures['survived']} of {figures['judged']}"
        for group, figures in one["groups"].items()
        if figures["survived"] < figures["judged"]
    ]
    lines = [f"{name} loses: {', '.join(lost)}"] if lost else []
    lines += [f"  {case['case']}: {case['status']}: {case['reason']}" for case in one["lost"][:_SHOWN]]
    more = len(one["lost"]) - _SHOWN
    return [*lines, f"  … and {more} more in cases.csv"] if more > 0 else lines


def _beyond(name: str, one: dict[str, Any]) -> list[str]:
    """What is survived with currents that hardware does not carry."""
    beyond = one["beyond_hardware"]
    if not beyond:
        return []
    return [
        f"{name} survives, but above {plain(HARDWARE_PU)} pu, {MORE_THAN_HARDWARE}: {counted(len(beyond), 'case')}, up "
        f"to {beyond[0]['peak_pu']:.3g} pu ({beyond[0]['case']})"
    ]


def _share(figures: dict[str, Any]) -> str:
    if not figures["judged"]:
        return DASH
    return f"{figures['survived']}/{figures['judged']} ({share_percent(figures['share'])})"


def _number(value: float | None, factor: float = 1.0) -> str:
    return DASH if value is None else f"{factor * value:.3g}"


_MOST_FIGURES = 40
"""Changed figures that a terminal shows, the largest changes first."""


def diff_blocks(document: dict[str, Any]) -> list[Block]:
    """What changed between two results: inputs, verdicts, then figures with both values."""
    inputs, verdicts, figures = (document[name] for name in ("inputs", "verdicts", "figures"))
    counts = [(len(inputs), "input"), (len(verdicts), "verdict"), (len(figures), "figure")]
    changed = ", ".join(counted(count, word) for count, word in counts if count)
    worse = f"{counted(document['worse'], 'verdict')} got worse" if document["worse"] else "No verdict got worse"
    said = f"Changed: {changed}. {worse}." if changed else "Nothing changed."
    marks = {True: "worse", False: "better"}
    by_size = sorted(figures, key=_relative_size, reverse=True)
    head = ("A", "B")
    return [
        words(said, on=Where.TERMINAL),
        *_changed("inputs", inputs, head, lambda _: ()),
        *_changed("verdicts", verdicts, (*head, ""), lambda one: (marks[one["worse"]],)),
        *_changed("figures, the largest changes first", by_size, (*head, "change"), lambda one: (_change(one),)),
    ]


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
