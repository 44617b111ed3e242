"""From runs of the field estimator to tables: what is asked beside what was measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from evidence._tables import table

Row = dict[str, Any]
Array = NDArray[np.float64]
T = TypeVar("T")

SCR_BINS = ((1.2, 3.0), (3.0, 8.0), (8.0, 20.0))
X_OVER_R_BINS = ((0.3, 1.0), (1.0, 3.0), (3.0, 10.0), (10.0, 20.0))
ASKED_X_OVER_R = (0.3, 10.0)
COVERAGE_PCT = (93.0, 97.0)
EVENTS = ("jump", "jump and step", "grid-side step", "power step", "measured: jump")
"""Groups whose runs are held to the figures after an event. A small jump fades in, and one at no current cannot be
told from none: these two have lines of their own."""

UNCHANGED = ("grid-side step", "power step")
RESTS = ("rest", "long rest")


def of(rows: Sequence[Row], *groups: str) -> list[Row]:
    """The rows of some groups."""
    return [row for row in rows if row["group"] in groups]


def at_rest(rows: Sequence[Row]) -> Array:
    """Answers at rest, one row each: SCR, X/R, error of R, error of X, R/|Z|, valid, inside (relative to |Z|)."""
    parts = [
        np.column_stack([np.full((len(row["rest"]), 2), (row["scr"][0], row["x_over_r"][0])), np.array(row["rest"])])
        for row in rows
        if row.get("rest")
    ]
    return np.concatenate(parts) if parts else np.zeros((0, 7))


def errors(answers: Array) -> Array:
    """|Ẑ − Z|/|Z| of the valid ones among answers at rest."""
    valid = answers[answers[:, 5] > 0.0]
    return np.hypot(valid[:, 2], valid[:, 3])


def inside(answers: Array) -> float:
    """Share of the valid answers at rest whose ellipse contains the truth, %."""
    valid = answers[answers[:, 5] > 0.0]
    return percent(valid[:, 6])


def percent(flags: Any) -> float:
    """How many of some flags are set, %; NaN of none."""
    return 100.0 * float(np.mean(flags)) if len(flags) else math.nan


def between(answers: Array, scr: tuple[float, float], x_over_r: tuple[float, float]) -> Array:
    """Answers at rest (or whatever begins with SCR and X/R) on the grids of a bin, ends included."""
    chosen = (answers[:, 0] >= scr[0]) & (answers[:, 0] <= scr[1])
    return answers[chosen & (answers[:, 1] >= x_over_r[0]) & (answers[:, 1] <= x_over_r[1])]


def quantile(values: Any, share: float) -> float:
    """The smallest value that at least ``share`` of the values do not exceed; NaN of nothing. Infinity is a value."""
    return float(np.quantile(values, share, method="inverted_cdf")) if len(values) else math.nan


def times_to_find(rows: Sequence[Row]) -> list[float]:
    """Time to stay within 10 % of every run, s; infinite where it was never."""
    return [math.inf if row["found_s"] is None else row["found_s"] for row in rows if "found_s" in row]


def covered_from(rows: Sequence[Row], cycles: int) -> float:
    """Share of the valid answers from ``cycles`` after the last event on whose ellipse contains the truth, %."""
    parts = [np.array(row["after"])[cycles:] for row in rows if len(row.get("after", ())) > cycles]
    after = np.concatenate(parts) if parts else np.zeros((0, 3))
    valid = after[after[:, 1] > 0.0]
    return percent(valid[:, 2])


def errors_since(rows: Sequence[Row], cycles: int) -> list[dict[str, float]]:
    """For each cycle after the last event: share of valid answers, median and p95 of the errors of all and of the valid
    ones, and coverage of the valid ones."""
    found = []
    for k in range(cycles):
        here = np.array([row["after"][k][:3] for row in rows if len(row.get("after", ())) > k]).reshape(-1, 3)
        valid = here[here[:, 1] > 0.0]
        found.append(
            {
                "cycle": k + 1,
                "valid_pct": percent(here[:, 1]),
                "median_pct": 100.0 * quantile(here[:, 0], 0.5),
                "p95_pct": 100.0 * quantile(here[:, 0], 0.95),
                "valid_p95_pct": 100.0 * quantile(valid[:, 0], 0.95),
                "coverage_pct": percent(valid[:, 2]),
            }
        )
    return found


NOT_ASKED = "–"


@dataclass(frozen=True)
class Figure:
    """Something that is measured over the runs of some groups, beside what is asked of it."""

    what: str
    groups: tuple[str, ...]
    value: Callable[[Sequence[Row]], float]
    """NaN where it was not measured."""
    words: Callable[[float, Sequence[Row]], str]
    """The value and its runs in words."""
    asked: str = NOT_ASKED
    low: float = -math.inf
    high: float = math.inf

    def of(self, rows: Sequence[Row]) -> tuple[str, bool | None]:
        """The figure in words, and whether it is kept: None where it is not asked for or was not measured."""
        mine = of(rows, *self.groups)
        value = self.value(mine)
        if math.isnan(value):
            return "–", None
        return self.words(value, mine), None if self.asked == NOT_ASKED else self.low <= value <= self.high


def asked_figures() -> list[Figure]:
    """All figures that the issue of the estimator asks for and that follow from one run each."""
    return [
        _rest_error("error of Z at rest, SCR 1.2–8, X/R 0.3–10: p95", (1.2, 8.0), 4.0, RESTS),
        _rest_error("the same, SCR 8–20", (8.0, 20.0), 6.0, RESTS),
        _found("time to stay within 10 % after a jump: median", ("jump",), 0.5, 0.100),
        _found("the same: p95", ("jump",), 0.95, 0.250),
        _found("with a step of V, phase or f at the same time: p95", ("jump and step",), 0.95, 0.320),
        _found("after a small jump (10–50 %): p95", ("small jump",), 0.95, None),
        _found("after a jump at no current: p95", ("jump at no current",), 0.95, None),
        _inside("coverage of the 95 % ellipse at rest", RESTS),
        _covered("coverage of valid answers from 20 cycles after an event", 20, 90.0),
        _covered("coverage of valid answers from 10 cycles after an event", 10, None),
        _false("false changes at rest", RESTS),
        _false("false changes after steps of V, phase, f, P and Q", UNCHANGED),
        _worst("largest valid error in steps of V, phase, f, P and Q", UNCHANGED, 20.0),
        _rest_error("measured background: error at rest, SCR 1.2–8: p95", (1.2, 8.0), 4.0, ("measured: rest",)),
        _rest_error("the same, SCR 8–20", (8.0, 20.0), 6.0, ("measured: rest",)),
        _inside("measured background: coverage at rest", ("measured: rest",)),
        _false("measured background: false changes at rest", ("measured: rest",)),
        _found("measured background: time to stay within 10 %: median", ("measured: jump",), 0.5, 0.100),
        _found("the same: p95", ("measured: jump",), 0.95, 0.250),
        _of_beats("beat of another converter within 2 Hz of a line: coverage", _inside_pct, 90.0),
        _of_beats("the same: share of time valid", lambda rows: percent([row["share_valid"] for row in rows]), 50.0),
        _rest_error("sensor noise of 1 %: error at rest, SCR 1.2–8: p95", (1.2, 8.0), None, ("noise 1 %",)),
        _wrong("valid and > 20 % wrong from 40 ms after an event: longest", EVENTS, "< 20 ms"),
        _wrong("the same after a small jump", ("small jump",), "–"),
        _wrong("the same after a jump at no current", ("jump at no current",), "–"),
        _worst("largest error of a valid answer from 40 ms after an event", EVENTS, 30.0),
        _silence(),
    ]


def asked_table(rows: Sequence[Row]) -> tuple[list[str], list[Row]]:
    """Lines of Markdown, and the same as data: every figure by converter and over all."""
    by = by_converter(rows, lambda row: row["converter"])
    cells, data = [], []
    for figure in asked_figures():
        found = {name: figure.of(mine) for name, mine in by.items()}
        marked = (words + " ✗" * (kept is False) for words, kept in found.values())
        cells.append((figure.what, figure.asked, *marked))
        words = {name: words for name, (words, _) in found.items()}
        data.append({"what": figure.what, "asked": figure.asked} | words | {"kept": found["all"][1]})
    return table(("figure", "asked", *by), cells), data


def by_converter(items: Sequence[T], name_of: Callable[[T], str]) -> dict[str, list[T]]:
    """What belongs to each converter, in the order of the items, and ``all``."""
    names = dict.fromkeys(map(name_of, items))
    return {name: [one for one in items if name_of(one) == name] for name in names} | {"all": list(items)}


def bins_table(rows: Sequence[Row], of_bin: Callable[[list[Row]], str]) -> list[str]:
    """Markdown of a figure by SCR and X/R of the last grid."""

    def cell(scr: tuple[float, float], x_over_r: tuple[float, float]) -> str:
        mine = [r for r in rows if _within(r["scr"][1], scr) and _within(r["x_over_r"][1], x_over_r)]
        return of_bin(mine) if mine else "–"

    head = ["SCR \\ X/R", *(f"{low:g}–{high:g}" for low, high in X_OVER_R_BINS)]
    return table(head, ([f"{scr[0]:g}–{scr[1]:g}", *(cell(scr, one) for one in X_OVER_R_BINS)] for scr in SCR_BINS))


def rest_of_bin(rows: list[Row]) -> str:
    """Median and p95 of the error at rest and the coverage, %."""
    answers = at_rest(rows)
    found = errors(answers)
    middle, high = (100.0 * quantile(found, share) for share in (0.5, 0.95))
    return f"{middle:.1f} / {high:.1f}, {inside(answers):.0f}"


def found_of_bin(rows: list[Row]) -> str:
    """Median and p95 of the time to stay within 10 %, ms, and the number of runs."""
    times = times_to_find(rows)
    return f"{_ms(quantile(times, 0.5))} / {_ms(quantile(times, 0.95))} ({len(times)})"


def error_quantiles(rows: Sequence[Row]) -> list[Row]:
    """Quantiles of the errors at rest by bin, %: of R over R, of X over X and of Z over |Z|."""
    answers, found = at_rest(rows), []
    for scr in SCR_BINS:
        for x_over_r in X_OVER_R_BINS:
            mine = between(answers, scr, x_over_r)
            mine = mine[mine[:, 5] > 0.0]
            if not len(mine):
                continue
            R, X = mine[:, 4], np.sqrt(1.0 - mine[:, 4] ** 2)
            parts = {
                "R_pct": np.abs(mine[:, 2]) / R,
                "X_pct": np.abs(mine[:, 3]) / X,
                "Z_pct": np.hypot(mine[:, 2], mine[:, 3]),
            }
            shares = (0.5, 0.9, 0.95, 0.99, 1.0)
            by = {name: {f"{s:g}": round(100.0 * quantile(e, s), 3) for s in shares} for name, e in parts.items()}
            found.append({"scr": scr, "x_over_r": x_over_r, "answers": len(mine)} | by)
    return found


def _within(value: float, ends: tuple[float, float]) -> bool:
    return ends[0] <= value <= ends[1] if ends[1] == 20.0 else ends[0] <= value < ends[1]


def _ms(seconds: float) -> str:
    return "never" if math.isinf(seconds) else "–" if math.isnan(seconds) else f"{1e3 * seconds:.0f}"


def _rest_error(what: str, scr: tuple[float, float], asked: float | None, groups: tuple[str, ...]) -> Figure:
    def error(rows: Sequence[Row], share: float) -> float:
        return 100.0 * quantile(errors(between(at_rest(rows), scr, ASKED_X_OVER_R)), share)

    def words(value: float, rows: Sequence[Row]) -> str:
        return f"{value:.1f} % (median {error(rows, 0.5):.1f} %)"

    return Figure(what, groups, lambda rows: error(rows, 0.95), words, **_at_most(asked, "%"))


def _found(what: str, groups: tuple[str, ...], share: float, asked: float | None) -> Figure:
    def words(value: float, rows: Sequence[Row]) -> str:
        times = times_to_find(rows)
        never = sum(map(math.isinf, times))
        return f"{_ms(value)} ms of {len(times)}" + (f", {never} never" if never else "")

    limits = _at_most(asked, "ms", 1e3)
    return Figure(what, groups, lambda rows: quantile(times_to_find(rows), share), words, **limits)


def _inside_pct(rows: Sequence[Row]) -> float:
    return inside(at_rest(rows))


def _inside(what: str, groups: tuple[str, ...]) -> Figure:
    low, high = COVERAGE_PCT
    return Figure(what, groups, _inside_pct, _pct, f"{low:g}–{high:g} %", low, high)


def _of_beats(what: str, value: Callable[[Sequence[Row]], float], asked: float) -> Figure:
    return Figure(what, ("beat",), value, _pct, **_at_least(asked))


def _covered(what: str, cycles: int, asked: float | None) -> Figure:
    return Figure(what, EVENTS, lambda rows: covered_from(rows, cycles), _pct, **_at_least(asked))


def _false(what: str, groups: tuple[str, ...]) -> Figure:
    def count(rows: Sequence[Row]) -> float:
        return float(sum(row["false_changes"] for row in rows)) if rows else math.nan

    def words(value: float, rows: Sequence[Row]) -> str:
        return f"{value:.0f} in {sum(row['duration_s'] for row in rows) / 60.0:.0f} min"

    return Figure(what, groups, count, words, "0", high=0.0)


def _worst(what: str, groups: tuple[str, ...], asked: float) -> Figure:
    def words(value: float, rows: Sequence[Row]) -> str:
        beyond = sum(100.0 * row["worst"] > asked for row in rows)
        return f"{value:.0f} %; {beyond} of {len(rows)} runs above {asked:g} %"

    return Figure(what, groups, lambda rows: 100.0 * _largest(rows, "worst"), words, **_at_most(asked, "%"))


def _wrong(what: str, groups: tuple[str, ...], asked: str) -> Figure:
    def words(value: float, rows: Sequence[Row]) -> str:
        beyond = sum(row["wrong_s"] >= 0.02 for row in rows)
        return f"{_ms(value)} ms; {beyond} of {len(rows)} runs 20 ms or more"

    return Figure(what, groups, lambda rows: _largest(rows, "wrong_s"), words, asked, high=0.02 - 1e-9)


def _silence() -> Figure:
    def words(value: float, rows: Sequence[Row]) -> str:
        median, high = (_ms(quantile([row["longest_silence_s"] for row in rows], share)) for share in (0.5, 0.95))
        return f"{_ms(value)} ms (median {median}, p95 {high})"

    what, limits = "longest silence after an event", _at_most(1.0, "s")
    return Figure(what, EVENTS, lambda rows: _largest(rows, "longest_silence_s"), words, **limits)


def _largest(rows: Sequence[Row], name: str) -> float:
    return max((row[name] for row in rows), default=math.nan)


def _pct(value: float, _rows: Sequence[Row]) -> str:
    return f"{value:.1f} %"


def _at_most(asked: float | None, unit: str, of_unit: float = 1.0) -> dict[str, Any]:
    return {} if asked is None else {"asked": f"≤ {of_unit * asked:g} {unit}", "high": asked}


def _at_least(asked: float | None) -> dict[str, Any]:
    return {} if asked is None else {"asked": f"≥ {asked:g} %", "low": asked}
