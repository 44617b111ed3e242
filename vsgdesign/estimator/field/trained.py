"""From a study and a recipe to field weights, with what a report shows of how they came about. No PyTorch here."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts import provenance
from vsgdesign.artifacts.field_weights import FieldWeights
from vsgdesign.artifacts.files import plain
from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.data_set import check_enough
from vsgdesign.estimator.field.cycles import FieldCycles
from vsgdesign.estimator.field.recipe import FieldRecipe, check_field_recipe
from vsgdesign.estimator.field.runs import generate_cycles
from vsgdesign.estimator.field.scores import AFTER, GROUPS, WAYS, GroupScore, changes_by_name, field_scores
from vsgdesign.estimator.trained import require_torch
from vsgdesign.execution.executors import How
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.parameters import load_study
from vsgdesign.parameters.loading import study_from_text
from vsgdesign.parameters.study import Study

Array = NDArray[np.float64]

_CASE = (
    'base = "{0}"\nstudy.name = "{0}"\nsimulation = {{ duration = "1 s", P_ref = 0, Q_ref = 0 }}\n'
    'controllers = [{{ name = "field", kind = "scheduled" }}]\n'
)
"""A packaged case as a study: what a case leaves open is drawn from the recipe anyway."""

GROUP_WORDS = {
    "jump": "Jumps of |Z_g| by a factor of 1.5 or more at 0.1 pu of current or more",
    "jump_and_step": "Such jumps with a step of the grid's voltage, phase or frequency",
    "small_jump": "Smaller jumps, or at less current",
    "grid_step": "Steps of the grid's voltage, phase or frequency alone",
    "rest": "Without an event of the grid",
}
"""The groups of changes in words."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TrainedFieldNetwork:
    """Weights and how they came about."""

    weights: FieldWeights
    scores: dict[str, dict[str, GroupScore]]
    """The three ways on the test runs, by way and group (:mod:`vsgdesign.estimator.field.scores`)."""
    history: dict[str, Array]
    """``epoch``, ``training`` and ``validation`` loss."""
    best_epoch: int
    runs: dict[str, int]
    """Runs of each part."""
    cycles: dict[str, int]
    """Cycles of each part."""
    broken: int
    """Runs that diverged and ended there."""
    changes: dict[str, int]
    """Changes of each kind in the test runs."""
    timing_s: dict[str, float]
    """Wall time of ``runs`` and ``training``."""


def train_field_network(
    study: Study,
    recipe: FieldRecipe,
    *,
    seed: int = 0,
    hidden: int | None = None,
    out: str | Path | None = None,
    progress: Progress = silent,
    **how: Unpack[How],
) -> TrainedFieldNetwork:
    """Make the runs of a recipe, train a network on them and compare it with the recursions alone.

    ``hidden`` replaces the recipe's. ``out`` keeps the runs, and finished ones of an interrupted call. The same
    arguments give the same weights, however the runs are made (``how``). Raises InfeasibleStudyError without PyTorch,
    and the errors of :func:`vsgdesign.estimator.field.runs.generate_cycles`.
    """
    require_torch()
    check_field_recipe(recipe)
    check_enough(recipe.runs, "runs")
    studies = studies_of(study, recipe)
    begin = time.perf_counter()
    cycles = generate_cycles(studies, recipe, seed, out=out, progress=progress, **how)
    made = time.perf_counter() - begin
    trained = train_on_cycles(cycles, recipe, seed=seed, hidden=hidden, progress=progress)
    trained.timing_s.update({"runs": made, "training": time.perf_counter() - begin - made})
    return trained


def studies_of(study: Study, recipe: FieldRecipe) -> list[Study]:
    """The study, and the further converters of a recipe. Raises StudyError naming the one that cannot be read."""
    found = [study]
    for one in recipe.converters:
        try:
            found.append(study_from_text(_CASE.format(one), one) if one.startswith("case:") else load_study(one))
        except StudyError as error:
            raise StudyError(
                "recipe", [Fault("converters", f'"{one}"', str(error), "Give case:NAME or the file of a study.")]
            ) from error
    return found


def train_on_cycles(
    cycles: FieldCycles,
    recipe: FieldRecipe,
    *,
    seed: int,
    hidden: int | None = None,
    progress: Progress = silent,
) -> TrainedFieldNetwork:
    """Train on runs that are there already, and judge the three ways on the test runs."""
    require_torch()
    from vsgdesign.estimator.field.training import FieldTrainingSettings, train_layers

    settings = FieldTrainingSettings(
        hidden=recipe.hidden if hidden is None else hidden,
        epochs=recipe.epochs,
        weight=recipe.weight,
        weighted=recipe.weighted,
    )
    split = cycles.split(seed)
    training = train_layers(cycles, split, settings, seed, progress)
    test = cycles.rows(split.test)
    scores = field_scores(test, training.layers, training.radius_squared, recipe.gate)
    runs = {name: len(np.unique(cycles.run[rows])) for name, rows in vars(split).items()}
    weights = FieldWeights(
        features=cycles.names,
        layers=training.layers,
        radius_squared=training.radius_squared,
        gate=recipe.gate,
        converters=tuple(cycles.header["converters"]),
        data_hash=cycles.hash,
        recipe=dict(cycles.header["recipe"]),
        seed=seed,
        training={
            "settings": asdict(settings),
            "best_epoch": training.best_epoch,
            "loss": {name: float(training.history[name][training.best_epoch]) for name in ("training", "validation")},
            "runs": runs,
            "test": _short(scores_document(scores)),
        },
        provenance=dict(provenance()),
    )
    return TrainedFieldNetwork(
        weights=weights,
        scores=scores,
        history=training.history,
        best_epoch=training.best_epoch,
        runs=runs,
        cycles={name: len(rows) for name, rows in vars(split).items()},
        broken=len(np.unique(cycles.run[cycles.broken])),
        changes=changes_by_name(test),
        timing_s={},
    )


def scores_document(scores: dict[str, dict[str, GroupScore]]) -> dict[str, Any]:
    """The scores in JSON's types; what is no number, or is not reached, is None."""
    return {way: {group: _finite(plain(asdict(scores[way][group]))) for group in GROUPS} for way in WAYS}


def _short(document: dict[str, Any]) -> dict[str, Any]:
    """The scores for the weights' file: of the series only the cycles of AFTER."""
    for groups in document.values():
        for one in groups.values():
            for name in ("error_p95", "valid_share", "valid_error_p95"):
                one[name] = {str(k): one[name][k] for k in AFTER}
    return document


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(item) for item in value]
    return value if not isinstance(value, float) or math.isfinite(value) else None


def verdict(scores: dict[str, dict[str, GroupScore]]) -> list[str]:
    """Sentences: what the network behind its gate does better or worse than the recursions alone."""
    sentences = []
    for group, words in GROUP_WORDS.items():
        alone, gated = scores["physics"][group], scores["gated"][group]
        if alone.changes == 0:
            continue
        found = [
            f"{AFTER[0]} cycles after it {_percent(gated.valid_share[AFTER[0]])} of the answers are valid instead of "
            f"{_percent(alone.valid_share[AFTER[0]])}, with a 95th percentile of their error of "
            f"{_percent(gated.valid_error_p95[AFTER[0]])} instead of {_percent(alone.valid_error_p95[AFTER[0]])}"
        ]
        if "jump" in group:
            found.append(
                f"the 95th percentile of the time to stay within 10 % is {_milliseconds(gated.t10_s[2])} instead of "
                f"{_milliseconds(alone.t10_s[2])}"
            )
        found.append(
            f"a valid answer is wrong by more than 20 % for {_milliseconds(gated.wrong_s)} per change instead of "
            f"{_milliseconds(alone.wrong_s)}"
        )
        sentences.append(f"{words} ({alone.changes}): {'; '.join(found)}.")
    return sentences


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %" if math.isfinite(share) else "–"


def _milliseconds(seconds: float) -> str:
    if math.isnan(seconds):
        return "–"
    return f"{1e3 * seconds:.3g} ms" if math.isfinite(seconds) else "never within the run"
