"""Survival in a dirty grid with the field estimator driving, beside the same disturbances with the truth.

Nothing is lent to the converter: it starts in the middle of its schedule's grids, learns the grid, and goes through a
random disturbance with switching, sensors and the current limit. Each draw is run twice, with the estimate and with the
true grid. Finished runs are kept in the folder. ``VSGDESIGN_FIELD_SHARE=0.1`` measures a tenth of the draws,
``VSGDESIGN_FIELD_SEED=0`` begins at another seed.
"""

from __future__ import annotations

import json
from pathlib import Path

from evidence._field_converters import CONVERTERS
from evidence._field_runs import converter_of
from evidence._field_survival_draws import survival_draw
from evidence._field_survival_runs import VARIANTS, Task, run_survival
from evidence._field_survival_summary import asked_table, figures, kinds_table, lost_lines, pairs_of
from evidence._kept_runs import first_seed, kept_runs, share

COUNT = 702
"""Draws on each converter: 26 of every share of the kinds."""


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
    text = "\n".join(lines) + "\n"
    kinds = {
        kind: [pair for pair in pairs if pair.field["group"] == kind] for kind in {p.field["group"] for p in pairs}
    }
    document = {"all": figures(pairs), "kinds": {kind: figures(mine) for kind, mine in kinds.items()}}
    (folder / "field_survival.json").write_text(json.dumps(document, indent=1, ensure_ascii=False))
    (folder / "field_survival.md").write_text(text)
    print(text)
