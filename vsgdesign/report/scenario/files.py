"""Every figure of a scenario, as files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING

from vsgdesign.report.drawing.figure_types import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.files import write_figure
from vsgdesign.report.scenario.bode_figures import bode_figures
from vsgdesign.report.scenario.estimate_figures import estimate_figures
from vsgdesign.report.scenario.field_figures import field_figures
from vsgdesign.report.scenario.figures import scenario_figures
from vsgdesign.simulation.scenario import ScenarioResult

if TYPE_CHECKING:
    from vsgdesign.estimator.trained import TrainedEstimator


def all_figures(result: ScenarioResult, trained: TrainedEstimator | None = None) -> Iterator[NamedFigure]:
    """Every figure of a scenario, and of the training of its network, one at a time."""
    yield from _figures_of_runs(result, trained)
    yield from bode_figures(result)


def _figures_of_runs(result: ScenarioResult, trained: TrainedEstimator | None) -> Iterator[NamedFigure]:
    yield from scenario_figures(result)
    yield from estimate_figures(result)
    yield from field_figures(result)
    if trained is not None:
        from vsgdesign.report.estimator.training_figures import training_figures

        yield from training_figures(trained)


def begin_all(
    result: ScenarioResult,
    folder: Path,
    trained: TrainedEstimator | None = None,
    executor: Executor | None = None,
) -> Callable[[], list[WrittenFigure]]:
    """Begins to write every figure of a scenario into an existing folder, and returns what waits for them.

    Workers of an ``executor`` draw what is laid out here: this takes three quarters of the time. Bode plots are begun
    when the figures are waited for: python-control is loaded for them while the workers are still busy. Without an
    executor a figure is written before the next one is laid out.
    """
    if executor is None:
        figures = [write_figure(figure, folder) for figure in all_figures(result, trained)]
        return lambda: figures
    from vsgdesign.execution.jobs import begun

    waits = [begun(executor, write_figure, figure, folder) for figure in _figures_of_runs(result, trained)]

    def written() -> list[WrittenFigure]:
        last = [begun(executor, write_figure, figure, folder) for figure in bode_figures(result)]
        return [wait() for wait in [*waits, *last]]

    return written
