"""From pairs of runs to tables: what the field estimator costs against a schedule that is told the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from evidence._field_summary import quantile
from vsgdesign.metrics.survival import SURVIVED, VERDICTS

Row = dict[str, Any]

PEAK_PU = 1.30
"""Largest current later than 5 ms after an event that is asked for, pu."""

LESS_PCT = 0.3
"""By how many points fewer runs may survive than with the truth."""


class Pair(NamedTuple):
    """The same disturbance with the estimate and with the truth."""

    field: Row
    truth: Row


def pairs_of(rows: Sequence[Row]) -> list[Pair]:
    """Pairs of which both have a verdict; the others have no rest."""
    by: dict[tuple[str, int], dict[str, Row]] = {}
    for row in rows:
        by.setdefault((row["converter"], row["seed"]), {})[row["variant"]] = row
    both = [Pair(one["field"], one["truth"]) for one in by.values() if {"field", "truth"} <= set(one)]
    return [pair for pair in both if all(row["verdict"]["status"] in VERDICTS for row in pair)]


def survived(row: Row) -> bool:
    """Whether a run survived."""
    return row["verdict"]["status"] == SURVIVED


def figures(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Figures over pairs."""
    fields, truths = [pair.field for pair in pairs], [pair.truth for pair in pairs]
    times = [math.inf if row["found_s"] is None else row["found_s"] for row in fields]
    return {
        "pairs": len(pairs),
        "survived": sum(map(survived, fields)),
        "survived_truth": sum(map(survived, truths)),
        "lost_with_truth_alone": sum(survived(pair.field) and not survived(pair.truth) for pair in pairs),
        "lost_with_estimate_alone": sum(survived(pair.truth) and not survived(pair.field) for pair in pairs),
        "peak_pu": _largest(row["verdict"]["peak_pu"] for row in fields),
        "peak_truth_pu": _largest(row["verdict"]["peak_pu"] for row in truths),
        "recovery_s": _recoveries(fields),
        "recovery_truth_s": _recoveries(truths),
        "found_s": [quantile(times, share) for share in (0.5, 0.95, 1.0)],
        "never_found": sum(map(math.isinf, times)),
        "wrong_runs": sum(row["wrong_s"] >= 0.02 for row in fields),
        "wrong_s": _largest(row["wrong_s"] for row in fields),
        "worst": _largest(row["worst"] for row in fields),
        "valid_again_s": _largest(row["longest_silence_s"] for row in fields),
        "silent_at_end": sum(not row["valid_at_end"] for row in fields),
        "wrong_at_end": sum(row["wrong_at_end"] for row in fields),
    }


def asked_table(pairs: Sequence[Pair]) -> list[str]:
    """What is asked beside what was measured, by converter and over all."""
    names = list(dict.fromkeys(pair.field["converter"] for pair in pairs))
    by = {name: [pair for pair in pairs if pair.field["converter"] == name] for name in names} | {"all": list(pairs)}
    found = {name: figures(mine) for name, mine in by.items()}
    lines = [f"| figure | asked | {' | '.join(found)} |", "| --- |" + " --- |" * (len(found) + 1)]
    rows = (
        ("draws with a verdict", "≥ 2,000", lambda f: f"{f['pairs']}"),
        ("survived with the estimate", "", lambda f: _share(f["survived"], f["pairs"])),
        ("survived with the truth", "", lambda f: _share(f["survived_truth"], f["pairs"])),
        ("less than with the truth", f"≤ {LESS_PCT:g} points", _less),
        ("lost with the estimate alone / with the truth alone", "", _alone),
        ("largest current later than 5 ms after an event", f"≤ {PEAK_PU:g} pu", _peaks),
        ("time to stay within 10 % after the last event: median / p95", "", _found),
        ("never within 10 %", "0", lambda f: f"{f['never_found']}"),
        ("runs with 20 ms or more valid and > 20 % wrong; longest", "0", _wrong),
        ("largest error of a valid answer", "≤ 30 %", lambda f: f"{100.0 * f['worst']:.0f} %"),
        ("longest silence", "≤ 1 s", lambda f: f"{1e3 * f['valid_again_s']:.0f} ms"),
        ("not valid at the end / wrong at the end", "0 / 0", lambda f: f"{f['silent_at_end']} / {f['wrong_at_end']}"),
        ("recovery, median / worst: estimate (truth)", "", _recovery),
    )
    for what, asked, value in rows:
        lines.append(f"| {what} | {asked} | {' | '.join(value(one) for one in found.values())} |")
    return lines


def kinds_table(pairs: Sequence[Pair]) -> list[str]:
    """The same by kind of disturbance."""
    lines = [
        "| disturbance | survived: estimate, truth | largest current | recovery, median / worst | within 10 %: "
        "median / p95 | valid and wrong ≥ 20 ms | largest valid error |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for kind in dict.fromkeys(pair.field["group"] for pair in pairs):
        f = figures([pair for pair in pairs if pair.field["group"] == kind])
        cells = (f"{f['survived']}, {f['survived_truth']} of {f['pairs']}", _peaks(f), _recovery(f), _found(f))
        wrong = f"{f['wrong_runs']}"
        lines.append(f"| {kind} | {' | '.join(cells)} | {wrong} | {100.0 * f['worst']:.0f} % |")
    return lines


def lost_lines(pairs: Sequence[Pair]) -> list[str]:
    """One line on every run that was lost with the estimate."""
    return [
        f"- {pair.field['converter']}, seed {pair.field['seed']}, {pair.field['group']}: "
        f"{pair.field['verdict']['reason']}; with the truth: {pair.truth['verdict']['status']}"
        for pair in pairs
        if not survived(pair.field)
    ]


def _share(count: int, of: int) -> str:
    return f"{count} of {of} ({100.0 * count / max(of, 1):.2f} %)"


def _less(f: dict[str, Any]) -> str:
    points = 100.0 * (f["survived_truth"] - f["survived"]) / max(f["pairs"], 1)
    return f"{points:.2f} points" + (" ✗" if points > LESS_PCT else "")


def _alone(f: dict[str, Any]) -> str:
    return f"{f['lost_with_estimate_alone']} / {f['lost_with_truth_alone']}"


def _peaks(f: dict[str, Any]) -> str:
    return f"{f['peak_pu']:.2f} pu (truth {f['peak_truth_pu']:.2f})"


def _found(f: dict[str, Any]) -> str:
    return " / ".join("never" if math.isinf(t) else f"{1e3 * t:.0f} ms" for t in f["found_s"][:2])


def _wrong(f: dict[str, Any]) -> str:
    return f"{f['wrong_runs']}; {1e3 * f['wrong_s']:.0f} ms"


def _recovery(f: dict[str, Any]) -> str:
    mine, truth = f["recovery_s"], f["recovery_truth_s"]
    return f"{mine[0]:.2f} / {mine[1]:.2f} s ({truth[0]:.2f} / {truth[1]:.2f})"


def _recoveries(rows: Sequence[Row]) -> list[float]:
    times = [row["verdict"]["recovery_s"] for row in rows if survived(row)]
    return [quantile(times, 0.5), quantile(times, 1.0)]


def _largest(values: Any) -> float:
    return max((value for value in values if value is not None), default=math.nan)
