"""Critical clearing time: how long a fault may last."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vsgdesign.simulation.survival.cases import SurvivalCase
from vsgdesign.simulation.survival.running import Subject, run_case

LENGTHS_S = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Lengths at which a fault is tried first: a fault may be lost and a longer one survived, which bisection misses."""


@dataclass(frozen=True)
class ClearingTime:
    """The result of a search. None: the case is left out, and has no verdict at any length."""

    longest_s: float | None
    """Longest fault that was survived with every shorter one that was tried, s; 0 where none was."""
    bounded: bool
    """Whether a longer fault was lost. Otherwise every length that was tried was survived."""


def critical_clearing_time(
    subject: Subject, case_of: Callable[[float], SurvivalCase], *, resolution_s: float = 0.005
) -> ClearingTime:
    """The critical clearing time of a fault, whose case of a length in s is ``case_of(length)``.

    The lengths of LENGTHS_S are tried from the shortest on. Bisection between the last that was survived and the first
    that was lost follows, down to ``resolution_s``.
    """
    good = 0.0
    for length in LENGTHS_S:
        verdict = run_case(subject, case_of(length)).verdict
        if not verdict.judged:
            return ClearingTime(None, False)
        if not verdict.survived:
            bad = length
            break
        good = length
    else:
        return ClearingTime(good, False)
    while bad - good > resolution_s:
        middle = 0.5 * (good + bad)
        if run_case(subject, case_of(middle)).verdict.survived:
            good = middle
        else:
            bad = middle
    return ClearingTime(good, True)
