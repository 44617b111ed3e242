"""``vsgdesign comply``: one suite and all packaged ones with three controllers, from the study to page and PDF."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.timing import Row, figure, scaled
from vsgdesign.artifacts.ready import Ready
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.verbs.pipeline.comply import ALL, Asked, comply_study
from vsgdesign.verbs.pipeline.study_tables import kept_tables

STUDY = Path(__file__).resolve().parents[1] / "studies" / "gridcode" / "study.toml"
"""Fixed, scheduled and angle-damped gains: each test is three runs."""

REPEATS = 3
OWN = "own"
MEASURED = ((OWN, False, 20.0), (ALL, False, 90.0), (OWN, True, None))
"""Suite, whether survival maps are drawn, and the wall seconds on two cores that are asked for, with the page."""


def comply() -> list[Row]:
    """Wall time of one suite and of all, and the time of a core for each run. The gain table is designed before."""
    study = load_study(STUDY)
    ready = Ready(tables=kept_tables(study).tables)
    cores, rows = os.cpu_count() or 1, []
    for suite, maps, target in MEASURED:
        asked = Asked(suites=(suite,), maps=maps)
        timings = [_once(study, asked, ready) for _ in range(REPEATS + 1)][1:]
        count = len(timings[0]["rows"])
        parts = [one["timing_s"] for one in timings]
        wall, runs = figure([sum(part.values()) for part in parts]), figure([part["runs"] for part in parts])
        what = f"{'all packaged suites' if suite == ALL else 'suite ' + suite}, three controllers, {count:,} runs"
        per_run = scaled(runs, 1e3 * cores / count)
        if maps:
            rows.append(Row("comply", f"{what}, and survival maps: matrix, maps, page and PDF", wall, "s"))
            continue
        rows += [
            Row("comply", f"{what}: matrix, page and PDF", wall, "s", target=target, limit=f"{cores} cores"),
            Row("comply", f"{what}: a run with its measures and CSV, time of a core", per_run, "ms"),
            Row("comply", f"{what}: page, PDF and figures", figure([part["report"] for part in parts]), "s"),
        ]
    return rows


def _once(study: Study, asked: Asked, ready: Ready) -> dict[str, Any]:
    with TemporaryDirectory() as folder:
        return comply_study(study, Path(folder) / "out", asked, ready=ready, fresh=True)


BENCHMARKS = {"comply": comply}
