"""The large-signal statement of a controller, as data and as a document."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from vsgdesign.artifacts.files import plain
from vsgdesign.certificate.region import Region
from vsgdesign.certificate.swing.conditions import SwingLaw


@dataclass(frozen=True)
class SwingStart:
    """From where the swing starts: |δ| up to ``angle`` (rad) and a frequency within ± ``speed`` (rad/s) of the grid's.
    ``angle_error`` is the largest error of the impedance angle, rad.

    The default angle is 172°: on the weakest grids the pull vanishes at 180°. The default speed is 1 Hz.
    """

    angle: float = math.radians(172.0)
    speed: float = 2.0 * math.pi
    angle_error: float = 0.0


RETURNS = "proved"
FAILS = "counterexample"
OPEN = "not proved"
EMPTY = "no operating point"


@dataclass(frozen=True)
class SwingPoint:
    """A point at which one of the conditions does not hold: ``condition`` says which. ``delta`` is the angle there in
    rad: of the unstable rest, or the one at which the function rises; None where no angle belongs to it."""

    condition: str
    scr: float
    x_over_r: float
    P: float
    Q: float
    delta: float | None = None


@dataclass(frozen=True)
class SwingPart:
    """One part of the map. ``grade`` is ``proved`` (of every operating point in the part), ``counterexample`` (``at``
    one point a condition does not hold), ``not proved`` (neither was found with the given number of boxes) or ``no
    operating point`` (none lies within the static limits and 0.9 of the current limit).
    ``undecided`` names the first condition that is not proved."""

    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    grade: str
    boxes: int
    undecided: str = ""
    at: SwingPoint | None = None


@dataclass(frozen=True, kw_only=True)
class SwingStatement:
    """From which grids the limited swing returns to its rest (docs/theory/large-signal.md, which states what this
    assumes: V held, gains held, a quasi-static network, an ideal current loop). It holds from every ``start``."""

    controller: str
    region: Region
    law: SwingLaw
    start: SwingStart
    parts: tuple[SwingPart, ...]

    def count(self, grade: str) -> int:
        """How many parts have a grade."""
        return sum(part.grade == grade for part in self.parts)

    @property
    def proved(self) -> bool:
        """Whether every part that has an operating point is proved."""
        return self.count(RETURNS) == len(self.parts) - self.count(EMPTY) > 0

    def as_document(self) -> dict[str, Any]:
        """JSON's types, the same for the same inputs."""
        return plain(
            {
                "proved": self.proved,
                "controller": self.controller,
                "region": self.region.as_document(),
                "law": asdict(self.law),
                "start": asdict(self.start),
                "parts": [asdict(part) for part in self.parts],
            }
        )
