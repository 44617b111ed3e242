"""What a progress bar says of the time that is left."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from vsgdesign.verbs.cli import bars
from vsgdesign.verbs.cli.bars import Pace, left_in_words, progress_bars


def pace_of(*reports: tuple[float, float]) -> Pace:
    pace = Pace()
    for now_s, share in reports:
        pace.report(now_s, share)
    return pace


def test_what_is_left_takes_as_long_as_what_was_done() -> None:
    assert pace_of((100.0, 0.0), (102.0, 0.1), (104.0, 0.2)).seconds_left(104.0) == pytest.approx(16.0)
    uneven = pace_of((0.0, 0.0), (5.0, 0.1), (9.0, 0.15), (20.0, 0.5))
    assert uneven.seconds_left(20.0) == pytest.approx(20.0)
    assert uneven.seconds_left(23.0) == pytest.approx(17.0)  # it counts down between two reports
    assert uneven.seconds_left(60.0) == 0.0


def test_what_an_earlier_run_has_done_took_no_time() -> None:
    assert pace_of((0.0, 0.6), (10.0, 0.7), (20.0, 0.8)).seconds_left(20.0) == pytest.approx(20.0)


def test_nothing_is_said_before_two_pieces_are_done_and_at_the_end() -> None:
    assert Pace().seconds_left(1.0) is None
    assert pace_of((0.0, 0.0), (1.0, 0.1)).seconds_left(2.0) is None
    assert pace_of((0.0, 0.0), (1.0, 0.1), (2.0, 0.1)).seconds_left(2.0) is None  # no progress is no piece
    assert pace_of((0.0, 0.0), (1.0, 0.5), (2.0, 1.0)).seconds_left(2.0) is None


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (None, ""),
        (0.0, "about 1 s left"),
        (12.2, "about 13 s left"),
        (90.0, "about 90 s left"),
        (91.0, "about 2 min left"),
        (5400.0, "about 90 min left"),
        (5401.0, "about 1 h 31 min left"),
    ],
)
def test_words(seconds: float | None, said: str) -> None:
    assert left_in_words(seconds) == said


def test_the_bars_show_it(monkeypatch: pytest.MonkeyPatch) -> None:
    now, text = [0.0], io.StringIO()
    plain = bars.Progress

    def clocked(*columns: object, **options: object) -> object:
        return plain(*columns, **options, get_time=lambda: now[0], auto_refresh=False)  # type: ignore[arg-type]

    monkeypatch.setattr(bars, "Progress", clocked)
    terminal = Console(file=text, force_terminal=True, width=100, color_system=None)
    with progress_bars(terminal) as report:
        for k in range(4):
            now[0] = 30.0 * k
            report("runs", k / 20.0)
    shown = text.getvalue()
    assert "runs" in shown
    assert "15 %" in shown
    assert "about 9 min left" in shown  # 17 pieces of 30 s
