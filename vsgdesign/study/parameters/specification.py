"""The sections [specification], what a designed gain table has to keep and over what, and [stability], the axes of the
margin maps and the gates.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from vsgdesign.equations.grid import MOST_ERROR_Z
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import (
    S_RATED,
    SEEDS,
    V_RATED,
    Scope,
    Times,
    fields_of,
    inserted,
    number,
    numbers,
    picked,
    read,
    section,
    subtable,
    values,
    whole,
    word,
)
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS, GridSource, Place, basis_field
from vsgdesign.study.parameters.power_plant import PowerPlant
from vsgdesign.study.parameters.reader import REQUIRED, TableReader
from vsgdesign.study.parameters.targets import ClosedFormTarget

AIMS = ("settling", "inertia")

_BOTH = 'Leave it out; or, for a given speed and inertia at once, set aim = "settling" with H_min and H_max.'
_NOT_WITH_INERTIA = {"settling_time": _BOTH, "overshoot": _BOTH, "H_min": "Give H alone.", "H_max": "Give H alone."}
"""Fields that would stand back in silence, and what to do instead."""

UNBOUNDED_H = 1e6
"""H_max where none is asked for, s."""

DEFAULT_SCR = (1.5, 2.0, 3.0, 5.0, 10.0, 20.0)
DEFAULT_X_OVER_R = (0.5, 1.0, 2.0, 5.0, 20.0)


_MOST = 2.0 * S_RATED
_OF_GRID = "of `[grid]`"
_H_MIN = Times(1.0, "`H_min`")


@section
class DesignBox:
    """Everything that may differ from a cell's nominal: the design keeps its promises over all combinations of the
    limits (and at P = Q = 0 where that lies inside)."""

    P: tuple[float, ...] = numbers("W", -1.0 * _MOST, _MOST, shown="`P_design`")
    """Active powers."""
    Q: tuple[float, ...] = numbers("var", -1.0 * _MOST, _MOST, shown="`Q_design`")
    """Reactive powers."""
    error_R: float = number("1", 0.0, 0.9, shown="`error`")
    """Of R̂_g alone."""
    error_X: float = number("1", 0.0, 0.9, shown="`error`")
    """Of L̂_g alone."""
    omega_g: tuple[float, ...] = numbers("Hz", 10.0, 1000.0, shown=_OF_GRID, name="f_g", scale=2.0 * math.pi)
    """Grid frequencies."""
    V_g_rms: tuple[float, ...] = numbers("1", 0.5, 1.5, shown=_OF_GRID, name="V_g_pu", scale=V_RATED)
    """Source voltages, pu of rated."""
    error_Z: float = number("1", 0.0, MOST_ERROR_Z, default=0.0)
    """Error in any direction, relative to the magnitude of the grid impedance; where it is more than the ones above, it
    counts instead ([the error set](theory/optimizer.md#eq-error-set))."""

    @property
    def errors(self) -> tuple[float, float, float]:
        """error_R, error_X and error_Z."""
        return self.error_R, self.error_X, self.error_Z

    def exact(self) -> DesignBox:
        """The same box with an exact estimate."""
        return replace(self, error_R=0.0, error_X=0.0, error_Z=0.0)


@section
class Specification:
    """What a gain table must keep in every cell, at the worst of the box. Limits that are None are not asked."""

    aim: str = word(AIMS, default="settling")
    """`settling`: the poles are free, and the inertia follows from them. `inertia`: H is held, and the settling time
    follows from it."""
    settling_time: float = number("s", 1e-3, 1e3, shown="of `[power_loops]`")
    """2 % settling of P and Q after a step of their own reference; not with `inertia`."""
    overshoot: float = number("1", 0.001, 1.0, default=0.05)
    """Of the step; not with `inertia`."""
    damping_ratio: float = number("1", 0.0, 1.0, default=0.5)
    """Least [damping ratio of the power loops](definitions.md#damping-ratio). For that of all modes, those of filter
    and inner loops too, there is the [gate](#stabilitygates)."""
    disk_margin: float = number("1", 0.0, 1.9, default=1.0)
    """Least [disk margin at the output](definitions.md#disk-margin) (:eq:`disk-margin`)."""
    H: float | None = number("s", 1e-3, 1e3, shown="required with `inertia`")
    """Inertia constant to hold; not with `settling`."""
    H_min: float = number("s", 0.0, 1e3, default=0.0)
    """Least inertia constant at the design point; not with `inertia`."""
    H_max: float = number("s", _H_MIN, 1e6, default=UNBOUNDED_H)
    """Largest inertia constant at the design point; not with `inertia`."""
    differential_decay: float = number("1/s", 0.0, 1e3, shown="0; of a plant 3.9/`settling_time`")
    """Least decay of the differential mode of equal units at one node, which the gains of every node keep
    (:eq:`differential-mode`); 0: not asked. A unit's transformer and feeder are those of `[plant]`, or belong to `L_2`
    and `R_2` of `[filter]`."""
    bandwidth_max: float = number("1/s", 1e-2, 1e5, shown="0.1/T_s")
    """Upper bound of k_2 and d_1; with `inertia` of k_2 alone, since ζ and H decide d_1."""
    scr_basis: str = basis_field(shown=_OF_GRID)
    """Basis of `scr` here."""
    scr: tuple[float, ...] = numbers("1", *SCR_LIMITS, default=DEFAULT_SCR)
    """Nodes to begin with, at least two."""
    x_over_r: tuple[float, ...] = numbers("1", *X_OVER_R_LIMITS, default=DEFAULT_X_OVER_R)
    """The same."""
    box: DesignBox

    @property
    def error(self) -> float:
        """The largest relative error of an estimate of the grid that is asked for."""
        return max(self.box.errors)

    @property
    def settles(self) -> bool:
        """Whether settling time and overshoot are promises."""
        return self.aim == "settling"


class _Margins:
    """Fields of this section."""

    gain_margin_db: float = number("1", 0.0, 60.0, default=0.0)
    """Gain margin in both channels at once, dB; it raises `disk_margin` (:eq:`guaranteed-margins`)."""
    phase_margin_deg: float = number("1", 0.0, 89.0, default=0.0)
    """The same, degrees."""


class _Error:
    """Fields of this section."""

    error: float = number("1", 0.0, 0.9, default=0.0)
    """Relative error of R̂_g and of L̂_g; not with both of the next."""


SPECIFICATION = (
    *inserted(fields_of(Specification), "disk_margin", *fields_of(_Margins)),
    *inserted(fields_of(DesignBox), "Q", *fields_of(_Error)),
)
"""The fields of [specification]."""


def read_specification(
    table: TableReader | None,
    scope: Scope,
    converter: Converter,
    source: GridSource,
    target: ClosedFormTarget,
    scr_basis: str,
) -> Specification | None:
    """The section; None where a study has none."""
    if table is None:
        return None
    aim = values(picked(Specification, "aim"), table)["aim"]
    if aim == "settling" and table.has("H"):
        table.fault("H", table.table["H"], 'is for aim = "inertia" only', 'Set aim = "inertia", or use H_min, H_max.')
        table.quantity("H", "s")
    if aim == "inertia":
        for field, advice in _NOT_WITH_INERTIA.items():
            if table.has(field):
                table.fault(field, table.table[field], 'is not kept with aim = "inertia", where H is', advice)
    margins = values((*fields_of(_Margins), *fields_of(_Error)), table)
    error = margins.pop("error")
    if table.has("error") and table.has("error_R") and table.has("error_X"):
        table.fault(
            "error",
            table.table["error"],
            "has no effect, because error_R and error_X are both given",
            "Leave one of the three out.",
        )
    defaults = {
        "P": (target.P,),
        "Q": (target.Q,),
        "error_R": error,
        "error_X": error,
        "f_g": (source.omega_g / (2.0 * math.pi),),
        "V_g_pu": (source.V_g_rms / converter.V_rated_rms,),
        "settling_time": target.settling_time,
        "bandwidth_max": 0.1 / converter.T_s,
        "scr_basis": scr_basis,
        "differential_decay": 0.0,
    }
    box = DesignBox(**values(DesignBox, table, scope, defaults))
    known: dict[str, Any] = {"aim": aim} | values(picked(Specification, "disk_margin", "H_min"), table)
    known["disk_margin"] = max(known["disk_margin"], margin_of(*margins.values()))
    if aim != "inertia":
        known["H"] = None
    rest = tuple(one for one in fields_of(Specification) if one.name not in known)
    found = values(rest, table, {**scope, _H_MIN.of: known["H_min"]}, defaults)
    specification = Specification(**known, **found, box=box)
    for name in ("scr", "x_over_r"):
        if len(getattr(specification, name)) < 2:
            table.fault(name, getattr(specification, name), "a table needs at least two nodes on each axis")
    lowest = min(specification.x_over_r, default=math.inf)
    if box.error_Z >= (share := math.sin(math.atan(lowest))):
        problem = f"leaves no inductance in an estimate at X/R {lowest:g}: must be less than {share:.3g}"
        table.fault("error_Z", box.error_Z, problem, "Begin x_over_r higher, or ask for less.")
    table.finish()
    return specification


_SETTLED = 3.9
"""ln 50: of a mode that leaves 2 % after its settling time."""


def of_a_unit(found: Specification, table: TableReader, plant: PowerPlant) -> Specification:
    """A specification of a plant, whose grids are on the rating of all units, as one for a unit: over the grids that it
    sees, and with the decay of its differential mode."""
    decay = found.differential_decay
    if not table.has("differential_decay") and found.settles and len(plant.units) > 1:
        decay = settled_decay(found.settling_time)
    return replace(found, scr=seen_by_a_unit(found.scr, plant), differential_decay=decay)


def settled_decay(settling_time: float) -> float:
    """The decay (1/s) that leaves 2 % after a settling time (s)."""
    return _SETTLED / settling_time


def decaying_time(decay: float) -> float:
    """The time (s) after which a decay (1/s) leaves 2 %."""
    return _SETTLED / decay


_APART = 2.0
"""The largest ratio of two neighbouring nodes that are added to those of a study."""


def seen_by_a_unit(scr: tuple[float, ...], plant: PowerPlant) -> tuple[float, ...]:
    """SCR of the grids that a unit sees behind its node: those of the plant with all units on line, and up to the
    strongest one with the least number of them (:eq:`plant-grid`)."""
    steps = math.ceil(math.log(plant.most_grid) / math.log(_APART) - 1e-9) if scr else 0
    return (*scr, *(scr[-1] * plant.most_grid ** (k / steps) for k in range(1, steps + 1)))


def margin_of(gain_db: float, phase_deg: float) -> float:
    """The disk margin that guarantees a gain and a phase margin (:eq:`guaranteed-margins`)."""
    gain = 10.0 ** (gain_db / 20.0)
    return max(2.0 * (gain - 1.0) / (gain + 1.0), 2.0 * math.tan(0.5 * math.radians(phase_deg)))


MAP_SCR = (1.2, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 12.5, 16.0, 20.0)
MAP_X_OVER_R = (0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 14.0, 20.0)
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
        return {"scr": MAP_SCR, "x_over_r": MAP_X_OVER_R}
    ratios = specification.x_over_r[0], specification.x_over_r[-1]
    scr = specification.scr[0], specification.scr[-1]
    if specification.scr_basis != scr_basis:
        places = [Place(s, x, specification.scr_basis).grid(converter) for s in scr for x in ratios]
        found = [grid.scr(converter, scr_basis) for grid in places]
        scr = _rounded(min(found), math.ceil), _rounded(max(found), math.floor)
    return {"scr": _axis(MAP_SCR, *scr), "x_over_r": _axis(MAP_X_OVER_R, *ratios)}


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
