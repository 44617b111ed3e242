"""The page that simulates, made beside the figures of a report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager

from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import WorkerError
from vsgdesign.execution.executors import known_here_alone, worker_count, worker_processes
from vsgdesign.execution.jobs import begun
from vsgdesign.execution.progress import Progress
from vsgdesign.report.explore.lattice import PART_LATTICE
from vsgdesign.report.explore.page_cases import PageCase
from vsgdesign.report.explore.page_file import live_page
from vsgdesign.report.page.live import StaticPage
from vsgdesign.study.parameters import Study


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
        yield begun(executor, live_page, study, ready, lattice, cases=tuple(cases))


def waited_for(begin: Callable[[], StaticPage], tell: Progress) -> StaticPage:
    """The page when it is made. A report does without it where it cannot be made."""
    tell("make the live page", 0.0)
    try:
        found = begin()
    except WorkerError as error:
        found = StaticPage(None, f"It was not made: {error}")
    tell("make the live page", 1.0)
    return found
