"""Rows of the clause matrix: what was measured, what was asked, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass

PASS, FAIL, INFORMATIONAL, NOT_APPLICABLE, IMPOSSIBLE = "pass", "fail", "informational", "not applicable", "impossible"
VERDICTS = (PASS, FAIL, INFORMATIONAL, NOT_APPLICABLE, IMPOSSIBLE)
"""``impossible``: no converter with this current limit can do it; ``why`` gives the arithmetic."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One measured value of a row."""

    measure: str
    label: str
    value: float | None
    """None: the value is not known; ``why`` says why."""
    unit: str
    plus_minus: float = 0.0
    """How far the measuring may be from the value, in its unit."""
    at_least: float | None = None
    at_most: float | None = None
    envelope: str | None = None
    ours: bool = False
    """Whether the limits are this project's and not the source's."""
    verdict: str = INFORMATIONAL
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One test of one controller."""

    suite: str
    test: str
    """The test's id."""
    group: str
    title: str
    controller: str
    network: str
    """In words: ``SCR 3, X/R 10, P 0.5 pu``."""
    verdict: str
    why: str = ""
    checks: tuple[Check, ...] = ()
    status: str = ""
    """The survival judge's answer (``metrics.survival.STATUSES``)."""
    source: dict[str, str]
    """document, edition, confidence, note."""
    csv: str | None = None
    """Evidence files, relative to the folder of the result."""
    figure: str | None = None
    study: str | None = None
    """Study file with which ``vsgdesign simulate`` repeats the run."""
    explore: str | None = None
    """State of the explorer at this test's grid, as the part of a link after #."""
