"""Fresh processes that work for this one. They import what they are sent, and never the script that runs here."""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from typing import IO, Any, NamedTuple

_PROGRAM = "import sys; sys.path[:] = {!r}; from vsgdesign.execution.workers import answer_all; answer_all()"
_LENGTH = 8
"""Bytes before each message that say how many follow."""
_ENDED_S = 5.0
"""How long a process whose pipe has ended may take to be gone."""


class WorkerLostError(BrokenExecutor):
    """A process ended before it had answered. The message says how it ended."""


class Outcome(NamedTuple):
    """What came of a question: the answer, or the error that was raised there."""

    answer: Any
    error: BaseException | None


class AnsweringProcess:
    """A fresh process with a function that it makes itself: ``make(*arguments)``, called there once.

    ``make``, its arguments, questions and answers travel by pickle between these two processes. Threads may ask at the
    same time; they are answered one after the other. No module of the program that asks is run there but those of
    ``make``, and neither Ctrl-C nor a terminal that closes reaches it. It ends as soon as this process has.
    """

    def __init__(self, make: Callable[..., Callable[[Any], Any]], *arguments: Any) -> None:
        self._lock = threading.Lock()
        self._said: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed by close()
        group: dict[str, Any] = (
            {"process_group": 0}
            if os.name == "posix"
            else {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}
        )
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM.format(sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            **group,
        )
        self._send(pickle.dumps((make, arguments)))

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def ask(self, question: Any) -> Any | None:
        """Its answer. None where it has none: its function raised an error there, or the process is gone.

        The first answer waits until the function is made.
        """
        return ask_all([(self, question)])[0]

    def outcome(self, message: bytes) -> Outcome:
        """Its answer to a pickled question, or its error. Raises WorkerLostError where the process ended before."""
        with self._lock:
            found = self._received() if self._send(message) else None
        if found is None:
            raise WorkerLostError(self._end())
        return found

    def close(self) -> None:
        """Ends the process at once. What it has written on its standard error comes out here."""
        self._process.kill()
        with suppress(OSError):  # a question that was never read
            self._process.__exit__(None, None, None)
        text = self._text()
        self._said.close()
        if text and sys.stderr is not None:
            sys.stderr.write(text)

    def _send(self, message: bytes) -> bool:
        pipe = self._process.stdin
        with suppress(OSError, ValueError):
            if pipe is not None:
                _write(pipe, message)
                return True
        return False

    def _received(self) -> Outcome | None:
        pipe = self._process.stdout
        with suppress(OSError, ValueError):
            message = None if pipe is None else _read(pipe)
            return None if message is None else pickle.loads(message)  # noqa: S301 - of the process started here
        return None

    def _text(self) -> str:
        with suppress(OSError, ValueError):
            self._said.seek(0)
            return self._said.read().decode("utf-8", "replace")
        return ""

    def _end(self) -> str:
        """How it ended, in words."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_ENDED_S)
        code, lines = self._process.returncode, self._text().strip().splitlines()
        with suppress(OSError, ValueError):  # it is in the message
            self._said.truncate(0)
        if code is None:
            return "a process does not answer any more"
        if code < 0:
            name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
            return f"a process was ended by {name}" + (
                ", which mostly means: out of memory" if name == "SIGKILL" else ""
            )
        return f"a process ended with exit code {code}" + (f" ({lines[-1].strip()})" if lines else "")


def ask_all(questions: Sequence[tuple[AnsweringProcess, Any]]) -> list[Any | None]:
    """The answers of several processes that work at the same time, as :meth:`AnsweringProcess.ask`."""
    with ExitStack() as held:
        for process, _ in questions:
            held.enter_context(process._lock)
        sent = [process._send(pickle.dumps(question)) for process, question in questions]
        found = [
            process._received() if reached else None for (process, _), reached in zip(questions, sent, strict=True)
        ]
    return [None if one is None else one.answer for one in found]


class WorkerPool(Executor):
    """At most ``count`` processes that make calls. A call, its arguments, its result and its error travel by pickle.

    A process is started for a call that finds none free: to start one takes as long as many a call.
    """

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count, "worker")
        self._free: list[AnsweringProcess] = []
        self._processes: list[AnsweringProcess] = []
        self._lock = threading.Lock()
        self._closed = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As every executor. The result raises WorkerLostError where the process ended, and what pickle raises."""
        try:  # at once: what the call holds may change in this thread while another one would pickle it
            message = pickle.dumps(partial(fn, *args, **kwargs))
        except Exception as error:  # noqa: BLE001 - of whatever is in the call
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed
        return self._threads.submit(self._called, message)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes when what is begun is finished."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            self.kill()

    def kill(self) -> None:
        """Ends the processes at once."""
        with self._lock:
            self._closed = True
            ended, self._processes = self._processes, []
        for process in ended:
            process.close()

    def _process(self) -> AnsweringProcess:
        """One that is free, or a new one: there are never more of them than threads."""
        with self._lock:
            if self._closed:
                raise WorkerLostError("the processes were ended")
            if not self._free:
                self._processes.append(AnsweringProcess(_calling))
                return self._processes[-1]
            return self._free.pop(0)

    def _called(self, message: bytes) -> Any:
        process = self._process()
        try:
            answer, error = process.outcome(message)
        finally:
            with self._lock:
                self._free.append(process)
        if error is not None:
            raise error
        return answer


def _calling() -> Callable[[Callable[[], Any]], Any]:
    return _call


def _call(call: Callable[[], Any]) -> Any:
    return call()


def answer_all() -> None:
    """What the other process does: makes the function, and answers until the questions end."""
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # what anything prints must not get between the answers
    arrived: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read_all, args=(questions, arrived.put), daemon=True).start()
    make, arguments = pickle.loads(arrived.get())  # noqa: S301 - of the process that has started this one
    answer = make(*arguments)
    while True:
        _write(answers, _message(answer, arrived.get()))


def _message(answer: Callable[[Any], Any], question: bytes) -> bytes:
    """The outcome of a question, as it travels."""
    try:
        return pickle.dumps(Outcome(answer(pickle.loads(question)), None))  # noqa: S301
    except Exception as error:  # noqa: BLE001 - whoever asks raises it again
        error.add_note(f"In another process:\n{traceback.format_exc()}")
        with suppress(Exception):
            message = pickle.dumps(Outcome(None, error))
            pickle.loads(message)  # noqa: S301 - one that cannot be built anew would be lost there
            return message
        return pickle.dumps(Outcome(None, RuntimeError(f"{type(error).__name__}: {error}")))


def _read_all(pipe: IO[bytes], take: Callable[[bytes], None]) -> None:
    """Takes the messages of a pipe, and ends this process with it: the other one has closed it, or is gone."""
    while (message := _read(pipe)) is not None:
        take(message)
    os._exit(0)


def _write(pipe: IO[bytes], message: bytes) -> None:
    pipe.write(len(message).to_bytes(_LENGTH, "little"))
    pipe.write(message)
    pipe.flush()


def _read(pipe: IO[bytes]) -> bytes | None:
    """The next message; None where the pipe has ended."""
    head = pipe.read(_LENGTH)
    length = int.from_bytes(head, "little") if len(head) == _LENGTH else -1
    message = pipe.read(length) if length >= 0 else b""
    return message if len(message) == length else None
