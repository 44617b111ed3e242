"""Ctrl-C waits for compiled code to be left, and is not lost."""

from __future__ import annotations

import signal
import sys
import threading
import time

import pytest

from vsgdesign.execution.signals import _ONCE_MORE_S, STOPPING, Stop, interrupts_deferred, signals_raise


@pytest.mark.parametrize("number", STOPPING)
def test_an_interrupt_waits_for_the_end_of_the_block(number: signal.Signals) -> None:
    reached = []

    def block() -> None:
        with signals_raise(), interrupts_deferred():
            signal.raise_signal(number)
            reached.append("end")

    with pytest.raises(KeyboardInterrupt):
        block()
    assert reached == ["end"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_what_stopped_it_is_known_and_comes_once() -> None:
    """A terminal that closes sends SIGHUP, and its shell SIGTERM: the second does not break into the tidying up."""
    tidied = []

    def block() -> None:
        with signals_raise() as stop:
            stops.append(stop)
            try:
                signal.raise_signal(signal.SIGHUP)
            finally:
                signal.raise_signal(signal.SIGTERM)
                tidied.append("all")

    stops: list[Stop] = []
    with pytest.raises(KeyboardInterrupt):
        block()
    assert tidied == ["all"]
    assert (stops[0].number, stops[0].exit_code, stops[0].word) == (signal.SIGHUP, 129, "hung up")


class _Noisy:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def test_a_signal_where_python_loses_the_exception(capfd: pytest.CaptureFixture[str]) -> None:
    """It was a traceback on standard error, and the work went on."""

    def block() -> None:
        with signals_raise() as stop:
            stops.append(stop)
            del noisy[0]
            reached.append("after it")
            threading.Event().wait(10.0)
            reached.append("end")

    noisy, reached, stops = [_Noisy()], [], []
    hook = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt):
        block()
    assert reached == ["after it"]
    assert (stops[0].number, sys.unraisablehook) == (signal.SIGINT, hook)
    assert capfd.readouterr().err == ""


def test_a_lost_signal_does_not_come_after_the_block() -> None:
    """It was sent again to whoever ran by then."""
    after: list[int] = []

    def block() -> None:
        with signals_raise():
            del noisy[0]

    noisy, before = [_Noisy()], signal.signal(signal.SIGINT, lambda number, _frame: after.append(number))
    try:
        with pytest.raises(KeyboardInterrupt):
            block()
        time.sleep(3.0 * _ONCE_MORE_S)
    finally:
        signal.signal(signal.SIGINT, before)
    assert after == []


@pytest.mark.skipif(sys.platform == "win32", reason="a thread that waits there hears no signal")
def test_a_signal_that_does_not_meet_the_thread_that_waits() -> None:
    """One that came in the moment before the wait, or to another thread, was noted, and the wait went on for ever."""
    began = time.monotonic()

    def block() -> None:
        with signals_raise() as stop:
            stops.append(stop)
            other.start()
            threading.Event().wait(60.0)

    other = threading.Timer(0.2, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGINT))
    threads, stops = threading.active_count(), list[Stop]()
    with pytest.raises(KeyboardInterrupt):
        block()
    assert time.monotonic() - began < 50.0
    assert (stops[0].number, signal.set_wakeup_fd(-1)) == (signal.SIGINT, -1)
    other.join()
    assert threading.active_count() == threads


def test_an_exception_that_is_lost_without_a_signal_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    class Faulty:
        def __del__(self) -> None:
            raise ValueError("lost")

    shown = []
    monkeypatch.setattr(sys, "unraisablehook", lambda found: shown.append(str(found.exc_value)))
    with signals_raise():
        del [Faulty()][0]
    assert shown == ["lost"]


def test_nohup_stays() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with signals_raise() as stop:
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert stop.number is None


def test_without_an_interrupt_nothing_happens_and_the_handler_is_back() -> None:
    before = signal.getsignal(signal.SIGINT)
    with interrupts_deferred():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


def test_an_error_inside_goes_out_and_the_handler_is_back() -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(RuntimeError, match="inside"), interrupts_deferred():
        raise RuntimeError("inside")
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_and_an_ignored_signal_are_left_alone() -> None:
    seen = []

    def work() -> None:
        before = signal.getsignal(signal.SIGINT)
        with interrupts_deferred():
            seen.append(signal.getsignal(signal.SIGINT) is before)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts_deferred():
            seen.append(signal.getsignal(signal.SIGINT) == signal.SIG_IGN)
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == [True, True]
