"""Errors cross the border between processes as they were raised, and counts are told as they are."""

from __future__ import annotations

from multiprocessing import Pipe

import pytest

from vsgdesign import errors
from vsgdesign.errors import (
    Fault,
    LimitHitError,
    NoOperatingPointError,
    StudyError,
    UnknownNameError,
    VsgDesignError,
    share_percent,
)


def _kinds(kind: type[VsgDesignError]) -> list[type[VsgDesignError]]:
    return [one for sub in kind.__subclasses__() for one in (sub, *_kinds(sub))]


RAISED = {
    StudyError: lambda: StudyError("study.toml", [Fault("grid.scr", "-1", "must be positive", "Give 1 or more.")]),
    UnknownNameError: lambda: UnknownNameError("kind", "odd", ("fixed", "scheduled")),
    NoOperatingPointError: lambda: NoOperatingPointError("the grid cannot carry 2 pu", shortfall_w=12.0),
    LimitHitError: lambda: LimitHitError("the limiter already acts", limit="projection"),
}


@pytest.mark.parametrize("kind", [one for one in _kinds(VsgDesignError) if one.__module__ == errors.__name__])
def test_an_error_of_a_worker_arrives_as_it_was_raised(kind: type[VsgDesignError]) -> None:
    """An exception that cannot be rebuilt ends the pool of workers, and the user only sees "a process was lost"."""
    raised = RAISED[kind]() if kind in RAISED else kind("in words")
    receiver, sender = Pipe(duplex=False)
    with receiver, sender:
        sender.send(raised)
        arrived = receiver.recv()
    assert type(arrived) is kind
    assert str(arrived) == str(raised)
    assert vars(arrived) == vars(raised)


@pytest.mark.parametrize(
    ("share", "said"),
    [
        (2091 / 2092, "99.95 %"),
        (49_743 / 49_984, "99.5 %"),
        (0.99996, "99.996 %"),
        (1.0, "100 %"),
        (0.0, "0 %"),
        (1 / 50_002, "0.002 %"),
        (0.5, "50 %"),
    ],
)
def test_a_share_that_is_not_all_does_not_read_so(share: float, said: str) -> None:
    """`survive` printed "2091/2092 (100.0 %)"."""
    assert share_percent(share) == said
