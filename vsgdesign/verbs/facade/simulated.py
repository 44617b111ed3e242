"""EMT runs of a study's controllers, with the figures and sentences of the report; and result folders and pages, with
the same files that the commands of the command line write."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.ready import Ready
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.designed import Margins
from vsgdesign.verbs.facade.shown import BRIDGES, Bridge, Shown, frame_of, given_study, known_word, names_of
from vsgdesign.verbs.facade.tables import DesignedTable

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from numpy.typing import NDArray

    from vsgdesign.metrics import EventMetrics
    from vsgdesign.report.drawing.figures import NamedFigure
    from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult


@dataclass(frozen=True)
class Run(Shown):
    """A simulated study. ``result`` holds every controller's series, events and gains."""

    result: ScenarioResult

    @property
    def title(self) -> str:
        """The study's title."""
        return self.result.study.title

    @property
    def study(self) -> Study:
        """The study that was simulated, as it was given."""
        return self.result.given or self.result.study

    def controller(self, name: str | None = None) -> ControllerResult:
        """The result of one controller, or of the first one without a name. Raises KeyError for an unknown name."""
        known = {one.spec.name: one for one in self.result.controllers}
        if name is None:
            return self.result.controllers[0]
        if name not in known:
            raise KeyError(f"no controller is called {name!r}. There are: {', '.join(known)}.")
        return known[name]

    def series(self, controller: str | None = None) -> Mapping[str, NDArray[np.float64]]:
        """Time series of one controller by name, in SI units over ``t_s``.

        Without a name it is the first controller.
        """
        return self.controller(controller).series

    def frame(self, controller: str | None = None) -> pd.DataFrame:
        """The same series as a data frame; units are in its ``attrs``. Needs the extra ``frames``."""
        one = self.controller(controller)
        columns = (values.tolist() for values in one.series.values())
        return frame_of(list(one.series), zip(*columns, strict=True), controller=one.spec.name)

    def events(self, controller: str | None = None) -> tuple[EventMetrics, ...]:
        """Overshoot, settling time and other figures of every event of one controller."""
        return tuple(self.controller(controller).events)

    def sentences(self) -> Sequence[str]:
        """The first sentences of the report: which targets were met or missed, and by how much."""
        from vsgdesign.report.scenario.outcomes import step_outcomes
        from vsgdesign.report.scenario.verdict import verdict

        warnings = [one.message for one in self.result.instabilities]
        return [*warnings, *verdict(self.result, step_outcomes(self.result))]

    def to_dict(self) -> dict[str, Any]:
        """The content of results.json of ``vsgdesign simulate``."""
        from vsgdesign.verbs.pipeline.results import results_document

        return plain(results_document(self.result, {}))

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.scenario.figures import all_figures

        yield from all_figures(self.result)


def simulate(
    study: Study | str | Path,
    *,
    bridge: Bridge | None = None,
    strict: bool = False,
    ready: Ready | None = None,
    workers: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> Run:
    """Simulates every controller of a study, or of the study of a file, through its events, in memory.

    ``bridge`` is ``averaged`` or ``pwm`` and replaces that of the study. With ``strict`` a run has the bits of a page
    of the explorer, as with ``strict`` in the study's [simulation]. ``ready`` holds gain tables and the network
    from an earlier call of :func:`vsgdesign.verbs.pipeline.making.make_ready`. Without it, those that the study asks
    for are read, taken from below ``out`` where an earlier command has left them, or designed and trained first (on
    ``workers`` processes). ``warn`` is called with one sentence for each controller that is unstable by the linear
    model, and for each whose dc side cannot do what is asked. Raises StudyError, InfeasibleStudyError, ArtifactError
    and SimulationDivergedError, and ValueError for another bridge.
    """
    from vsgdesign.execution.executors import silent
    from vsgdesign.simulation.lanes.beforehand import told_beforehand
    from vsgdesign.simulation.scenario import run_scenario
    from vsgdesign.verbs.pipeline.making import make_ready
    from vsgdesign.verbs.pipeline.one_unit import alone
    from vsgdesign.verbs.pipeline.study_tables import with_left_tables

    if bridge is not None:
        known_word("bridge", bridge, BRIDGES)
    tell, study = progress or silent, alone(given_study(study, "simulate"), "simulate")
    study = study.made_strict() if strict else study
    there = ready or make_ready(with_left_tables(study), bridge=bridge, workers=workers, progress=progress)
    if warn is not None:
        for text in told_beforehand(study, there, run=False):
            warn(text)
    return Run(
        run_scenario(
            study,
            there,
            bridge=bridge,
            warn=warn,
            progress=lambda name, t_s: tell(f"simulate {name}", t_s / study.simulation.duration),
        )
    )


def write_report(
    what: Study | Run | Margins | DesignedTable,
    out: str | Path,
    *,
    explorer: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """Writes report.html, results.json, figures and data of a result into the folder ``out``.

    A study is run first, as ``vsgdesign run`` does. A :class:`Run`, :class:`Margins` or :class:`DesignedTable` is
    written as it is. A folder of the same kind is replaced if nobody has changed it since. Anything else is left
    unchanged and raises ArtifactError. ``explorer``: whether it has what simulates in the browser. Returns the content
    of results.json.
    """
    if isinstance(what, Study):
        from vsgdesign.verbs.pipeline.one_unit import as_one_converter
        from vsgdesign.verbs.pipeline.plant import run_plant_study
        from vsgdesign.verbs.pipeline.run import run_study

        what = as_one_converter(what)
        if what.plant is not None:
            return run_plant_study(what, out, report=True, progress=progress)[1]
        return run_study(what, out, report=explorer or "still", progress=progress)
    if isinstance(what, Run):
        from vsgdesign.verbs.pipeline.run import write_run

        return write_run(what.result, out, explorer=explorer, progress=progress)
    if isinstance(what, Margins):
        from vsgdesign.verbs.pipeline.margins import write_stability

        return write_stability(what.result, out, explorer=explorer, progress=progress)
    from vsgdesign.verbs.pipeline.table import report_table

    return report_table(what.table, out, progress=progress)


def explore(
    study: Study | str | Path,
    page: str | Path,
    *,
    controllers: Sequence[str] | None = None,
    scr: float | None = None,
    x_over_r: float | None = None,
    lattice: tuple[int, int] = (48, 32),
    bridge: Bridge = "averaged",
    ready: Ready | None = None,
    workers: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Path:
    """Writes the page that simulates, as ``vsgdesign explore --page`` does, and returns its path.

    The page is one file without a server. It shows these ``controllers`` of the study (None: those with which the
    explorer begins), and opens on the grid of ``scr`` and ``x_over_r`` (None: that of the study). ``lattice`` has the
    numbers of SCR and X/R, 2 to 120 and 1 to 80. Runs have the ``bridge`` "averaged" or "pwm" in place of the study's;
    those of a switched one have no verdict on the page. ``ready`` holds gain tables from an earlier call of
    :func:`vsgdesign.verbs.pipeline.making.make_ready`. Without it, those that the study asks for are read, taken from
    below ``out`` where an earlier command has left them, or designed first and kept there. A page is replaced, any
    other file is left unchanged. Raises StudyError, InfeasibleStudyError and ArtifactError, and ValueError for another
    bridge.
    """
    from vsgdesign.report.explore.lattice import lattice_counts
    from vsgdesign.report.explore.page_file import write_page
    from vsgdesign.report.explore.session import session_from
    from vsgdesign.verbs.pipeline.one_unit import alone
    from vsgdesign.verbs.pipeline.study_tables import kept_tables

    known_word("bridge", bridge, BRIDGES)
    counts = lattice_counts("x".join(map(str, lattice)))
    study = alone(given_study(study, "explore"), "explore")
    begins = {
        "controllers": None if controllers is None else list(names_of(controllers)),
        "scr": scr,
        "x_over_r": x_over_r,
    }
    start = {name: value for name, value in begins.items() if value is not None}
    there = ready or Ready(tables=kept_tables(study, workers=workers, progress=progress).tables)
    session = session_from(study, there, start, bridge=bridge)
    write_page(session, page, lattice=counts, progress=progress, workers=workers)
    return Path(page)
