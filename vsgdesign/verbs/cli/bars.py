"""Progress bars for a terminal, with the time that is left as far as it is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

_NEEDED = 2
"""Pieces of work that must be done before the time of the others is estimated."""


class Pace:
    """How fast one stage goes: what it reported, and when.

    The first report says what was done before (an interrupted work continues), so it is no piece of work.
    """

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None
        self._last = (0.0, 0.0)
        self._pieces = 0

    def report(self, now_s: float, share: float) -> None:
        """Takes a report: a share done, 0 to 1, at a time of any clock, s."""
        if self._first is None:
            self._first = self._last = now_s, share
        elif share > self._last[1]:
            self._last = now_s, share
            self._pieces += 1

    def seconds_left(self, now_s: float) -> float | None:
        """Time until the stage is done, if what is left goes as fast as what was done, s; None while fewer than two
        pieces are done, and at the end."""
        if self._first is None or self._pieces < _NEEDED or self._last[1] >= 1.0:
            return None
        (begun_s, before), (last_s, done) = self._first, self._last
        left = (1.0 - done) * (last_s - begun_s) / (done - before)
        return max(left - (now_s - last_s), 0.0)


def left_in_words(seconds: float | None) -> str:
    """A time that is left, rounded up; empty where it is not known."""
    if seconds is None:
        return ""
    if seconds <= 90.0:
        return f"about {max(math.ceil(seconds), 1)} s left"
    minutes = math.ceil(seconds / 60.0)
    return f"about {minutes} min left" if minutes <= 90 else f"about {minutes // 60} h {minutes % 60} min left"


class _TimeLeft(ProgressColumn):
    """The time that is left of a bar."""

    def __init__(self, paces: dict[Any, Pace]) -> None:
        super().__init__()
        self._paces = paces

    def render(self, task: Task) -> Text:
        pace = self._paces.get(task.id)
        return Text(left_in_words(None if pace is None else pace.seconds_left(task.get_time())))


@contextmanager
def progress_bars(console: Console | None = None) -> Iterator[Callable[[str, float], None]]:
    """One bar for each stage that reports, on standard error or on a ``console``."""
    paces: dict[Any, Pace] = {}
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        _TimeLeft(paces),
    )
    with Progress(*columns, console=console or Console(stderr=True), transient=True) as progress:
        tasks: dict[str, Any] = {}

        def report(what: str, share: float) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=1.0)
                paces[tasks[what]] = Pace()
            paces[tasks[what]].report(progress.get_time(), share)
            progress.update(tasks[what], completed=share)

        yield report
