"""Reads the grid and the simulation of a study file."""

from __future__ import annotations

import math

from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.grid import Grid, Place
from vsgdesign.parameters.network import PLAIN, Network
from vsgdesign.parameters.network_fields import (
    CLEARED,
    NONE,
    Base,
    read_said,
)
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.source import SourceComponent
from vsgdesign.parameters.study import SimulationSpec

SCR_LIMITS = (0.05, 1e4)
X_OVER_R_LIMITS = (1e-3, 1e4)
"""Limits of SCR and X/R in a study."""
_HIGHEST_ORDER = 100.0
_MOST_REFERENCE = 2.0
"""Largest reference over S_rated where a study says nothing: more is rather a wrong unit."""
_MOST_ROWS = 5e6
"""Largest log: about 2 GB for a controller."""


def read_grid(table: TableReader, converter: Converter, basis: str, previous: Grid | None) -> Grid:
    """A grid from scr and x_over_r, or from R_g and L_g.

    With ``previous`` (an event) a missing one of scr and x_over_r keeps its value.
    """
    if previous is not None and not (table.has("R_g") or table.has("L_g")):
        # To twelve digits: what is kept is then the number that was given, and equal grids are equal.
        kept = previous.place(converter, basis)
        keep_scr, keep_ratio = (float(f"{x:.12g}") for x in (kept.scr, kept.x_over_r))
        scr = table.quantity("scr", "1", *SCR_LIMITS, default=keep_scr)
        ratio = table.quantity("x_over_r", "1", *X_OVER_R_LIMITS, default=keep_ratio)
        return Place(scr, ratio, basis).grid(converter)
    if table.one_of(("scr", "x_over_r"), ("R_g", "L_g")) == ("R_g", "L_g"):
        # Plausible: between 1/10000 and 20 times the base impedance.
        high = 20.0 * converter.Z_base
        R_g = table.quantity("R_g", "ohm", 0.0, high)
        L_g = table.quantity("L_g", "H", 1e-4 * high / 20.0 / converter.omega_n, high / converter.omega_n)
        return Grid(R_g, L_g)
    if not (table.has("scr") or table.has("x_over_r")):
        return Grid(math.nan, math.nan)
    scr = table.quantity("scr", "1", *SCR_LIMITS)
    ratio = table.quantity("x_over_r", "1", *X_OVER_R_LIMITS)
    return Place(scr, ratio, basis).grid(converter)


def read_components(tables: list[TableReader]) -> tuple[SourceComponent, ...]:
    """The negative sequence and the harmonics of the grid source, one table each."""
    found: list[SourceComponent] = []
    for table in tables:
        order = table.quantity("order", "1", -_HIGHEST_ORDER, _HIGHEST_ORDER)
        component = SourceComponent(
            order=order,
            amplitude_pu=table.quantity("amplitude_pu", "1", 0.0, 1.0),
            phase=table.quantity("phase", "rad", -2.0 * math.pi, 2.0 * math.pi, default=0.0),
        )
        if order in (0.0, 1.0):
            meant = "a dc voltage" if order == 0.0 else "the fundamental itself, which V_g_pu gives"
            table.fault("order", f"{order:g}", f"is {meant}", "Use -1 for the negative sequence, -5, 7, -11, 13, …")
        elif order in [other.order for other in found]:
            table.fault("order", f"{order:g}", "is given twice", "Give one amplitude and phase for each order.")
        found.append(component)
        table.finish()
    return tuple(found)


def read_simulation(table: TableReader, converter: Converter) -> SimulationSpec:
    """The [simulation] section."""
    T_s = converter.T_s
    # A droop adds to a reference where the source's voltage or frequency is not nominal.
    most_pu = table.quantity("reference_limit_pu", "1", 0.1, 100.0, default=_MOST_REFERENCE)
    limit = most_pu * converter.S_rated
    default = math.nan if math.isnan(T_s) else max(round(200e-6 / T_s), 1) * T_s
    log_interval = table.quantity("log_interval", "s", 0.0, 1.0, default=default)
    spec = SimulationSpec(
        duration=table.quantity("duration", "s", 1e-3, 36000.0),
        bridge=table.choice("bridge", ("averaged", "pwm"), default="averaged"),
        start=table.choice("start", ("steady_state", "cold"), default="steady_state"),
        log_interval=log_interval,
        csv_interval=table.quantity("csv_interval", "s", 0.0, 10.0, default=0.002),
        P_ref=table.quantity("P_ref", "W", -limit, limit),
        Q_ref=table.quantity("Q_ref", "var", -limit, limit),
        reference_limit_pu=most_pu,
        survival=table.flag("survival", default=False),
    )
    _check_multiple(table, "log_interval", log_interval, T_s)
    if spec.duration > _MOST_ROWS * spec.log_interval > 0.0:
        table.fault(
            "log_interval",
            f"{log_interval:.6g} s",
            f"logs {spec.duration / log_interval:.3g} samples, more than {_MOST_ROWS:.0e}: several GB of memory",
            f"Use {math.ceil(spec.duration / _MOST_ROWS / T_s) * T_s:.6g} or more, or a shorter duration.",
        )
    table.finish()
    return spec


def _check_multiple(table: TableReader, field: str, value: float, T_s: float) -> None:
    steps = value / T_s
    if math.isnan(steps):
        return
    if steps < 0.5 or abs(steps - round(steps)) > 1e-6 * steps:
        nearest = max(round(steps), 1) * T_s
        table.fault(
            field, f"{value:.6g} s", f"not a multiple of the sampling period {T_s:.6g} s", f"Use {nearest:.9g}."
        )


def read_network(table: TableReader | None, converter: Converter) -> Network:
    """The [network] section: load, fault and breaker at the start."""
    if table is None:
        return PLAIN
    said = read_said(table, Base.of(converter))
    for field, word in (("load", NONE), ("fault", CLEARED)):
        if getattr(said, field) == word:
            table.fault(field, word, "there is none before the start", "Leave it out.")
    table.finish()
    return said.on(PLAIN)
