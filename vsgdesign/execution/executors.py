"""Where independent work runs: in this process, in others on this machine, or on a Dask cluster."""

from __future__ import annotations

import importlib
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from typing import Any, TypedDict

from vsgdesign.errors import WorkerError
from vsgdesign.execution.processes import worker_processes
from vsgdesign.execution.reproducible import environment, reproducible_environment

Each = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""What ``map`` is: results of a function of one argument, in order, here or elsewhere."""


class How(TypedDict, total=False):
    """How work in blocks is done; a function takes them as arguments of its own and passes them on."""

    workers: int | None
    """Processes on this machine; None: one per core."""
    cluster: str | None
    """A Dask cluster in place of them: ``local``, or the address of a scheduler."""
    fresh: bool
    """Whether finished blocks of an interrupted call are forgotten."""
    say: Callable[[str], None] | None
    """Takes a sentence where finished blocks are of other work."""


_CONNECT_S = 10.0
"""How long a scheduler may take to answer."""

LOST = (
    "a process was lost (out of memory?). What is finished is kept: run the same command again, with fewer workers if "
    "it happens once more."
)
"""What an error says where a worker did not come back."""


@contextmanager
def executor_of(
    workers: int | None = None, cluster: str | None = None, *, reproducible: bool = False
) -> Iterator[Executor | None]:
    """Local processes (None: one per core; 1: no other process), or a Dask cluster.

    ``cluster``: ``local`` starts one here, anything else is the address of a scheduler. It needs the extra
    ``cluster``. ``reproducible``: the processes that start here compute the same bits on every x86 processor
    (:mod:`vsgdesign.execution.reproducible`), and even a single one is another process. Raises WorkerError where the
    package for a cluster is missing, or the scheduler cannot be reached.
    """
    with environment(reproducible_environment() if reproducible else {}):
        if cluster is not None:
            with _dask(cluster, workers) as executor:
                yield executor
            return
        count = worker_count(workers)
        if count == 1 and not reproducible:
            yield None
            return
        with worker_processes(count) as pool:
            yield pool


def worker_count(workers: int | None) -> int:
    """How many processes work on this machine; None asks for one per core."""
    return (os.cpu_count() or 1) if workers is None else workers


@contextmanager
def _dask(cluster: str, workers: int | None) -> Iterator[Executor]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise WorkerError(
            'cluster: the package distributed is missing. Install it with: pip install "vsgdesign[cluster]"'
        ) from error
    with ExitStack() as stack:
        address: Any = cluster
        if cluster == "local":
            address = distributed.LocalCluster(
                n_workers=worker_count(workers),
                threads_per_worker=1,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
            stack.enter_context(address)
        try:
            client = stack.enter_context(distributed.Client(address, timeout=_CONNECT_S))
        except (OSError, ValueError) as error:
            raise WorkerError(
                f'cluster = "{cluster}": no scheduler answers. Give "local" or an address such as tcp://host:8786.'
            ) from error
        try:
            yield client.get_executor(pure=False)
        except (distributed.KilledWorker, distributed.CommClosedError) as error:
            raise WorkerError(f'cluster = "{cluster}": {LOST}') from error
