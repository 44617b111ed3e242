"""From runs of the field estimator to tables: what is asked beside what was measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Row = dict[str, Any]
Array = NDArray[np.float64]

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
    return 100.0 * float(np.mean(valid[:, 6])) if len(valid) else math.nan


def between(answers: Array, scr: tuple[float, float], x_over_r: tuple[float, float]) -> Array:
    """Answers at rest on the grids of a bin, ends included."""
    chosen = (answers[:, 0] >= scr[0]) & (answers[:, 0] <= scr[1])
    return answers[chosen & (answers[:, 1] >= x_over_r[0]) & (answers[:, 1] <= x_over_r[1])]


def quantile(values: Any, share: float) -> float:
    """The smallest value that at least ``share`` of the values do not exceed; NaN of nothing. Infinity is a value."""
    ordered = np.sort(np.asarray(values, dtype=float))
    return float(ordered[max(math.ceil(share * len(ordered)) - 1, 0)]) if len(ordered) else math.nan


def times_to_find(rows: Sequence[Row]) -> list[float]:
    """Time to stay within 10 % of every run, s; infinite where it was never."""
    return [math.inf if row["found_s"] is None else row["found_s"] for row in rows if "found_s" in row]


def covered_from(rows: Sequence[Row], cycles: int) -> float:
    """Share of the valid answers from ``cycles`` after the last event on whose ellipse contains the truth, %."""
    parts = [np.array(row["after"])[cycles:] for row in rows if len(row.get("after", ())) > cycles]
    after = np.concatenate(parts) if parts else np.zeros((0, 3))
    valid = after[after[:, 1] > 0.0]
    return 100.0 * float(np.mean(valid[:, 2])) if len(valid) else math.nan


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
                "valid_pct": 100.0 * float(np.mean(here[:, 1])) if len(here) else math.nan,
                "median_pct": 100.0 * quantile(here[:, 0], 0.5),
                "p95_pct": 100.0 * quantile(here[:, 0], 0.95),
                "valid_p95_pct": 100.0 * quantile(valid[:, 0], 0.95),
                "coverage_pct": 100.0 * float(np.mean(valid[:, 2])) if len(valid) else math.nan,
            }
        )
    return found


Figure = tuple[str, str, Callable[[Sequence[Row]], str], Callable[[Sequence[Row]], bool | None]]
"""What, what is asked, the figure in words, and whether it is kept (None: it was not measured)."""


def figures() -> list[Figure]:
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
        _beat_coverage(),
        _beat_valid(),
        _rest_error("sensor noise of 1 %: error at rest, SCR 1.2–8: p95", (1.2, 8.0), None, ("noise 1 %",)),
        _wrong("valid and > 20 % wrong from 40 ms after an event: longest", EVENTS, "< 20 ms"),
        _wrong("the same after a small jump", ("small jump",), "–"),
        _wrong("the same after a jump at no current", ("jump at no current",), "–"),
        _worst("largest error of a valid answer from 40 ms after an event", EVENTS, 30.0),
        _silence(),
    ]


def asked_table(rows: Sequence[Row]) -> tuple[list[str], list[Row]]:
    """Lines of Markdown, and the same as data: every figure by converter and over all."""
    names = list(dict.fromkeys(row["converter"] for row in rows))
    lines = [f"| figure | asked | {' | '.join(names)} | all |", "| --- |" + " --- |" * (len(names) + 2)]
    data = []
    for what, asked, value, kept in figures():
        by = {name: [row for row in rows if row["converter"] == name] for name in names} | {"all": list(rows)}
        cells = [value(mine) + {True: "", False: " ✗", None: ""}[kept(mine)] for mine in by.values()]
        lines.append(f"| {what} | {asked} | {' | '.join(cells)} |")
        data.append({"what": what, "asked": asked} | {name: value(mine) for name, mine in by.items()})
        data[-1]["kept"] = kept(rows)
    return lines, data


def bins_table(rows: Sequence[Row], of_bin: Callable[[list[Row]], str]) -> list[str]:
    """Markdown of a figure by SCR and X/R of the last grid."""
    lines = ["| SCR \\ X/R | " + " | ".join(f"{a:g}–{b:g}" for a, b in X_OVER_R_BINS) + " |"]
    lines.append("| --- |" + " --- |" * len(X_OVER_R_BINS))
    for scr in SCR_BINS:
        cells = []
        for x_over_r in X_OVER_R_BINS:
            mine = [r for r in rows if _within(r["scr"][1], scr) and _within(r["x_over_r"][1], x_over_r)]
            cells.append(of_bin(mine) if mine else "–")
        lines.append(f"| {scr[0]:g}–{scr[1]:g} | {' | '.join(cells)} |")
    return lines


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
    def p95(rows: Sequence[Row]) -> float:
        return 100.0 * quantile(errors(between(at_rest(of(rows, *groups)), scr, ASKED_X_OVER_R)), 0.95)

    def value(rows: Sequence[Row]) -> str:
        found = errors(between(at_rest(of(rows, *groups)), scr, ASKED_X_OVER_R))
        return f"{p95(rows):.1f} % (median {100.0 * quantile(found, 0.5):.1f} %)" if len(found) else "–"

    return what, _at_most(asked, "%"), value, lambda rows: _low(p95(rows), asked)


def _found(what: str, groups: tuple[str, ...], share: float, asked: float | None) -> Figure:
    def time_of(rows: Sequence[Row]) -> float:
        return quantile(times_to_find(of(rows, *groups)), share)

    def value(rows: Sequence[Row]) -> str:
        times = times_to_find(of(rows, *groups))
        never = sum(map(math.isinf, times))
        more = f" of {len(times)}" + (f", {never} never" if never else "")
        return f"{_ms(time_of(rows))} ms{more}" if times else "–"

    return what, _at_most(None if asked is None else 1e3 * asked, "ms"), value, lambda rows: _low(time_of(rows), asked)


def _inside(what: str, groups: tuple[str, ...]) -> Figure:
    def share(rows: Sequence[Row]) -> float:
        return inside(at_rest(of(rows, *groups)))

    low, high = COVERAGE_PCT
    kept = lambda rows: None if math.isnan(share(rows)) else low <= share(rows) <= high  # noqa: E731
    return what, f"{low:g}–{high:g} %", lambda rows: _pct(share(rows)), kept


def _covered(what: str, cycles: int, asked: float | None) -> Figure:
    def share(rows: Sequence[Row]) -> float:
        return covered_from(of(rows, *EVENTS), cycles)

    text = "–" if asked is None else f"≥ {asked:g} %"
    return what, text, lambda rows: _pct(share(rows)), lambda rows: _high(share(rows), asked)


def _false(what: str, groups: tuple[str, ...]) -> Figure:
    def value(rows: Sequence[Row]) -> str:
        mine = of(rows, *groups)
        seconds = sum(row["duration_s"] for row in mine)
        return f"{sum(row['false_changes'] for row in mine)} in {seconds / 60.0:.0f} min" if mine else "–"

    def kept(rows: Sequence[Row]) -> bool | None:
        mine = of(rows, *groups)
        return None if not mine else sum(row["false_changes"] for row in mine) == 0

    return what, "0", value, kept


def _worst(what: str, groups: tuple[str, ...], asked: float) -> Figure:
    def worst(rows: Sequence[Row]) -> float:
        return max((100.0 * row["worst"] for row in of(rows, *groups)), default=math.nan)

    def value(rows: Sequence[Row]) -> str:
        mine = of(rows, *groups)
        beyond = sum(100.0 * row["worst"] > asked for row in mine)
        return f"{worst(rows):.0f} %; {beyond} of {len(mine)} runs above {asked:g} %" if mine else "–"

    return what, _at_most(asked, "%"), value, lambda rows: _low(worst(rows), asked)


def _wrong(what: str, groups: tuple[str, ...], asked: str) -> Figure:
    def longest(rows: Sequence[Row]) -> float:
        return max((row["wrong_s"] for row in of(rows, *groups)), default=math.nan)

    def value(rows: Sequence[Row]) -> str:
        mine = of(rows, *groups)
        beyond = sum(row["wrong_s"] >= 0.02 for row in mine)
        return f"{_ms(longest(rows))} ms; {beyond} of {len(mine)} runs 20 ms or more" if mine else "–"

    return what, asked, value, lambda rows: _low(longest(rows), None if asked == "–" else 0.02 - 1e-9)


def _silence() -> Figure:
    def longest(rows: Sequence[Row]) -> float:
        return max((row["longest_silence_s"] for row in of(rows, *EVENTS)), default=math.nan)

    def value(rows: Sequence[Row]) -> str:
        mine = [row["longest_silence_s"] for row in of(rows, *EVENTS)]
        median, high = quantile(mine, 0.5), quantile(mine, 0.95)
        return f"{_ms(longest(rows))} ms (median {_ms(median)}, p95 {_ms(high)})" if mine else "–"

    return "longest silence after an event", "≤ 1 s", value, lambda rows: _low(longest(rows), 1.0)


def _beat_coverage() -> Figure:
    def share(rows: Sequence[Row]) -> float:
        return inside(at_rest(of(rows, "beat")))

    what = "beat of another converter within 2 Hz of a line: coverage"
    return what, "≥ 90 %", lambda rows: _pct(share(rows)), lambda rows: _high(share(rows), 90.0)


def _beat_valid() -> Figure:
    def share(rows: Sequence[Row]) -> float:
        mine = [row["share_valid"] for row in of(rows, "beat")]
        return 100.0 * float(np.mean(mine)) if mine else math.nan

    return "the same: share of time valid", "≥ 50 %", lambda rows: _pct(share(rows)), lambda r: _high(share(r), 50.0)


def _pct(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.1f} %"


def _at_most(asked: float | None, unit: str) -> str:
    return "–" if asked is None else f"≤ {asked:g} {unit}"


def _low(value: float, asked: float | None) -> bool | None:
    return None if asked is None or math.isnan(value) else value <= asked


def _high(value: float, asked: float | None) -> bool | None:
    return None if asked is None or math.isnan(value) else value >= asked
