"""The [stability] section: the axes of the margin maps and the gates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import S_RATED, SEEDS, Scope, number, numbers, read, section, subtable, whole
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS, Place
from vsgdesign.study.parameters.reader import REQUIRED, TableReader
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.targets import ClosedFormTarget

DEFAULT_SCR = (1.2, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 12.5, 16.0, 20.0)
DEFAULT_X_OVER_R = (0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 14.0, 20.0)
_WIDEST = 1.7
"""Largest ratio of neighbours on an axis that follows from a specification: those above are not farther apart."""
_OF_BOX = "over the box of `[specification]`; else"
DEFAULT_ERRORS = (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)


@section
class Gates:
    """Gates: limits for the margins of a design. They are set in the study and do not come from a grid code."""

    damping_ratio: float = number("1", 0.0, 1.0, default=0.3)
    """Least [damping ratio of all modes](definitions.md#damping-ratio)."""
    gain_margin_db: float = number("1", 0.0, 60.0, default=6.0)
    """Of either loop with the other closed, dB."""
    phase_margin_deg: float = number("1", 0.0, 180.0, default=30.0)
    """Of either loop with the other closed, degrees."""
    M_s: float = number("1", 1.0, 100.0, default=2.0)
    """Largest singular value of the sensitivity."""
    settling_time: float = number(
        "s", 1e-3, 1000.0, default=1.0, shown="the specification's, else that of `[power_loops]`"
    )
    """2 % settling of P and Q steps, reduced model."""


@section
class StabilitySpec:
    """Axes of the margin maps: SCR × X/R × every combination of P and Q, and estimate errors."""

    scr: tuple[float, ...] = numbers("1", *SCR_LIMITS, shown=f"{_OF_BOX} 14 values, 1.2 … 20")
    """Short-circuit ratios, on the basis of `[grid]`."""
    x_over_r: tuple[float, ...] = numbers("1", *X_OVER_R_LIMITS, shown=f"{_OF_BOX} 12 values, 0.5 … 20")
    """X_g/R_g. A grid outside the box of `[specification]` is drawn and marked, and no gate judges it."""
    P: tuple[float, ...] = numbers("W", -2.0 * S_RATED, 2.0 * S_RATED, shown="`P_design`")
    """Active powers; every combination with `Q` is a layer."""
    Q: tuple[float, ...] = numbers("var", -2.0 * S_RATED, 2.0 * S_RATED, shown="`Q_design`")
    """Reactive powers."""
    errors: tuple[float, ...] = numbers("1", -0.9, 10.0, default=DEFAULT_ERRORS)
    """Relative errors of R_g and of L_g, each taking every value."""
    gates: Gates = subtable(Gates, default=REQUIRED, shown="the defaults below")
    """Limits that the margins are held against."""


def read_stability(
    table: TableReader | None,
    scope: Scope,
    target: ClosedFormTarget,
    settling_time: float,
    axes: dict[str, tuple[float, ...]],
) -> StabilitySpec:
    """The section, or its defaults: ``axes`` of SCR and X/R, at the design point of the power loops.

    ``settling_time`` (s) is what the study asks of its steps: the gate's default.
    """
    gates = read(Gates, table.child("gates") if table else None, defaults={"settling_time": settling_time})
    return read(StabilitySpec, table, scope, {"P": (target.P,), "Q": (target.Q,)} | axes, gates=gates)


def default_axes(
    specification: Specification | None, converter: Converter, scr_basis: str
) -> dict[str, tuple[float, ...]]:
    """SCR and X/R of the margin maps where a study gives none: the box of its specification, else 1.2–20 × 0.5–20.

    SCR is on ``scr_basis``. With another basis in the specification, the axis holds every grid of its box.
    """
    if specification is None or not (specification.scr and specification.x_over_r):
        return {"scr": DEFAULT_SCR, "x_over_r": DEFAULT_X_OVER_R}
    ratios = specification.x_over_r[0], specification.x_over_r[-1]
    scr = specification.scr[0], specification.scr[-1]
    if specification.scr_basis != scr_basis:
        places = [Place(s, x, specification.scr_basis).grid(converter) for s in scr for x in ratios]
        found = [grid.scr(converter, scr_basis) for grid in places]
        scr = _rounded(min(found), math.ceil), _rounded(max(found), math.floor)
    return {"scr": _axis(DEFAULT_SCR, *scr), "x_over_r": _axis(DEFAULT_X_OVER_R, *ratios)}


def _rounded(value: float, towards: Callable[[float], int]) -> float:
    """A number to three digits, by ``ceil`` or ``floor``."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{towards(value / unit) * unit:.3g}")


def _axis(usual: Sequence[float], low: float, high: float) -> tuple[float, ...]:
    """Both ends, the usual values that are not close to them, and more where two neighbours are far apart."""
    if not 0.0 < low < high < math.inf:
        return tuple(usual)
    points = [low, *(value for value in usual if 1.05 * low < value < high / 1.05), high]
    found = [low]
    for left, right in itertools.pairwise(points):
        parts = max(math.ceil(math.log(right / left) / math.log(_WIDEST)), 1)
        found += [float(f"{left * (right / left) ** (k / parts):.3g}") for k in range(1, parts)] + [right]
    return tuple(found)


@section
class ProtectionLimits:
    """Limits at which the protection of the converter trips. One that is not given never does."""

    rocof: float | None = number("Hz/s", 0.05, 100.0, default=None)
    """Largest rate of change of the converter's frequency."""
    rocof_window: float = number("s", 0.02, 5.0, default=0.5)
    """The rate is the change over this time, divided by it."""
    V_high_pu: float | None = number("1", 1.0, 3.0, default=None)
    """Largest voltage at the control point, pu of the rated voltage, as a mean over one nominal cycle."""
    V_high_time: float = number("s", 0.0, 60.0, default=0.1)
    """For so long the voltage may be above it without interruption."""
    V_low_pu: float | None = number("1", 0.0, 1.0, default=None)
    """Least voltage there, pu."""
    V_low_time: float = number("s", 0.0, 60.0, default=0.5)
    """For so long the voltage may be below it without interruption."""

    @property
    def given(self) -> bool:
        """Whether there is any limit."""
        return any(limit is not None for limit in (self.rocof, self.V_high_pu, self.V_low_pu))


@section
class SurvivalSpec:
    """Random disturbances beside the systematic ones, and the protection."""

    random: int = whole(0, 1_000_000, default=600)
    """Number of random disturbances."""
    seed: int = whole(0, SEEDS, default=1)
    """Seed of their draw."""
    protection: ProtectionLimits | None = subtable(ProtectionLimits, default=None, shown="none")
    """Limits at which a converter that survives otherwise is tripped."""


def read_survival(table: TableReader | None) -> SurvivalSpec:
    """The section, or its defaults."""
    limits = table.child("protection") if table else None
    return read(SurvivalSpec, table, protection=None if limits is None else read(ProtectionLimits, limits))
