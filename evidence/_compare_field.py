"""Two measurements of the field estimator beside each other: ``python -m evidence._compare_field OLD NEW``.

OLD and NEW are the files ``field/runs.jsonl`` of ``python -m evidence field`` with two versions of the package. Runs
that both have are compared: shares of runs with Fisher's exact test, two-sided, and 95th percentiles by their ratio.
A line is marked where the new share is worse with p < 0.01, or the percentile by more than 10 %.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.stats import fisher_exact

from evidence._field_summary import EVENTS, RESTS, UNCHANGED, Row, at_rest, errors, of, quantile, times_to_find
from evidence._tables import table

WRONG_S, SILENT_S, LARGE, VERY_LARGE = 0.02, 1.0, 0.2, 0.3
JUMPS = ("jump", "jump and step", "small jump", "jump at no current", "measured: jump")
WORST_P, WORST_RATIO = 0.01, 1.1

Flag = Callable[[Row], bool]


def _outside_at_last(row: Row) -> bool:
    """Of the last valid answer at rest alone: the answers of a run are not independent."""
    valid = [answer for answer in row["rest"] if answer[3] > 0.5]
    return bool(valid) and valid[-1][4] < 0.5


def _outside_after(cycles: int) -> Flag:
    return lambda row: row["after"][cycles - 1][1] > 0.5 and row["after"][cycles - 1][2] < 0.5


def shares() -> Iterator[tuple[str, tuple[str, ...], Flag]]:
    """What is counted, in which groups, and when a run counts."""
    for group in JUMPS:
        yield f"{group}: never within 10 %", (group,), lambda row: row["found_s"] is None
    for name, groups in (("events", EVENTS), ("small jump", ("small jump",)), ("no current", ("jump at no current",))):
        yield f"{name}: valid and > 20 % wrong for 20 ms", groups, lambda row: row["wrong_s"] >= WRONG_S
        yield f"{name}: a valid error > 30 %", groups, lambda row: row["worst"] > VERY_LARGE
        yield f"{name}: silent for 1 s", groups, lambda row: row["longest_silence_s"] > SILENT_S
    yield "steps without a jump: a valid error > 20 %", UNCHANGED, lambda row: row["worst"] > LARGE
    everything = (*RESTS, *UNCHANGED, "measured: rest", "beat", "noise 1 %")
    yield "a false change", everything, lambda row: row["false_changes"] > 0
    for name, groups in (("rest", RESTS), ("measured: rest", ("measured: rest",)), ("beat", ("beat",))):
        yield f"{name}: last answer outside its ellipse", groups, _outside_at_last
        yield f"{name}: valid for less than 99 % of the time", groups, lambda row: row["share_valid"] < 0.99
    for cycles in (10, 20, 50):
        yield f"events: {cycles} cycles later outside its ellipse", EVENTS, _outside_after(cycles)


def percentiles() -> Iterator[tuple[str, tuple[str, ...], Callable[[Sequence[Row]], list[float]]]]:
    """What the 95th percentile is taken of, and in which groups."""
    for name, groups in (("rest", RESTS), ("measured: rest", ("measured: rest",)), ("noise 1 %", ("noise 1 %",))):
        for low, high in ((1.2, 8.0), (8.0, 20.0)):
            chosen = _between(low, high)
            yield (
                f"{name}, SCR {low:g}–{high:g}: error of Z, %",
                groups,
                lambda rows, of_scr=chosen: [
                    100.0 * one for one in errors(at_rest([row for row in rows if of_scr(row)]))
                ],
            )
    for group in JUMPS:
        yield f"{group}: time to stay within 10 %, ms", (group,), lambda rows: [1e3 * t for t in times_to_find(rows)]
    yield "events: longest silence, ms", EVENTS, lambda rows: [1e3 * row["longest_silence_s"] for row in rows]


def _between(low: float, high: float) -> Flag:
    return lambda row: low <= row["scr"][0] <= high


def runs_of(path: Path) -> dict[tuple[str, str, int], Row]:
    """The runs of a file by group, converter and seed."""
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        rows = json.loads(line[line.index("{") :]).values()
        found |= {(row["group"], row["converter"], row["seed"]): row for row in rows if "left_out" not in row}
    return found


def compared(old: Sequence[Row], new: Sequence[Row]) -> tuple[list[list[str]], list[list[str]]]:
    """The rows of the two tables, of all converters together and of each."""
    names = dict.fromkeys(row["converter"] for row in old)
    of_shares, of_percentiles = [], []
    for who, (what, groups, flag) in itertools.product(("all", *names), shares()):
        counts = []
        for rows in (old, new):
            flags = [flag(row) for row in of(rows, *groups) if who in ("all", row["converter"])]
            counts.append((sum(flags), len(flags)))
        (a, n), (b, m) = counts
        p = float(fisher_exact([[a, n - a], [b, m - b]])[1])
        worse = " ✗" if p < WORST_P and b * n > a * m else ""
        if a or b:
            of_shares.append([who, what, f"{a} of {n}", f"{b} of {m}", f"{p:.2g}{worse}"])
    for who, (what, groups, values) in itertools.product(("all", *names), percentiles()):
        mine = [[row for row in of(rows, *groups) if who in ("all", row["converter"])] for rows in (old, new)]
        median, p95 = ([quantile(values(rows), share) for rows in mine] for share in (0.5, 0.95))
        ratio = p95[1] / p95[0] if np.isfinite(p95[0]) else float(p95[1] > p95[0])
        cells = [f"{median[k]:.3g}, {p95[k]:.3g}" for k in (0, 1)]
        of_percentiles.append([who, what, *cells, f"{ratio:.2f}{' ✗' if ratio > WORST_RATIO else ''}"])
    return of_shares, of_percentiles


def main(old: Path, new: Path) -> None:
    found = [runs_of(path) for path in (old, new)]
    both = [key for key in found[0] if key in found[1]]
    of_shares, of_percentiles = compared(*([rows[key] for key in both] for rows in found))
    print(f"{len(both)} runs that both have.\n")
    print("\n".join(table(("converter", "share of runs", "old", "new", "p"), of_shares)))
    print()
    print("\n".join(table(("converter", "median and p95", "old", "new", "ratio of p95"), of_percentiles)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
