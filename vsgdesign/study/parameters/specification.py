"""The [specification] section: what a designed gain table has to keep, and over what."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from vsgdesign.equations.grid import MOST_ERROR_Z
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import (
    S_RATED,
    V_RATED,
    Scope,
    Times,
    fields_of,
    inserted,
    number,
    numbers,
    picked,
    section,
    values,
    word,
)
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS, GridSource, basis_field
from vsgdesign.study.parameters.power_plant import PowerPlant
from vsgdesign.study.parameters.reader import TableReader
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
