"""The [inner_loops] section: gains that are given, or what they are to be designed for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.placing import current_loop_gains, voltage_loop_gains
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.fields import F_N, SEEDS, Z_BASE, Scope, fields_of, flag, number, numbers, values, whole
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS
from vsgdesign.study.parameters.reader import TableReader
from vsgdesign.study.parameters.specification import Specification, settled_decay
from vsgdesign.study.parameters.study import InnerLoopRequest
from vsgdesign.study.parameters.targets import ClosedFormTarget

DEFAULT_SCR = (1.2, 20.0)
DEFAULT_X_OVER_R = (0.3, 20.0)
"""Grids that inner loops are designed for where neither they nor a specification name any."""

ENOUGH_SAMPLING = 7.6
"""Sampling rate over the filter's highest resonance from which on all promises have usually been kept."""

InnerLoopSource = Callable[[InnerLoopRequest], tuple[InnerLoopGains, float]]
"""Designed gains for a request, and the transient impedance's corner ω_t in rad/s: from a file, or designed now."""

_GAINS, _TIMES = "required, or gains", "required, or times"


class Designed:
    """What gains are designed for."""

    scr: tuple[float, ...] = numbers("1", *SCR_LIMITS, default=(), shown="the specification's, else 1.2 to 20")
    """Least and largest SCR to design for, on the study's `scr_basis`; with `design` only."""
    x_over_r: tuple[float, ...] = numbers(
        "1", *X_OVER_R_LIMITS, default=(), shown="the specification's, else 0.3 to 20"
    )
    """Least and largest X/R to design for; with `design` only."""
    seed: int = whole(0, SEEDS, default=0)
    """Seed of the search; with `design` only."""


class Times:
    """Fields of this section."""

    current_response_time: float = number("s", 1e-5, 1.0, shown=_GAINS)
    """T_c in ω_c = 2π/T_c (:eq:`inner-gains`)."""
    voltage_response_time: float = number("s", 1e-5, 1.0, shown=_GAINS)
    """T_v in ω_v = 2π/T_v."""


class Damping:
    """Fields of this section."""

    damping_ratio: float = number("1", 0.1, 10.0, default=1.0)
    """ξ of both loops."""


class Gains:
    """Fields of this section."""

    K_pc: float = number("V/A", 1e-9, 1e6, shown=_TIMES)
    """Current loop, proportional."""
    K_ic: float = number("V/(A·s)", 1e-9, 1e9, shown=_TIMES)
    """Current loop, integral."""
    K_pv: float = number("A/V", 1e-9, 1e6, shown=_TIMES)
    """Voltage loop, proportional."""
    K_iv: float = number("A/(V·s)", 1e-9, 1e9, shown=_TIMES)
    """Voltage loop, integral."""


class Additions:
    """What given gains may have besides, by its name in :class:`vsgdesign.equations.inner_loops.InnerLoopGains`."""

    K_ff: float = number("1", -1.0, 1.5, default=1.0, name="current_feedforward")
    """K_ff, share of the grid current fed forward (:eq:`voltage-loop`)."""
    R_t: float = number("1", 0.0, 1.0, default=0.0, name="transient_resistance_pu", scale=Z_BASE)
    """R_t over the base impedance; only changes of the grid current see it (:eq:`transient-impedance`)."""
    X_t: float = number("1", -1.0, 1.0, default=0.0, name="transient_reactance_pu", scale=Z_BASE)
    """X_t over the base impedance, beside R_t."""
    kappa: float = number("1", 0.0, 2.0, default=0.0, name="current_prediction")
    """κ, share of one sampling period by which the converter current is predicted; only with `delay_samples = 1`
    (:eq:`current-prediction`)."""


class Corner:
    """Fields of this section."""

    transient_corner: float = number("Hz", 0.01 * F_N, 10.0 * F_N, default=0.5 * F_N, shown="half of f_n")
    """ω_t/2π, above which R_t and X_t act; only with one of them."""


class Design:
    """Whether gains are designed."""

    design: bool = flag(shown="true where nothing else is given")
    """The gains are designed once and kept in `STUDY.inner.json` beside the study."""


_GIVEN = tuple(one for of in (Times, Damping, Gains, Additions, Corner) for one in fields_of(of))
INNER_LOOPS = (*fields_of(Design), *fields_of(Designed), *_GIVEN)
"""The fields of [inner_loops]."""

GIVEN = tuple(one.name for one in _GIVEN)
"""Names of the fields of given gains."""


@dataclass(frozen=True)
class Reading:
    """What the section says: gains and ω_t in rad/s, or (gains None) the box and the seed of a design."""

    gains: InnerLoopGains | None
    omega_t: float
    scr: tuple[float, ...] | None = None
    x_over_r: tuple[float, ...] | None = None
    seed: int = 0


def read_inner_loops(table: TableReader | None, scope: Scope, filter_: Filter, converter: Converter) -> Reading:
    """The section. Where it is absent, or says ``design = true``, the gains are to be designed."""
    if table is None:
        return Reading(None, math.nan)
    given = [field for field in GIVEN if table.has(field)]
    asked = values(Design, table, defaults={"design": not given})["design"]
    # A flag that is neither true nor false has had its fault; what else it asks for is read as asked for.
    if asked or not isinstance(table.table.get("design", False), bool):
        return _read_request(table, given)
    for one in fields_of(Designed):
        if table.has(one.name):
            value = table.table[one.name]
            table.fault(one.name, value, "is for designed gains only", "Set design = true, or remove it.")
            table.quantities(one.name, "1", 0.0, math.inf, ())
    return _read_gains(table, scope, filter_, converter)


def request_of(
    reading: Reading,
    converter: Converter,
    filter_: Filter,
    basis: str,
    target: ClosedFormTarget,
    specification: Specification | None,
    several: bool = False,
) -> InnerLoopRequest:
    """What the inner loops are designed for: their own grids, else the specification's, else the default ones.
    ``several``: of equal units, which are not to swing against each other; their transformer is a part of the
    filter."""
    scr = reading.scr or (specification.scr if specification else DEFAULT_SCR)
    x_over_r = reading.x_over_r or (specification.x_over_r if specification else DEFAULT_X_OVER_R)
    # A table's axis has its own basis; the section's own numbers have the study's.
    of_table = specification is not None and reading.scr is None
    settling_time = specification.settling_time if specification else target.settling_time
    decay = specification.differential_decay if specification else 0.0
    return InnerLoopRequest(
        converter=converter,
        filter=filter_,
        scr=(float(scr[0]), float(scr[-1])),
        x_over_r=(float(x_over_r[0]), float(x_over_r[-1])),
        scr_basis=specification.scr_basis if specification is not None and of_table else basis,
        settling_time=settling_time,
        seed=reading.seed,
        decay_apart=(decay or several * settled_decay(settling_time)) if filter_.L_2 > 0.0 else 0.0,
    )


def _read_request(table: TableReader, given: list[str]) -> Reading:
    for field in given:
        table.fault(
            field,
            table.table[field],
            "the gains are to be designed (design = true)",
            "Remove it, or set design = false and give all gains.",
        )
    found: dict[str, Any] = {}
    for one in fields_of(Designed):
        found |= values((one,), table)
        if one.kind == "numbers" and found[one.name] and len(found[one.name]) != 2:
            table.fault(one.name, table.table[one.name], "must be a range", f"For example {one.name} = [1.2, 20].")
    table.skip(*given)
    table.finish()
    return Reading(None, math.nan, found["scr"] or None, found["x_over_r"] or None, found["seed"])


def _read_gains(table: TableReader, scope: Scope, filter_: Filter, converter: Converter) -> Reading:
    names_of_times, names_of_gains = (
        tuple(one.name for one in fields) for fields in (fields_of(Times), fields_of(Gains))
    )
    if table.one_of(names_of_times, names_of_gains) == names_of_gains:
        gains = InnerLoopGains(**values(Gains, table))
    else:
        damping = values(Damping, table)["damping_ratio"]
        times = values(Times, table).values() if table.table else (math.nan, math.nan)
        current_time, voltage_time = times
        K_pc, K_ic = current_loop_gains(current_time, damping, filter_.L_1)
        K_pv, K_iv = voltage_loop_gains(voltage_time, damping, filter_.C)
        gains = InnerLoopGains(K_pv=K_pv, K_iv=K_iv, K_pc=K_pc, K_ic=K_ic)
    gains = gains._replace(**values(Additions, table, scope))
    if gains.kappa > 0.0 and converter.delay_samples == 0:
        table.fault(
            "current_prediction",
            f"{gains.kappa:.6g}",
            "there is no delay to predict over",
            "Remove it, or set delay_samples = 1 in [converter].",
        )
    corner_hz = values(Corner, table, scope)["transient_corner"]
    if table.has("transient_corner") and not (
        table.has("transient_resistance_pu") or table.has("transient_reactance_pu")
    ):
        table.fault(
            "transient_corner",
            table.table["transient_corner"],
            "there is no transient impedance that this corner could belong to",
            "Add transient_resistance_pu (0.08 is a first guess), or leave the corner out.",
        )
    table.finish()
    return Reading(gains, 2.0 * math.pi * corner_hz)
