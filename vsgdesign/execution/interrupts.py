"""Keeps Ctrl-C and its like out of places that do not survive it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from vsgdesign.execution.signals import STOPPING


def interrupts_come() -> bool:
    """Whether :func:`interrupts_deferred` has anything to do here."""
    here = threading.current_thread() is threading.main_thread()
    return here and any(callable(signal.getsignal(number)) for number in STOPPING)


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Within this block SIGINT, SIGTERM and SIGHUP wait; at its end the first is delivered to whoever handles it.

    An interrupt raised while compiled code is being made, loaded, called or left unwinds C code that does not
    expect it: the process can die of a segmentation fault instead of a KeyboardInterrupt. Off the main thread,
    where Python delivers no signals, nothing is changed; nor is a signal that ends the process or is ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers: dict[int, Any] = {number: signal.getsignal(number) for number in STOPPING}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    if not handlers:
        yield
        return
    waiting: list[tuple[int, FrameType | None]] = []

    def wait(number: int, frame: FrameType | None) -> Any:
        waiting.append((number, frame))

    for number in handlers:
        signal.signal(number, wait)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if waiting:
        handlers[waiting[0][0]](*waiting[0])
