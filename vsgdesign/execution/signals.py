"""What ends a program from outside: Ctrl-C, a polite kill, a terminal that closes. All three end it alike."""

from __future__ import annotations

import os
import signal
import time
from contextlib import contextmanager

# Loaded before everything else, and nothing slow with it: until it is, Python answers Ctrl-C with a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_AGAIN_S = 1.0
"""A terminal that closes sends several signals at once: they are one."""


class Stop:
    """The signal that came, if one did, and when."""

    def __init__(self, number: int | None = None) -> None:
        self.number = number
        self.at = 0.0

    @property
    def exit_code(self) -> int:
        """As a shell counts: 130, 143, 129. Without a signal it was asked for from inside, as Ctrl-C would."""
        return 128 + (signal.SIGINT if self.number is None else self.number)

    @property
    def word(self) -> str:
        """What happened, in a word."""
        words = {"SIGTERM": "terminated", "SIGHUP": "hung up"}
        return "interrupted" if self.number is None else words.get(signal.Signals(self.number).name, "interrupted")


@contextmanager
def signals_raise() -> Iterator[Stop]:
    """Within the block each of them raises KeyboardInterrupt: what cleans up after Ctrl-C does so after all.

    Ignored ones stay ignored (nohup). Off the main thread, where Python delivers no signals, nothing is changed.
    """
    stop = Stop()

    def stopping(number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if stop.number is None or now - stop.at > _AGAIN_S:
            stop.number = stop.number or number
            stop.at = now
            raise KeyboardInterrupt

    with _handled(stopping):
        yield stop


@contextmanager
def signals_end() -> Iterator[None]:
    """Within the block each of them ends the process at once, in one line: nothing has begun that needs an end.

    For the time in which modules are loaded. An exception there would come out of whichever import it met.
    """

    def end(number: int, _frame: FrameType | None) -> None:
        stop = Stop(number)
        try:
            os.write(2, f"{stop.word}: nothing was written\n".encode())
        finally:
            os._exit(stop.exit_code)

    with _handled(end):
        yield


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    before = {}
    for number in STOPPING:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            try:
                before[number] = signal.signal(number, handler)
            except ValueError:  # not the main thread
                break
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
