"""Estimators of the grid: training a network, and comparing and stressing methods."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from vsgdesign.artifacts.files import plain
from vsgdesign.execution.executors import How
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.shown import Shown, given_study, names_of

if TYPE_CHECKING:
    from vsgdesign.estimator.comparison import Comparison
    from vsgdesign.estimator.stress import Stress
    from vsgdesign.estimator.trained import TrainedEstimator, TrainedFieldNetwork
    from vsgdesign.report.drawing.figures import NamedFigure

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Training(Shown):
    """The result of :func:`train`. ``trained`` has the weights and the history of the search."""

    trained: TrainedEstimator | TrainedFieldNetwork
    document: dict[str, Any]

    @property
    def title(self) -> str:
        """The recipe and the file of the weights."""
        return f"Network of recipe {self.document['recipe']}: {self.document['file']}"

    def sentences(self) -> Sequence[str]:
        """What ``vsgdesign estimator train`` prints."""
        from vsgdesign.report.estimator.training import trained_sentences

        return trained_sentences(self.document)

    def to_dict(self) -> dict[str, Any]:
        """What ``vsgdesign estimator train --json`` prints."""
        return plain(self.document)

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.estimator.trained import TrainedEstimator
        from vsgdesign.report.estimator.training import field_training_figures, training_figures

        if isinstance(self.trained, TrainedEstimator):
            yield from training_figures(self.trained)
        else:
            yield from field_training_figures(self.trained)


def train(
    study: Study | str | Path,
    out: str | Path,
    *,
    recipe: str | None = None,
    seed: int | None = None,
    hidden: int | None = None,
    components: int | None = None,
    windows: str | Path | None = None,
    report: str | Path | None = None,
    progress: Progress | None = None,
    **how: Unpack[How],
) -> Training:
    """Trains a network on simulated windows and writes its weights to ``out``, as ``vsgdesign estimator train`` does.

    ``recipe`` (a packaged name or a file), ``seed``, ``hidden`` units and principal ``components`` are those of the
    study's [estimator] where they are None. ``windows`` is a file (.npz) that keeps the windows, or the runs of the
    recipe field; ``report`` is a folder for its page. ``how``: as in :class:`vsgdesign.execution.executors.How`. Raises
    the errors of :func:`vsgdesign.verbs.pipeline.estimators.train_weights_file`.
    """
    from vsgdesign.study.parameters.estimator import EstimatorSpec
    from vsgdesign.verbs.pipeline.estimators import train_weights_file
    from vsgdesign.verbs.pipeline.one_unit import alone

    study = alone(given_study(study, "train"), "train")
    given = {"recipe": recipe, "seed": seed, "hidden": hidden, "components": components}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    spec = replace(study.estimator or EstimatorSpec(), **changes)
    found: list[TrainedEstimator | TrainedFieldNetwork] = []
    document = train_weights_file(
        study, spec, out, data=windows, report=report, done=found.append, progress=progress, **how
    )
    return Training(found[0], document)


@dataclass(frozen=True)
class EstimatorComparison(Shown):
    """The result of :func:`compare_estimators` or :func:`stress_estimators`, with the folder of its page."""

    found: Comparison | Stress
    document: dict[str, Any]
    folder: Path

    @property
    def title(self) -> str:
        """The study that was compared on."""
        return f"Estimators: {self.document['study']}"

    def sentences(self) -> Sequence[str]:
        """The answer, then a sentence for each method, as on the page."""
        from vsgdesign.estimator.comparison import Comparison
        from vsgdesign.report.estimator import page

        if isinstance(self.found, Comparison):
            return [page.comparison_headline(self.found), *page.comparison_conclusion(self.found)]
        return [page.stress_headline(self.found), *page.stress_conclusion(self.found)]

    def to_dict(self) -> dict[str, Any]:
        """The content of results.json."""
        return self.document

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.estimator.comparison import Comparison
        from vsgdesign.report.estimator.figures import comparison_figures, stress_figures

        yield from comparison_figures(self.found) if isinstance(self.found, Comparison) else stress_figures(self.found)


def compare_estimators(
    study: Study | str | Path,
    out: str | Path,
    *,
    weights: Sequence[str | Path] = (),
    recipes: Sequence[str] = (),
    seed: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> EstimatorComparison:
    """Compares classical methods and networks on the same windows, as ``vsgdesign estimator compare`` does.

    The folder ``out`` gets the page. ``weights`` are files of networks; for each of ``recipes`` one is trained. Raises
    the errors of :func:`vsgdesign.verbs.pipeline.estimators.report_comparison`.
    """
    from vsgdesign.verbs.pipeline.estimators import report_comparison

    return _estimators(report_comparison, "compare_estimators", study, out, weights, recipes, seed, workers, progress)


def stress_estimators(
    study: Study | str | Path,
    out: str | Path,
    *,
    weights: Sequence[str | Path] = (),
    recipes: Sequence[str] = (),
    seed: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> EstimatorComparison:
    """Tests the same methods in conditions that they were not trained for, as ``vsgdesign estimator stress`` does. The
    arguments and the errors are those of :func:`compare_estimators`."""
    from vsgdesign.verbs.pipeline.estimators import report_stress

    return _estimators(report_stress, "stress_estimators", study, out, weights, recipes, seed, workers, progress)


def _estimators(
    make: Callable[..., dict[str, Any]],
    what: str,
    study: Study | str | Path,
    out: str | Path,
    weights: Sequence[str | Path],
    recipes: Sequence[str],
    seed: int | None,
    workers: int | None,
    progress: Progress | None,
) -> EstimatorComparison:
    from vsgdesign.study.parameters.estimator import EstimatorSpec
    from vsgdesign.verbs.pipeline.one_unit import alone

    study = alone(given_study(study, what), what)
    drawn_from = (study.estimator or EstimatorSpec()).seed if seed is None else seed
    found: list[Comparison | Stress] = []
    asked: dict[str, Any] = {"weights": names_of(weights), "recipes": names_of(recipes), "workers": workers}
    document = make(study, out, seed=drawn_from, done=found.append, progress=progress, **asked)
    return EstimatorComparison(found[0], document, Path(out))
