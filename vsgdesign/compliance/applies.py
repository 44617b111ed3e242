"""Whether a test applies to a converter and its controller: what a test may need, by name, and why it is not there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from vsgdesign.compliance.case import Subject
from vsgdesign.compliance.suite import SuiteTest


def _of_frequency(f_hz: float) -> Callable[[Subject], str | None]:
    def missing(subject: Subject) -> str | None:
        nominal = subject.study.converter.omega_n / (2.0 * math.pi)
        if abs(nominal - f_hz) < 0.5:
            return None
        return f"the test is for a grid of {f_hz:g} Hz, and the converter is made for {nominal:.4g} Hz"

    return missing


def _limit(subject: Subject) -> str | None:
    return "the controller has no current limit" if math.isinf(subject.limit_pu) else None


def _schedule(subject: Subject) -> str | None:
    return (
        "the controller has fixed gains, and no schedule that could be late" if subject.spec.kind == "fixed" else None
    )


def _storage(_subject: Subject) -> str | None:
    """The dc link is ideal: it gives and takes what the test asks, and the energy is a measure of the row."""
    return None


NEEDS: Mapping[str, Callable[[Subject], str | None]] = MappingProxyType(
    {
        "50 Hz": _of_frequency(50.0),
        "60 Hz": _of_frequency(60.0),
        "current limit": _limit,
        "schedule": _schedule,
        "storage": _storage,
    }
)
"""What a test may need. Each function says why the need is not met, or None."""


def not_applicable(subject: Subject, test: SuiteTest) -> str | None:
    """Why a test does not apply to a controller; None if it does.

    Raises ValueError for a need that is not in NEEDS.
    """
    unknown = [name for name in test.needs if name not in NEEDS]
    if unknown:
        raise ValueError(f"needs = {', '.join(unknown)}: there are {', '.join(NEEDS)}.")
    missing = [why for name in test.needs if (why := NEEDS[name](subject)) is not None]
    return "; ".join(missing) or None
