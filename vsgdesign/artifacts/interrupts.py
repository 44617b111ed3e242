"""Keeps Ctrl-C out of places that do not survive it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Within this block SIGINT waits; at its end it is delivered to whoever handles it.

    An interrupt raised while compiled code is being made, loaded, called or left unwinds C code that does not
    expect it: the process can die of a segmentation fault instead of a KeyboardInterrupt. Off the main thread,
    where Python delivers no signals, nothing is changed.
    """
    previous = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous):
        yield
        return
    waiting: list[tuple[int, FrameType | None]] = []

    def wait(number: int, frame: FrameType | None) -> Any:
        waiting.append((number, frame))

    signal.signal(signal.SIGINT, wait)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
    if waiting:
        previous(*waiting[0])
