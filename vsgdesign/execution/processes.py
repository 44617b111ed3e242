"""Other processes to work in: they end with the one that waits for them, and leave Ctrl-C to it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection


@contextmanager
def worker_processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``count`` fresh processes. After an error or an interruption they end at once, without finishing.

    Fresh, because a forked copy of threads (a progress bar's, BLAS's) and their locks may hang.
    """
    context = multiprocessing.get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    pool: ProcessPoolExecutor | None = None
    try:
        with _signals_blocked():
            pool = ProcessPoolExecutor(count, context, _begin_worker, (theirs,))
            for _ in range(count):
                pool.submit(os.getpid)
        yield pool
    except BaseException:
        ours.close()
        raise
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)
        ours.close()
        theirs.close()


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Processes that start here inherit that SIGINT and SIGHUP, which go to whole groups, do not reach them.

    One that is starting would show its traceback, and the one that keeps account of shared memory would die of SIGHUP.
    SIGTERM reaches them: the pool ends its processes with it.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(lifeline: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    """Nothing is ever sent: the pipe ends when the other end is closed, also by the kernel after a kill."""
    try:
        lifeline.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)
