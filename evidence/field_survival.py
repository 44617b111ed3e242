"""Survival in a dirty grid with the field estimator driving, beside the same disturbances with the truth.

Nothing is lent to the converter: it starts in the middle of its schedule's grids, learns the grid, and goes through a
random disturbance with switching, sensors and the current limit. Each draw is run twice, with the estimate and with the
true grid. Finished runs are kept in the folder. ``VSGDESIGN_FIELD_SHARE=0.1`` measures a tenth of the draws,
``VSGDESIGN_FIELD_SEED=0`` begins at another seed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from evidence._field_converters import CONVERTERS
from evidence._field_runs import converter_of
from evidence._field_summary import Row, by_converter, quantile
from evidence._field_survival_draws import survival_draw
from evidence._field_survival_runs import VARIANTS, Task, run_survival
from evidence._kept_runs import first_seed, kept_runs, share
from evidence._tables import leave, table
from vsgdesign.metrics.survival import SURVIVED, VERDICTS

COUNT = 702
"""Draws on each converter: 26 of every share of the kinds."""

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
    by = by_converter(pairs, lambda pair: pair.field["converter"])
    found = {name: figures(mine) for name, mine in by.items()}
    alone = "{lost_with_estimate_alone} / {lost_with_truth_alone}"
    rows = (
        ("draws with a verdict", "≥ 2,000", "{pairs}".format_map),
        ("survived with the estimate", "", lambda f: _share(f, "survived")),
        ("survived with the truth", "", lambda f: _share(f, "survived_truth")),
        ("less than with the truth", f"≤ {LESS_PCT:g} points", _less),
        ("lost with the estimate alone / with the truth alone", "", alone.format_map),
        ("largest current later than 5 ms after an event", f"≤ {PEAK_PU:g} pu", _peaks),
        ("time to stay within 10 % after the last event: median / p95", "", _found),
        ("never within 10 %", "0", "{never_found}".format_map),
        ("runs with 20 ms or more valid and > 20 % wrong; longest", "0", _wrong),
        ("largest error of a valid answer", "≤ 30 %", lambda f: f"{100.0 * f['worst']:.0f} %"),
        ("longest silence", "≤ 1 s", lambda f: f"{1e3 * f['valid_again_s']:.0f} ms"),
        ("not valid at the end / wrong at the end", "0 / 0", "{silent_at_end} / {wrong_at_end}".format_map),
        ("recovery, median / worst: estimate (truth)", "", _recovery),
    )
    cells = ([what, asked, *map(value, found.values())] for what, asked, value in rows)
    return table(("figure", "asked", *found), cells)


def kinds_table(pairs: Sequence[Pair]) -> list[str]:
    """The same by kind of disturbance."""
    head = ("disturbance", "survived: estimate, truth", "largest current", "recovery, median / worst")
    rows = []
    for kind in dict.fromkeys(pair.field["group"] for pair in pairs):
        f = figures([pair for pair in pairs if pair.field["group"] == kind])
        cells = (f"{f['survived']}, {f['survived_truth']} of {f['pairs']}", _peaks(f), _recovery(f), _found(f))
        rows.append([kind, *cells, f"{f['wrong_runs']}", f"{100.0 * f['worst']:.0f} %"])
    return table((*head, "within 10 %: median / p95", "valid and wrong ≥ 20 ms", "largest valid error"), rows)


def lost_lines(pairs: Sequence[Pair]) -> list[str]:
    """One line on every run that was lost with the estimate."""
    return [
        f"- {pair.field['converter']}, seed {pair.field['seed']}, {pair.field['group']}: "
        f"{pair.field['verdict']['reason']}; with the truth: {pair.truth['verdict']['status']}"
        for pair in pairs
        if not survived(pair.field)
    ]


def _share(f: dict[str, Any], name: str) -> str:
    return f"{f[name]} of {f['pairs']} ({100.0 * f[name] / max(f['pairs'], 1):.2f} %)"


def _wrong(f: dict[str, Any]) -> str:
    return f"{f['wrong_runs']}; {1e3 * f['wrong_s']:.0f} ms"


def _less(f: dict[str, Any]) -> str:
    points = 100.0 * (f["survived_truth"] - f["survived"]) / max(f["pairs"], 1)
    return f"{points:.2f} points" + (" ✗" if points > LESS_PCT else "")


def _peaks(f: dict[str, Any]) -> str:
    return f"{f['peak_pu']:.2f} pu (truth {f['peak_truth_pu']:.2f})"


def _found(f: dict[str, Any]) -> str:
    return " / ".join("never" if math.isinf(t) else f"{1e3 * t:.0f} ms" for t in f["found_s"][:2])


def _recovery(f: dict[str, Any]) -> str:
    mine, truth = f["recovery_s"], f["recovery_truth_s"]
    return f"{mine[0]:.2f} / {mine[1]:.2f} s ({truth[0]:.2f} / {truth[1]:.2f})"


def _recoveries(rows: Sequence[Row]) -> list[float]:
    times = [row["verdict"]["recovery_s"] for row in rows if survived(row)]
    return [quantile(times, 0.5), quantile(times, 1.0)]


def _largest(values: Any) -> float:
    return max((value for value in values if value is not None), default=math.nan)


def tasks(share_of_all: float, seed: int) -> list[Task]:
    """Every draw with both variants."""
    count = max(round(share_of_all * COUNT), 1)
    draws = [survival_draw(converter_of(name), seed + k) for k in range(count) for name in CONVERTERS]
    return [Task(draw, variant) for draw in draws for variant in VARIANTS]


def main(folder: Path) -> None:
    rows = kept_runs(run_survival, tasks(share(), first_seed()), folder / "field" / "survival.jsonl", "field_survival")
    pairs = pairs_of(rows)
    left_out = len(rows) // 2 - len(pairs)
    lines = [f"{len(pairs)} draws with a verdict; {left_out} have no rest in the end.", "", *asked_table(pairs), ""]
    lines += [*kinds_table(pairs), ""]
    if lost := lost_lines(pairs):
        lines += ["Lost with the estimate:", "", *lost]
    kinds = dict.fromkeys(pair.field["group"] for pair in pairs)
    by = {kind: figures([pair for pair in pairs if pair.field["group"] == kind]) for kind in kinds}
    leave(folder, "field_survival", {"all": figures(pairs), "kinds": by}, lines)
