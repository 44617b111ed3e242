"""The page that simulates, made beside the figures of a report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import WorkerError
from vsgdesign.execution.executors import Progress, known_here_alone, worker_count, worker_processes
from vsgdesign.execution.jobs import begun
from vsgdesign.report.explore.lattice import PART_LATTICE
from vsgdesign.report.explore.page_file import live_page
from vsgdesign.report.explore.page_starts import PageCase
from vsgdesign.report.page.live import StaticPage
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.study import ControllerSpec

MOST = 4
"""Controllers of a part: as many as the explorer begins with."""


def told_apart(study: Study, ready: Ready) -> list[ControllerSpec]:
    """The controllers of a study but those that are the same as another one but for their estimate."""

    def same(spec: ControllerSpec) -> bool:
        return any(
            replace(spec, name=other.name, estimate="truth") == other and ready.table(spec) == ready.table(other)
            for other in study.controllers
        )

    return [spec for spec in study.controllers if spec.estimate == "truth" or not same(spec)]


def shown_in_part(study: Study, ready: Ready, cases: Sequence[PageCase] = ()) -> list[str]:
    """The controllers of a part. Of more than fit: those of its cases, the last one, which a study is about, and the
    first ones. The page tells every controller the grid, so that those which differ in their estimate alone are one."""
    names = [spec.name for spec in told_apart(study, ready)]
    of_cases = [case.study.controllers[0].name for case in cases]
    kept = list(dict.fromkeys([*of_cases, names[-1], *names]))[:MOST]
    return [spec.name for spec in study.controllers if spec.name in kept]


@contextmanager
def live_begun(
    study: Study,
    ready: Ready,
    workers: int | None = None,
    lattice: tuple[int, int] = PART_LATTICE,
    executor: Executor | None = None,
    cases: Sequence[PageCase] = (),
) -> Iterator[Callable[[], StaticPage]]:
    """Begins to make the page of a study in another process; what is yielded waits for it. With one worker it is
    made in that call. An ``executor`` that is there anyway is used.
    With ``cases`` the page opens with the first of them."""
    with ExitStack() as held:
        alone = worker_count(workers) == 1 or known_here_alone()
        if executor is None and not alone:
            executor = held.enter_context(worker_processes(1))
        shown = shown_in_part(study, ready, cases)
        kept = tuple(case for case in cases if case.study.controllers[0].name in shown)
        yield begun(executor, live_page, study, ready, lattice, controllers=shown, cases=kept)


def waited_for(begin: Callable[[], StaticPage], tell: Progress) -> StaticPage:
    """The page when it is made. A report does without it where it cannot be made."""
    tell("make the live page", 0.0)
    try:
        found = begin()
    except WorkerError as error:
        found = StaticPage(None, f"It was not made: {error}")
    tell("make the live page", 1.0)
    return found
