"""Where work runs: in this process, in others on this machine, or on a Dask cluster; on request with the same bits.

And how it runs there: how it says where it is, on how many threads, and what becomes of its memory.
"""

from __future__ import annotations

import ctypes
import functools
import gc
import importlib
import logging
import os
import platform
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any, TypedDict

from threadpoolctl import threadpool_limits

from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import WorkerError
from vsgdesign.execution.workers import WorkerPool

Progress = Callable[[str, float], None]
"""Called with what is being done and the share done, 0 to 1; may raise to stop the work."""


def silent(_what: str, _share: float) -> None:
    """No progress is wanted."""


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

KEPT = "What is finished is kept: run the same command again, with fewer workers if memory is short."
"""What an error says where a worker did not come back."""


@contextmanager
def executor_of(
    workers: int | None = None, cluster: str | None = None, *, reproducible: bool = False
) -> Iterator[Executor | None]:
    """Local processes (None: one per core; 1: no other process), or a Dask cluster.

    ``cluster``: ``local`` starts one here, anything else is the address of a scheduler. It needs the extra
    ``cluster``. ``reproducible``: the processes that start here compute the same bits on every x86 processor
    (:mod:`vsgdesign.execution.executors`), and even a single one is another process. Structures of the program's own
    script are not known to another process; there is then none. Raises WorkerError where the package for a cluster is
    missing, the scheduler cannot be reached, or another process is needed that cannot know these structures.
    """
    with environment(reproducible_environment() if reproducible else {}):
        if cluster is not None:
            with _dask(cluster, workers) as executor:
                yield executor
            return
        count = worker_count(workers)
        if own := known_here_alone():
            if reproducible:
                raise WorkerError(
                    f"structure {own[0]}: another process has to import it, and it is part of the script that runs. "
                    "Move it to a module of its own."
                )
            count = 1
        if count == 1 and not reproducible:
            yield None
            return
        with worker_processes(count) as pool:
            yield pool


def known_here_alone() -> list[str]:
    """Names of the structures that the program's own script defines. Another process does not run that script."""
    return [one.name for one in STRUCTURES.added if "__main__" in (one.gains.__module__, one.closed_form.__module__)]


def worker_count(workers: int | None) -> int:
    """How many processes work on this machine; None asks for one per core."""
    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: must be 1 or more, or None for one per core.")
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
            raise WorkerError(f'cluster = "{cluster}": a process was lost. {KEPT}') from error


@contextmanager
def worker_processes(count: int) -> Iterator[WorkerPool]:
    """A pool of ``count`` fresh processes. After an error or an interruption they end at once, without finishing.

    Fresh, because a forked copy of threads (a progress bar's, BLAS's) and their locks may hang.
    """
    pool = WorkerPool(count)
    try:
        yield pool
    except BaseException:
        pool.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


_ONE_KERNEL = {
    "OPENBLAS_CORETYPE": "Nehalem",
    "MKL_CBWR": "COMPATIBLE",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    # Functions of the C library have variants with and without fused multiply-add. The second names are older ones.
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable,-FMA4_Usable",
}


def reproducible_environment() -> dict[str, str]:
    """Variables with which a new process uses the same kernels of NumPy, BLAS and the C library on every x86 processor.

    They must be set before it starts: these libraries choose their kernels while they are loaded. Empty for another
    architecture.
    """
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return {}
    from numpy._core._multiarray_umath import __cpu_dispatch__  # type: ignore[attr-defined]

    return {"NPY_DISABLE_CPU_FEATURES": " ".join(__cpu_dispatch__)} | _ONE_KERNEL


@contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Processes that start within the block have these variables; the ones of before are put back."""
    left_out = ("NPY_ENABLE_CPU_FEATURES",) if "NPY_DISABLE_CPU_FEATURES" in values else ()  # NumPy refuses both
    before = {name: os.environ.get(name) for name in (*values, *left_out)}
    os.environ.update(values)
    for name in left_out:
        os.environ.pop(name, None)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def one_thread() -> AbstractContextManager[Any]:
    """BLAS on one thread: its matrices here are tiny, other work has the other cores, and how a sum is shared among
    threads would decide its last digit. Libraries that are not loaded yet are not reached."""
    return threadpool_limits(1)


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of mallopt in malloc.h of the GNU C library."""
_USUAL = 128 * 1024
"""Bytes, of both, that the library has without a word."""
_LARGE, _MOST = 32 * 2**20, 2**31 - 1
"""Arrays of so many bytes still get memory of their own: between smaller ones they would leave holes."""


def keep_memory() -> None:
    """From now on large arrays get the memory of those that have been dropped.

    Without it, the C library gives the memory of arrays of 0.1 to 32 MB back, and the system fills it with zeros before
    the next one has it. Objects that are there already are not searched for circles of references any more. Only the
    GNU C library is told; elsewhere the first part does nothing.
    """
    gc.freeze()
    if (library := _gnu()) is not None:
        library.mallopt(_MMAP_THRESHOLD, _LARGE)
        library.mallopt(_TRIM_THRESHOLD, _MOST)


def give_memory_back() -> None:
    """What :func:`keep_memory` has kept goes back, and all is as before."""
    gc.unfreeze()
    if (library := _gnu()) is not None:
        library.mallopt(_MMAP_THRESHOLD, _USUAL)
        library.mallopt(_TRIM_THRESHOLD, _USUAL)
        library.malloc_trim(0)


@functools.cache
def _gnu() -> ctypes.CDLL | None:
    """The GNU C library; None for another one."""
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return (
        library if all(hasattr(library, name) for name in ("mallopt", "malloc_trim", "gnu_get_libc_version")) else None
    )
