"""Where work runs: in this process, in others on this machine, or on a Dask cluster; on request with the same bits."""

from __future__ import annotations

import importlib
import logging
import multiprocessing
import os
import pickle
import platform
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, TypedDict

from vsgdesign.errors import WorkerError

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
    (:mod:`vsgdesign.execution.executors`), and even a single one is another process. Raises WorkerError where the
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


_PROGRAM = "import sys; sys.path[:] = {!r}; from vsgdesign.execution.executors import answer_all; answer_all()"


class AnsweringProcess:
    """A fresh process with a function that it makes itself: ``make(*arguments)``, called there once.

    ``make``, its arguments, questions and answers travel by pickle between these two processes. Threads may ask at the
    same time; they are answered one after the other. No module of the program that asks is run there but those of
    ``make``, and neither Ctrl-C nor a terminal that closes reaches it.
    """

    def __init__(self, make: Callable[..., Callable[[Any], Any]], *arguments: Any) -> None:
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM.format(sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            process_group=0 if os.name == "posix" else None,
        )
        self._send((make, arguments))

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def ask(self, question: Any) -> Any | None:
        """Its answer. None where it has none: its function raised an error there, or the process is gone.

        The first answer waits until the function is made.
        """
        return ask_all([(self, question)])[0]

    def close(self) -> None:
        """Ends the process at once."""
        self._process.kill()
        with suppress(OSError):  # a question that was never read
            self._process.__exit__(None, None, None)

    def _send(self, what: Any) -> bool:
        pipe = self._process.stdin
        with suppress(OSError, ValueError):
            if pipe is not None:
                pickle.dump(what, pipe)
                pipe.flush()
                return True
        return False

    def _received(self) -> Any | None:
        pipe = self._process.stdout
        with suppress(OSError, ValueError, EOFError, pickle.UnpicklingError):
            return None if pipe is None else pickle.load(pipe)  # noqa: S301 - of the process that this one has started
        return None


def ask_all(questions: Sequence[tuple[AnsweringProcess, Any]]) -> list[Any | None]:
    """The answers of several processes that work at the same time, as :meth:`AnsweringProcess.ask`."""
    with ExitStack() as held:
        for process, _ in questions:
            held.enter_context(process._lock)
        sent = [process._send(question) for process, question in questions]
        return [process._received() if reached else None for (process, _), reached in zip(questions, sent, strict=True)]


def answer_all() -> None:
    """What the other process does: makes the function, and answers until the questions end."""
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # what anything prints must not get between the answers
    with suppress(EOFError, OSError):
        make, arguments = pickle.load(questions)  # noqa: S301 - of the process that has started this one
        answer = make(*arguments)
        while True:
            question = pickle.load(questions)  # noqa: S301
            try:
                found = answer(question)
            except Exception:  # noqa: BLE001 - whoever asks finds out why by computing it there
                found = None
            pickle.dump(found, answers)
            answers.flush()
