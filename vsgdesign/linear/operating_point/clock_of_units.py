"""The instants at which the units of a plant sample, over the time after which they repeat (:eq:`plant-clock`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters.power_plant import Inverter
from vsgdesign.study.parameters.study import Study

_MOST_INSTANTS = 128
_SAME = 1e-6
"""Share of a sampling period within which instants are one."""


class Instant(NamedTuple):
    """An instant at which units sample."""

    t_s: float
    """Since the beginning of the clock's period."""
    units: tuple[int, ...]
    """Indices of converters."""
    gap: float
    """Time to the next instant, s."""


class Clock(NamedTuple):
    """All instants of a period."""

    period: float
    instants: tuple[Instant, ...]

    @property
    def equal_gaps(self) -> bool:
        """Whether the next instant is equally far from all of them."""
        first = self.instants[0].gap
        return all(abs(one.gap - first) <= _SAME * first for one in self.instants)

    def time(self, k: int) -> float:
        """The k-th instant from t = 0 on, s."""
        turn, at = divmod(k, len(self.instants))
        return turn * self.period + self.instants[at].t_s


def clock_of(names: Sequence[str], T_s: Sequence[float], offsets: Sequence[float]) -> Clock:
    """The clock of units with these sampling periods, which sample for the first time after ``offsets``.

    Raises InfeasibleStudyError where they do not repeat within some 100 instants, with their names.
    """
    offsets = [one - min(offsets) for one in offsets]
    ratios = [Fraction(one / T_s[0]).limit_denominator(_MOST_INSTANTS) for one in T_s]
    common = Fraction(math.lcm(*(one.numerator for one in ratios)), math.gcd(*(one.denominator for one in ratios)))
    counts = [common / one for one in ratios]
    fits = all(abs(float(one) * T_s[0] / T - 1.0) < 1e-9 for one, T in zip(ratios, T_s, strict=True))
    if not fits or sum(map(int, counts)) > _MOST_INSTANTS:
        shown = ", ".join(f"{name} {1.0 / T:.6g} Hz" for name, T in zip(names, T_s, strict=True))
        raise InfeasibleStudyError(
            f"network: the sampling frequencies ({shown}) do not repeat within {_MOST_INSTANTS} instants. Give "
            "frequencies in the ratio of small whole numbers."
        )
    due = sorted(
        (offset + k * T, unit)
        for unit, (T, offset, count) in enumerate(zip(T_s, offsets, counts, strict=True))
        for k in range(int(count))
    )
    period, found = float(common) * T_s[0], list[tuple[float, list[int]]]()
    for t_s, unit in due:
        if found and t_s - found[-1][0] <= _SAME * min(T_s):
            found[-1][1].append(unit)
        else:
            found.append((t_s, [unit]))
    ends = [t_s for t_s, _ in found[1:]] + [found[0][0] + period]
    instants = (Instant(t_s, tuple(units), end - t_s) for (t_s, units), end in zip(found, ends, strict=True))
    return Clock(period, tuple(instants))


def clock_of_study(study: Study) -> Clock:
    """That of a study's plant."""
    some = () if study.plant is None else study.plant.converters
    periods = [one.T_s if isinstance(one, Inverter) else (one.case or study).converter.T_s for one in some]
    return clock_of([one.name for one in some], periods, [one.offset for one in some])
