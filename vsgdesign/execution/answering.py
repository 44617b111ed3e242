"""Another process that answers questions, one at a time, and that ends with the one that asks."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Any

_PROGRAM = "import sys; sys.path[:] = {!r}; from vsgdesign.execution.answering import answer_all; answer_all()"


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
