"""What ends a program from outside: Ctrl-C, a polite kill, a terminal that closes. All three end it alike, and wait
where a place does not survive them.
"""

from __future__ import annotations

import atexit
import math
import os
import signal
import sys
import time
from contextlib import contextmanager

# Loaded before everything else, and nothing slow with it: until it is, Python answers Ctrl-C with a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator
    from threading import Timer
    from types import FrameType
    from typing import Any

STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_AGAIN_S = 1.0
"""A terminal that closes sends several signals at once: they are one."""
_ONCE_MORE_S = 0.02
"""After so long, a signal comes again whose exception was lost, or whose handler has not run."""


class Stop:
    """The signal that came, if one did, and when."""

    def __init__(self, number: int | None = None) -> None:
        self.number = number
        self.at = self.heard = -math.inf
        """When it came, and when the last one was handled."""

    @property
    def exit_code(self) -> int:
        """As a shell counts: 130, 143, 129. Without a signal it was asked for from inside, as Ctrl-C would."""
        return 128 + (signal.SIGINT if self.number is None else self.number)

    @property
    def word(self) -> str:
        """What happened, in a word."""
        words = {"SIGTERM": "terminated", "SIGHUP": "hung up"}
        return "interrupted" if self.number is None else words.get(signal.Signals(self.number).name, "interrupted")


class End:
    """What a signal that ends the process says, and its exit code."""

    def __init__(self) -> None:
        self.words = "nothing was written"
        self.exit_code: int | None = None

    def done(self) -> None:
        """From here on, the work is complete."""
        self.words = "the command was complete"

    def said(self, exit_code: int) -> None:
        """The last line is written: a signal only ends what is left, with this code."""
        self.exit_code = exit_code


@contextmanager
def signals_raise() -> Iterator[Stop]:
    """Within the block each of them raises KeyboardInterrupt: what cleans up after Ctrl-C does so after all.

    Where Python cannot pass on the exception, as within ``__del__``, it is raised again a moment later. Ignored ones
    stay ignored (nohup). Off the main thread, where Python delivers no signals, nothing is changed. A thread that waits
    for a lock is woken as well.
    """
    stop = Stop()

    def stopping(number: int, _frame: FrameType | None) -> None:
        stop.heard = now = time.monotonic()
        if stop.number is None or now - stop.at > _AGAIN_S:
            stop.number = stop.number or number
            stop.at = now
            raise KeyboardInterrupt

    def lost(unraisable: sys.UnraisableHookArgs) -> None:
        if stop.number is None or not issubclass(unraisable.exc_type, KeyboardInterrupt):
            before(unraisable)
            return
        stop.at = -math.inf
        again.append(_send_again(stop.number))

    before = sys.unraisablehook
    again: list[Timer] = []
    with _handled(stopping) as handled, _woken(stop, handled):
        sys.unraisablehook = lost
        try:
            yield stop
        finally:
            sys.unraisablehook = before
            for timer in again:  # what comes after the block would meet somebody else
                timer.cancel()
                timer.join()
        if again and stop.at == -math.inf:
            raise KeyboardInterrupt  # the block was over before it came again


@contextmanager
def _woken(stop: Stop, handled: Container[int]) -> Iterator[None]:
    """Within the block, a signal is sent again until it has been handled.

    Python handles a signal in the main thread, between two of its steps. Where it comes in the moment before that
    thread waits for a lock, or to another thread, the wait goes on, for ever if nothing else ends it: only a signal
    that meets a thread that already waits is seen there. A thread of its own therefore hears what is noted.
    """
    if sys.platform == "win32" or not handled:
        yield
        return
    import threading

    main, over = threading.get_ident(), threading.Event()
    read, write = os.pipe()
    os.set_blocking(write, False)

    def listen() -> None:
        while noted := os.read(read, 1):
            since, pause = time.monotonic() - _AGAIN_S, _ONCE_MORE_S
            while noted[0] in handled and stop.heard < since and not over.wait(pause):
                if stop.heard < since:  # still: it may have been handled within the pause
                    _send(noted[0], main)
                pause = min(2.0 * pause, _AGAIN_S)

    listener = threading.Thread(target=listen, name="signals", daemon=True)
    listener.start()
    before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        over.set()
        os.close(write)
        listener.join()
        os.close(read)


def _send(number: int, thread: int) -> None:
    if sys.platform != "win32":
        signal.pthread_kill(thread, number)
    else:
        signal.raise_signal(number)


def _send_again(number: int) -> Timer:
    """Sends a signal to the main thread, soon."""
    import threading

    timer = threading.Timer(_ONCE_MORE_S, _send, (number, threading.main_thread().ident or 0))
    timer.daemon = True
    timer.start()
    return timer


@contextmanager
def signals_end(end: End | None = None) -> Iterator[None]:
    """Within the block each of them ends the process at once, in one line: no work is under way that needs an end.

    For the time in which modules are loaded. An exception there would come out of whichever import it met.
    """
    with _handled(_ending(end or End())):
        yield


def signals_end_for_good(end: End) -> None:
    """As :func:`signals_end`, until the process is gone: Python's own end loses every exception, with a traceback.

    In the last moment, in which Python answers no signal and the work is done, they are ignored.
    """
    handled = _handle(_ending(end))

    def ignore() -> None:
        for number in handled:
            signal.signal(number, signal.SIG_IGN)

    atexit.register(ignore)  # what is registered first comes last


def _ending(end: End) -> Callable[[int, FrameType | None], None]:
    def ending(number: int, _frame: FrameType | None) -> None:
        stop = Stop(number)
        code = stop.exit_code if end.exit_code is None else end.exit_code
        try:
            if end.exit_code is None:
                os.write(2, f"{stop.word}: {end.words}\n".encode())
        finally:
            os._exit(code)

    return ending


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[dict[int, Any]]:
    before = _handle(handler)
    try:
        yield before
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def _handle(handler: Callable[[int, FrameType | None], None]) -> dict[int, Any]:
    """Handles them all, and returns the handlers before."""
    before = {}
    for number in STOPPING:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            try:
                before[number] = signal.signal(number, handler)
            except ValueError:  # not the main thread
                break
    return before


@contextmanager
def interrupts_deferred() -> Iterator[Callable[[], None]]:
    """Within this block SIGINT, SIGTERM and SIGHUP wait; at its end the first is delivered to whoever handles it. The
    function that the block gets delivers it at once, for a long block with places that survive it.

    An interrupt raised while compiled code is being made, loaded, called or left unwinds C code that does not
    expect it: the process can die of a segmentation fault instead of a KeyboardInterrupt. Off the main thread,
    where Python delivers no signals, nothing is changed; nor is a signal that ends the process or is ignored.
    """
    import threading

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
