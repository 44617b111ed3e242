"""Keeps Ctrl-C and its like out of places that do not survive it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from vsgdesign.execution.signals import STOPPING


@contextmanager
def interrupts_deferred() -> Iterator[Callable[[], None]]:
    """Within this block SIGINT, SIGTERM and SIGHUP wait; at its end the first is delivered to whoever handles it. The
    function that the block gets delivers it at once, for a long block with places that survive it.

    An interrupt raised while compiled code is being made, loaded, called or left unwinds C code that does not
    expect it: the process can die of a segmentation fault instead of a KeyboardInterrupt. Off the main thread,
    where Python delivers no signals, nothing is changed; nor is a signal that ends the process or is ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield _nothing
        return
    handlers: dict[int, Any] = {number: signal.getsignal(number) for number in STOPPING}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    if not handlers:
        yield _nothing
        return
    waiting: list[tuple[int, FrameType | None]] = []

    def wait(number: int, frame: FrameType | None) -> Any:
        waiting.append((number, frame))

    def deliver() -> None:
        if waiting:
            (number, frame), waiting[:] = waiting[0], []
            handlers[number](number, frame)

    for number in handlers:
        signal.signal(number, wait)
    try:
        yield deliver
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    deliver()


def _nothing() -> None:
    pass
