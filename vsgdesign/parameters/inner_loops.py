"""Reads the [inner_loops] section: gains that are given, or what they are to be designed for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from vsgdesign.equations.closed_form import current_loop_gains, voltage_loop_gains
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.parameters.converter import Converter, Filter
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.specification import Specification
from vsgdesign.parameters.study import ClosedFormTarget, InnerLoopRequest

DEFAULT_SCR = (1.2, 20.0)
DEFAULT_X_OVER_R = (0.3, 20.0)
"""Grids that inner loops are designed for where neither they nor a specification name any."""

ENOUGH_SAMPLING = 7.6
"""Sampling rate over the filter's highest resonance from which on all promises have usually been kept."""

InnerLoopSource = Callable[[InnerLoopRequest], tuple[InnerLoopGains, float]]
"""Designed gains for a request, and the transient impedance's corner ω_t in rad/s: from a file, or designed now."""

TIMES = ("current_response_time", "voltage_response_time")
GAINS = ("K_pc", "K_ic", "K_pv", "K_iv")
ADDITIONS = (
    "current_feedforward",
    "transient_resistance_pu",
    "transient_reactance_pu",
    "transient_corner",
    "current_prediction",
)
GIVEN = (*TIMES, "damping_ratio", *GAINS, *ADDITIONS)
"""Fields of given gains."""


@dataclass(frozen=True)
class Reading:
    """What the section says: gains and ω_t in rad/s, or (gains None) the box and the seed of a design."""

    gains: InnerLoopGains | None
    omega_t: float
    scr: tuple[float, ...] | None = None
    x_over_r: tuple[float, ...] | None = None
    seed: int = 0


def read_inner_loops(table: TableReader | None, filter_: Filter, converter: Converter) -> Reading:
    """The section. Where it is absent, or says ``design = true``, the gains are to be designed."""
    if table is None:
        return Reading(None, math.nan)
    given = [field for field in GIVEN if table.has(field)]
    asked = table.flag("design", default=not given)
    # A flag that is neither true nor false has had its fault; what else it asks for is read as asked for.
    if asked or not isinstance(table.table.get("design", False), bool):
        return _read_request(table, given)
    for field in ("scr", "x_over_r", "seed"):
        if table.has(field):
            table.fault(field, table.table[field], "is for designed gains only", "Set design = true, or remove it.")
            table.quantities(field, "1", 0.0, math.inf, ())
    return _read_gains(table, filter_, converter)


def request_of(
    reading: Reading,
    converter: Converter,
    filter_: Filter,
    basis: str,
    target: ClosedFormTarget,
    specification: Specification | None,
) -> InnerLoopRequest:
    """What the inner loops are designed for: their own grids, else the specification's, else the default ones."""
    scr = reading.scr or (specification.scr if specification else DEFAULT_SCR)
    x_over_r = reading.x_over_r or (specification.x_over_r if specification else DEFAULT_X_OVER_R)
    # A table's axis has its own basis; the section's own numbers have the study's.
    of_table = specification is not None and reading.scr is None
    settling_time = specification.settling_time if specification else target.settling_time
    return InnerLoopRequest(
        converter=converter,
        filter=filter_,
        scr=(float(scr[0]), float(scr[-1])),
        x_over_r=(float(x_over_r[0]), float(x_over_r[-1])),
        scr_basis=specification.scr_basis if specification is not None and of_table else basis,
        settling_time=settling_time,
        seed=reading.seed,
    )


def _read_request(table: TableReader, given: list[str]) -> Reading:
    for field in given:
        table.fault(
            field,
            table.table[field],
            "the gains are to be designed (design = true)",
            "Remove it, or set design = false and give all gains.",
        )
    ranges: list[tuple[float, ...] | None] = []
    for field, low, high in (("scr", 0.05, 1e4), ("x_over_r", 1e-3, 1e4)):
        values = table.quantities(field, "1", low, high, ()) or None
        if values is not None and len(values) != 2:
            table.fault(field, table.table[field], "must be a range", f"For example {field} = [1.2, 20].")
        ranges.append(values)
    seed = table.integer("seed", 0, 2**31 - 1, default=0)
    for field in given:
        table.skip(field)
    table.finish()
    return Reading(None, math.nan, ranges[0], ranges[1], seed)


def _read_gains(table: TableReader, filter_: Filter, converter: Converter) -> Reading:
    if table.one_of(TIMES, GAINS) == GAINS:
        gains = InnerLoopGains(
            K_pv=table.quantity("K_pv", "A/V", 1e-9, 1e6),
            K_iv=table.quantity("K_iv", "A/(V·s)", 1e-9, 1e9),
            K_pc=table.quantity("K_pc", "V/A", 1e-9, 1e6),
            K_ic=table.quantity("K_ic", "V/(A·s)", 1e-9, 1e9),
        )
    else:
        damping = table.quantity("damping_ratio", "1", 0.1, 10.0, default=1.0)
        current_time = table.quantity("current_response_time", "s", 1e-5, 1.0) if table.table else math.nan
        voltage_time = table.quantity("voltage_response_time", "s", 1e-5, 1.0) if table.table else math.nan
        K_pc, K_ic = current_loop_gains(current_time, damping, filter_.L_1)
        K_pv, K_iv = voltage_loop_gains(voltage_time, damping, filter_.C)
        gains = InnerLoopGains(K_pv=K_pv, K_iv=K_iv, K_pc=K_pc, K_ic=K_ic)
    gains = gains._replace(
        K_ff=table.quantity("current_feedforward", "1", -1.0, 1.5, default=1.0),
        R_t=table.quantity("transient_resistance_pu", "1", 0.0, 1.0, default=0.0) * converter.Z_base,
        X_t=table.quantity("transient_reactance_pu", "1", -1.0, 1.0, default=0.0) * converter.Z_base,
        kappa=table.quantity("current_prediction", "1", 0.0, 2.0, default=0.0),
    )
    if gains.kappa > 0.0 and converter.delay_samples == 0:
        table.fault(
            "current_prediction",
            f"{gains.kappa:.6g}",
            "there is no delay to predict over",
            "Remove it, or set delay_samples = 1 in [converter].",
        )
    f_n = converter.omega_n / (2.0 * math.pi)
    corner_hz = table.quantity("transient_corner", "Hz", 0.01 * f_n, 10.0 * f_n, default=0.5 * f_n)
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
