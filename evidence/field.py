"""The field estimator in a dirty grid and in the background that was measured: what it knows, and when.

Three converters, switched, with sensors in the loop, and the schedule driven by the estimate alone. Every run is drawn
from a seed that was not used to tune the estimator. Finished runs are kept in the folder, so an interrupted measurement
goes on where it was. ``VSGDESIGN_FIELD_SHARE=0.1`` measures a tenth of the runs, ``VSGDESIGN_FIELD_SEED=0`` begins at
another seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._field_converters import CONVERTERS
from evidence._field_draws import FieldDraw, field_draw
from evidence._field_probe_runs import probe_table, run_probe
from evidence._field_runs import converter_of, run_field
from evidence._field_summary import (
    RESTS,
    Array,
    Row,
    asked_table,
    at_rest,
    between,
    bins_table,
    error_quantiles,
    errors_since,
    found_of_bin,
    of,
    rest_of_bin,
)
from evidence._kept_runs import first_seed, kept_runs, share
from evidence._tables import leave, table
from vsgdesign.artifacts.files import provenance
from vsgdesign.artifacts.measured_errors import MEASURED_FILE, SHIPPED, GridBin, JumpInstant, MeasuredErrors

COUNTS = {
    "rest": 200,
    "jump": 350,
    "jump and step": 200,
    "small jump": 100,
    "jump at no current": 40,
    "grid-side step": 300,
    "power step": 50,
    "measured: rest": 60,
    "measured: jump": 100,
    "beat": 60,
    "noise 1 %": 40,
    "long rest": 20,
}
"""Runs of each group on each converter. The 20 long rests of 60 s on three converters are 1 h."""

PROBE_COUNT = 10
"""Runs with and without the probe on each converter."""

SHIPS = {SHIPPED.name: SHIPPED}
"""The page of a gain table holds these errors against its error set."""

CYCLES = (0, 1, 2, 3, 4, 5, 7, 9, 14, 19, 29, 49)
"""Cycles after an event that the table of errors shows."""


SCR = (1.2, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)
X_OVER_R = (0.3, 1.0, 3.0, 10.0, 20.0)
"""Limits of the ranges of grids of the errors that the package ships."""

MOST = 400
"""Answers of a range, and jumps, that are kept."""

JUMP_CYCLES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 25, 30, 40, 50)
"""Answers since a jump that are kept."""

_DIGITS = 4


def draws(share_of_all: float, seed: int) -> list[FieldDraw]:
    """Every run, the long ones first, so that no worker waits for one at the end."""
    found = [
        field_draw(converter_of(name), group, seed + k)
        for name in CONVERTERS
        for group, count in COUNTS.items()
        for k in range(max(round(share_of_all * count), 1))
    ]
    return sorted(found, key=lambda draw: -draw.duration_s)


def judged(rows: list[Row]) -> list[Row]:
    """The runs that have figures."""
    return [row for row in rows if "left_out" not in row]


def markdown(everything: list[Row]) -> tuple[list[str], dict[str, Any]]:
    """All tables, and the same as data."""
    rows = judged(everything)
    asked, data = asked_table(rows)
    hours = sum(row["duration_s"] for row in rows) / 3600.0
    lines = [
        f"{len(rows)} runs, {hours:.2f} h of simulated time; {len(everything) - len(rows)} more were left out.",
        "",
    ]
    lines += [
        f"- {row['converter']}, {row['group']}, seed {row['seed']}: {row['left_out']}"
        for row in everything
        if "left_out" in row
    ]
    lines += ["", *asked, "", "Error at rest by SCR and X/R, %: median / p95, coverage.", ""]
    lines += bins_table(of(rows, "rest", "long rest"), rest_of_bin)
    lines += ["", "Time to stay within 10 % after a jump, ms: median / p95 (runs), by the new grid.", ""]
    lines += bins_table(of(rows, "jump"), found_of_bin)
    since = {}
    for group in ("jump", "jump and step", "grid-side step"):
        since[group] = errors_since(of(rows, group), max(CYCLES) + 1)
        lines += ["", f"Answers after the event of the group *{group}*.", ""]
        cells = []
        for one in (since[group][k] for k in CYCLES):
            shown = [one[k] for k in ("valid_pct", "median_pct", "p95_pct", "valid_p95_pct", "coverage_pct")]
            cells.append([str(one["cycle"]), *("–" if v != v else f"{v:.1f} %" for v in shown)])
        lines += table(
            ("cycles since", "valid", "error, median", "p95", "p95 of the valid", "coverage of the valid"), cells
        )
    lines += ["", "Errors at rest by SCR and X/R, %, at the 95 % and the 99 % quantile: R, X, |Z|.", ""]
    quantiles = error_quantiles(of(rows, "rest", "long rest"))
    cells = []
    for one in quantiles:
        ends = [f"{low:g}–{high:g}" for low, high in (one["scr"], one["x_over_r"])]
        shown = [f"{one[key]['0.95']:.1f}, {one[key]['0.99']:.1f}" for key in ("R_pct", "X_pct", "Z_pct")]
        cells.append([*ends, *shown])
    lines += table(("SCR", "X/R", "R", "X", "Z"), cells)
    return lines, {"asked": data, "since": since, "errors_at_rest": quantiles, "runs": len(rows)}


def measured_errors(rows: Sequence[Row], seed: int) -> MeasuredErrors:
    """The errors at rest by ranges of the grid, and those of the answers after a jump of the grid over all grids."""
    rest = of(rows, *RESTS)
    answers = at_rest(rest)
    bins = [_bin(rest, answers, scr, x_over_r) for scr in pairwise(SCR) for x_over_r in pairwise(X_OVER_R)]
    return MeasuredErrors(
        estimator="field",
        converters=tuple(dict.fromkeys(row["converter"] for row in rows)),
        background="a drawn background of a real grid with noise, harmonics, unbalance and sensors, switched bridge",
        runs=len(rest) + len(of(rows, "jump")),
        seed=seed,
        bins=tuple(one for one in bins if one.answers),
        jumps=_since(of(rows, "jump")),
        provenance=provenance(),
    )


def _bin(rest: Sequence[Row], answers: Array, scr: tuple[float, float], x_over_r: tuple[float, float]) -> GridBin:
    mine = between(answers, scr, x_over_r)
    grids = np.array([(row["scr"][0], row["x_over_r"][0]) for row in rest]).reshape(-1, 2)
    runs = len(between(grids, scr, x_over_r))
    valid = float(np.mean(mine[:, 5])) if len(mine) else 0.0
    return GridBin(scr, x_over_r, runs, len(mine), round(valid, _DIGITS), _thinned(mine[:, 2:5]))


def _since(jumps: Sequence[Row]) -> tuple[JumpInstant, ...]:
    """Answers k after a jump act from the end of their cycle on. Cycles of 50 and of 60 Hz count alike, at 50 Hz's
    time: the later one."""
    chosen = [row for row in jumps if len(row.get("after", ())) >= max(JUMP_CYCLES)]
    chosen = [chosen[k] for k in _evenly(len(chosen))]
    if not chosen or len(chosen[0]["after"][0]) < 6:
        return ()
    longest = max(row["cycle_s"] for row in chosen)
    return tuple(
        JumpInstant(round(k * longest, 6), _rounded([row["after"][k - 1][3:6] for row in chosen])) for k in JUMP_CYCLES
    )


def _thinned(values: Array) -> Array:
    return _rounded(values[_evenly(len(values))])


def _rounded(values: Any) -> Array:
    return np.asarray(np.round(np.asarray(values, dtype=np.float64), _DIGITS), dtype=np.float64)


def _evenly(count: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(np.int64)) if count else np.arange(0)


def main(folder: Path) -> None:
    rows = kept_runs(run_field, draws(share(), first_seed()), folder / "field" / "runs.jsonl", "field")
    count = max(round(share() * PROBE_COUNT), 1)
    probed = [
        field_draw(converter_of(name), "rest", first_seed() + 5000 + k) for name in CONVERTERS for k in range(count)
    ]
    probe = kept_runs(run_probe, probed, folder / "field" / "probe.jsonl", "field, probe")
    lines, document = markdown(rows)
    lines += ["", "What the probe costs at rest, in a clean grid with noisy sensors.", "", *probe_table(probe)]
    leave(folder, "field", document | {"probe": probe}, lines)
    errors = folder / SHIPPED.name
    errors.unlink(missing_ok=True)
    MEASURED_FILE.write(measured_errors(judged(rows), first_seed()), errors)
