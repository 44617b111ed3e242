"""How long the answers of an estimator are silent, and how often they announce a change that was none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsgdesign.metrics.answers import Answers, share_valid

FALSE_AFTER_S = 1.0
"""A change that is announced later than this after the last change of the grid's impedance, s, is a false one."""

_SLACK_S = 1e-9
"""Instants are equal up to this, s: they are sums of many sampling periods."""


def silence(answers: Answers, begin_s: float, until_s: float) -> float:
    """Time between two instants in which no valid answer acts, s."""
    return (until_s - begin_s) * (1.0 - share_valid(answers, begin_s, until_s))


def longest_silence(answers: Answers, begin_s: float, until_s: float) -> float:
    """Longest time without a break in which no valid answer acts, s; it counts from ``begin_s`` on."""
    longest, quiet = 0.0, begin_s
    ends = np.append(answers.t_s[1:], answers.end_s)
    for begin, end, valid in zip(answers.t_s, ends, answers.valid, strict=False):  # without an answer there is one end
        if valid and end > begin_s + _SLACK_S and begin < until_s:
            longest = max(longest, float(begin) - quiet)
            quiet = float(end)
    return max(longest, until_s - quiet, 0.0)


def false_changes(
    answers: Answers, begin_s: float, until_s: float, changes_s: Sequence[float], after_s: float = FALSE_AFTER_S
) -> int:
    """How many announcements of a change between two instants have no change of the grid's impedance behind them.

    ``changes_s``: the instants at which the impedance changed. An announcement up to ``after_s`` later is a true one.
    """
    announced = answers.t_s[answers.rows(begin_s, until_s) & answers.changed]
    return sum(not any(change < t + _SLACK_S and t - change <= after_s for change in changes_s) for t in announced)
