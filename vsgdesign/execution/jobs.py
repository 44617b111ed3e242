"""Work in blocks: here, in other processes or on a cluster, and the same whole whatever happened on the way."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import Any, ClassVar, Generic, TypeVar

from vsgdesign.equations.structures import STRUCTURES, Structure
from vsgdesign.errors import WorkerError
from vsgdesign.execution.executors import KEPT, Each, one_thread

Block = TypeVar("Block")
Part = TypeVar("Part")

AHEAD = 1024
"""Blocks that are handed out at a time. How many workers a cluster has may change while it works."""


class Job(ABC, Generic[Block, Part]):
    """Work that falls into blocks. It is complete in itself, and goes to other processes by pickle.

    What a block gives is a part, and parts are merged into a whole of the same type. As it stands here, a part is a
    dictionary of results in JSON's types, and a block is finished if its name is a key of the whole. A job with parts
    of another type says how they are merged, counted and kept.
    """

    what: ClassVar[str]
    """What progress calls the work."""
    most_lines: ClassVar[int | None] = None
    """After so many lines a journal is written anew as one line, where a whole is smaller than its parts."""

    @property
    @abstractmethod
    def key(self) -> str:
        """Hash of everything that a part depends on, the source of the package included."""

    @property
    @abstractmethod
    def blocks(self) -> Sequence[Block]:
        """All blocks, in the order in which they are begun."""

    @abstractmethod
    def run(self, block: Block, /) -> Part:
        """The part that a block gives, the same in every process."""

    def call(self, block: Block, /) -> Callable[[], Part]:
        """The run of a block as it goes to another process: the whole job goes with it."""
        return partial(self.run, block)

    @property
    def nothing(self) -> Any:
        """The whole of no parts."""
        return {}

    def merged(self, whole: Part, part: Part) -> Part:
        """The whole with one more part."""
        return whole | part  # type: ignore[operator]

    def left(self, whole: Part) -> Sequence[Block]:
        """The blocks that are not finished yet."""
        return [block for block in self.blocks if str(block) not in whole]  # type: ignore[operator]

    def size(self, block: Block, /) -> int:  # noqa: ARG002 - a job with unequal blocks looks at it
        """How much of the work a block is."""
        return 1

    def count(self, part: Part) -> int:
        """How many finished things a part has, as the user counts them."""
        return len(part)  # type: ignore[arg-type]

    def document(self, part: Part) -> Any:
        """A part in JSON's types."""
        return part

    def part_of(self, document: Any) -> Part:
        """The part of a document. Raises ValueError, KeyError or TypeError where it is none."""
        if not isinstance(document, dict):
            raise TypeError("a part is a table of results by name")
        return document  # type: ignore[return-value]


def parts_done(
    job: Job[Block, Part], blocks: Iterable[Block], executor: Executor | None = None
) -> Iterator[tuple[Block, Part]]:
    """Each of these blocks with its part, as it is finished.

    After an error or an interruption, what else is finished is still given before it is raised. Raises WorkerError
    where a worker is lost.
    """
    if executor is None:
        for block in blocks:
            yield block, _alone(job.call(block))
        return
    left = iter(blocks)
    under_way: dict[Future[Part], Block] = {}
    try:
        while True:
            for block in islice(left, AHEAD - len(under_way)):
                under_way[submitted(executor, job.call(block))] = block
            if not under_way:
                return
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                yield under_way.pop(future), future.result()
    except (Exception, KeyboardInterrupt) as error:
        for future, block in under_way.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                yield block, future.result()
        if isinstance(error, BrokenExecutor | CancelledError):
            raise _lost(error) from error
        raise
    finally:
        for future in under_way:
            future.cancel()


def submitted(executor: Executor, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    """A call on one of an executor's workers, with one thread and with the structures that this process knows."""
    return executor.submit(_with_structures, tuple(STRUCTURES.added), function, *arguments)


@contextmanager
def workers_needed() -> Iterator[None]:
    """Within the block, a worker that is lost is a WorkerError."""
    try:
        yield
    except (BrokenExecutor, CancelledError) as error:
        raise _lost(error) from error


def _lost(error: BaseException) -> WorkerError:
    return WorkerError(f"workers: {str(error) or 'a process was lost'}. {KEPT}")


def each_of(executor: Executor | None) -> Each:
    """A ``map`` on an executor's workers, each with one thread. Without an executor it is ``map`` itself.

    Functions and arguments are sent to other processes. The ``map`` raises WorkerError if a process is lost.
    """
    if executor is None:
        return map

    def each(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        futures = [submitted(executor, function, item) for item in items]
        try:
            with workers_needed():
                for future in futures:
                    yield future.result()
        finally:
            for future in futures:
                future.cancel()

    return each


def begun(executor: Executor | None, function: Callable[..., Any], *arguments: Any, **named: Any) -> Callable[[], Any]:
    """Begins a call on one of an executor's workers, with one thread, and returns what waits for its result.

    The function, what it is given and what it returns go to another process and back. Without an executor the call is
    made here, when its result is asked for. What waits raises the errors of the call, and WorkerError where the worker
    is lost.
    """
    call = partial(function, *arguments, **named)
    if executor is None:
        return partial(_alone, call)
    future = submitted(executor, call)

    def result() -> Any:
        with workers_needed():
            return future.result()

    return result


def _with_structures(structures: Iterable[Structure], function: Callable[..., Any], *arguments: Any) -> Any:
    """A fresh process knows the project's own structures alone."""
    for structure in structures:
        STRUCTURES.register(structure)
    return _alone(function, *arguments)


def _alone(function: Callable[..., Any], *arguments: Any) -> Any:
    with one_thread():
        return function(*arguments)
