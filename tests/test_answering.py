"""A process that answers questions: answers, errors, and its end."""

from __future__ import annotations

from operator import attrgetter

from vsgdesign.execution.executors import AnsweringProcess


def test_it_answers_until_it_is_closed() -> None:
    process = AnsweringProcess(attrgetter, "imag", "real")
    try:
        assert process.ask(3.0 + 4.0j) == (4.0, 3.0)
        assert process.ask("no number") is None
        assert process.ask(1.0) == (0.0, 1.0)
        assert process.alive
    finally:
        process.close()
    assert not process.alive
    assert process.ask(1.0) is None
    process.close()
