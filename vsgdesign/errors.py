"""One class per kind of failure. Every message says which field, which value, which limit, what to do."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any


def counted(count: int, noun: str) -> str:
    """A number with its noun: 1 fault, 2 faults."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def share_percent(share: float, digits: int = 3) -> str:
    """A share in per cent with so many digits, or with as many more as keep a share that is not all from reading 100 %.

    2,091 of 2,092 are 99.95 %.
    """
    if not 0.0 < share < 1.0:
        return f"{100.0 * share:.0f} %"
    texts = (f"{100.0 * share:.{more}g}" for more in range(digits, 16))
    return f"{next((text for text in texts if float(text) < 100.0), '100')} %"


_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def visible(text: str) -> str:
    """A text without what a terminal obeys: names and titles may come from a stranger."""
    return _UNSEEN.sub("\ufffd", text)


class VsgDesignError(Exception):
    """Base of every error that vsgdesign raises on purpose."""

    def __reduce__(self) -> tuple[Any, ...]:
        """An error of a worker process arrives as it was raised: an exception is otherwise built anew from its message
        alone, which the constructors here do not take."""
        return _as_raised, (type(self), self.args), self.__dict__


def _as_raised(kind: type[VsgDesignError], args: tuple[Any, ...]) -> VsgDesignError:
    error = kind.__new__(kind, *args)
    error.args = args
    return error


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with an input, and what to do about it."""

    field: str
    value: str
    problem: str
    advice: str = ""

    def __str__(self) -> str:
        shown = f"{self.field} = {self.value}" if self.value else self.field
        advice = f" {self.advice}" if self.advice else ""
        return f"{shown}: {self.problem}.{advice}"


def nearest(name: str, known: Iterable[str], alike: float = 0.6) -> str | None:
    """The known name that is most like a wrong one; None where none is. ``alike``: how much they share, 0 to 1."""
    import difflib

    return next(iter(difflib.get_close_matches(name, tuple(known), n=1, cutoff=alike)), None)


def did_you_mean(name: str, known: Iterable[str], otherwise: str, alike: float = 0.6) -> str:
    """Advice for a wrong name: the nearest known one, or what else to do."""
    near = nearest(name, known, alike)
    return otherwise if near is None else f"Did you mean {near}?"


class UnknownNameError(VsgDesignError, KeyError):
    """A name that must be one of those known is none of them."""

    def __init__(self, field: str, value: object, known: Iterable[str]) -> None:
        self.field = field
        self.value = value
        self.known = tuple(known)
        super().__init__(f"{field} = {value!r}: must be one of {', '.join(self.known)}.")

    def __str__(self) -> str:
        return str(self.args[0])  # KeyError would show the text in quotes


class StudyError(VsgDesignError):
    """The study file is wrong. Carries every fault found, not only the first."""

    def __init__(self, source: str, faults: Sequence[Fault]) -> None:
        self.source = source
        self.faults = tuple(faults)
        lines = "\n".join(f"  - {fault}" for fault in self.faults)
        super().__init__(f"{source}: {counted(len(self.faults), 'fault')}\n{lines}")


class NoOperatingPointError(VsgDesignError):
    """The grid cannot carry the power that is asked for: the power flow has no real solution."""

    def __init__(self, message: str, *, shortfall_w: float) -> None:
        self.shortfall_w = shortfall_w
        super().__init__(message)


class InfeasibleStudyError(VsgDesignError):
    """The study is well-formed but asks for something that cannot be done."""


class CircuitError(InfeasibleStudyError):
    """A circuit that the simulation cannot follow, whatever the controller does."""


class LimitHitError(InfeasibleStudyError):
    """A steady state needs more than the converter has: ``limit`` is ``bridge voltage``, ``current`` or ``voltage
    limits``."""

    def __init__(self, message: str, *, limit: str) -> None:
        self.limit = limit
        super().__init__(message)


class SimulationDivergedError(VsgDesignError):
    """A simulated quantity left the range in which the result means anything."""


class ArtifactError(VsgDesignError):
    """A file handed between stages is damaged, foreign or of another schema."""


class WorkerError(VsgDesignError):
    """Another process or machine that was to do a part of the work is missing or was lost."""
