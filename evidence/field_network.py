"""What the packaged network adds to the field estimator, on runs that neither its training nor its gate has seen.

The recursions alone, the network behind its gate, and the network at all times answer in the same runs: those of the
recipe that it was trained with, from another seed. Finished runs are kept in the folder.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from evidence._kept_runs import share
from evidence._tables import leave, table
from vsgdesign.artifacts.field_weights import read_field_weights
from vsgdesign.estimator.recipes import FIELD_RECIPES
from vsgdesign.estimator.scores import GROUP_WORDS, GROUPS, WAYS, WINDOWS, GroupScore, field_scores, scores_document
from vsgdesign.estimator.specification import FIELD_NETWORK, generate
from vsgdesign.study.parameters import load_study

RECIPE = Path(__file__).with_suffix(".toml")
STUDY = Path(__file__).resolve().parents[1] / "studies" / "survival" / "study.toml"
SEED, RUNS = 31, 150
CYCLES = (2, 5, 10)
WAY_WORDS = {"physics": "recursions", "gated": "with network", "ungated": "network alone"}


def main(folder: Path) -> None:
    """Prints the table, and leaves it as Markdown and the scores as JSON."""
    recipe = replace(FIELD_RECIPES.load(RECIPE), runs=max(round(RUNS * share()), 6))
    cycles = generate(FIELD_NETWORK, load_study(STUDY), recipe, SEED, out=folder / "field_network.npz", workers=2)
    weights = read_field_weights()
    scores = field_scores(cycles, weights.layers, weights.radius_squared, weights.gate)
    leave(folder, "field_network", scores_document(scores), markdown(scores, recipe.runs))


def markdown(scores: dict[str, dict[str, GroupScore]], runs: int) -> list[str]:
    """The table: a row for each group and way."""
    head = ["change", "answers", *(f"{k} cycles" for k in CYCLES), "within 10 %", "wrong", *WINDOWS]
    words = (
        f"These are {runs} runs of three converters in the `dirty` background, drawn from another seed than the "
        'training runs. The columns "2 cycles" to "10 cycles" give the share of valid answers that long after the '
        'change and, after the comma, the 95th percentile of their error, both in %. "Within 10 %" gives the median '
        'and the 95th percentile of the time in ms after which the error stays below 10 %. "Wrong" is the mean time in '
        "ms, per change, with a valid answer whose error is above 20 %. The last three columns give the share of "
        "valid answers in % whose 95 % ellipse contains the truth, by cycles after the change."
    )
    rows = []
    for group in GROUPS:
        for way in WAYS:
            one = scores[way][group]
            name = f"{GROUP_WORDS[group].replace('|Z_g|', 'the impedance')} ({one.changes})" if way == WAYS[0] else ""
            cells = [f"{_percent(one.valid_share[k])}, {_percent(one.valid_error_p95[k])}" for k in CYCLES]
            times = f"{_ms(one.t10_s[0])}, {_ms(one.t10_s[2])}" if "jump" in group else "–"
            covered = [_percent(one.coverage[name]) for name in WINDOWS]
            rows.append([name, WAY_WORDS[way], *cells, times, _ms(one.wrong_s), *covered])
    return [words, "", *table(head, rows)]


def _percent(share_of: float) -> str:
    return f"{100.0 * share_of:.0f}" if math.isfinite(share_of) else "–"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}" if math.isfinite(seconds) else "never"
