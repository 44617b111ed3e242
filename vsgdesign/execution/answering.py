"""Another process that answers questions, one at a time, and that ends with the one that asks."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection
from typing import Any

from vsgdesign.execution.processes import signals_blocked


class AnsweringProcess:
    """A fresh process with a function that it makes itself: ``make(*arguments)``, called there once.

    ``make``, its arguments, questions and answers travel by pickle between these two processes. Threads may ask at the
    same time; they are answered one after the other.
    """

    def __init__(self, make: Callable[..., Callable[[Any], Any]], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._lock = threading.Lock()
        self._process = context.Process(target=_answer, args=(theirs, make, arguments), daemon=True)
        with signals_blocked():
            self._process.start()
        theirs.close()

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.is_alive()

    def ask(self, question: Any) -> Any | None:
        """Its answer. None where it has none: its function raised an error there, or the process is gone.

        The first answer waits until the function is made.
        """
        return ask_all([(self, question)])[0]

    def close(self) -> None:
        """Ends the process at once."""
        self._process.terminate()
        self._process.join()
        self._ours.close()


def ask_all(questions: Sequence[tuple[AnsweringProcess, Any]]) -> list[Any | None]:
    """The answers of several processes that work at the same time, as :meth:`AnsweringProcess.ask`."""
    with ExitStack() as held:
        sent = []
        for process, question in questions:
            held.enter_context(process._lock)
            with suppress(OSError):
                process._ours.send(question)
                sent.append(process)
        return [_received(process._ours) if process in sent else None for process, _ in questions]


def _received(answers: Connection) -> Any | None:
    try:
        return answers.recv()
    except (EOFError, OSError):
        return None


def _answer(questions: Connection, make: Callable[..., Callable[[Any], Any]], arguments: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the end of the pipe ends this one
    answer = make(*arguments)
    while True:
        try:
            question = questions.recv()
        except (EOFError, OSError):
            return
        try:
            found = answer(question)
        except Exception:  # noqa: BLE001 - whoever asks finds out why by computing it there
            found = None
        try:
            questions.send(found)
        except OSError:
            return
