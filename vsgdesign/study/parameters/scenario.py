"""The sections [simulation] and [network], and what the grid's source contains."""

from __future__ import annotations

import math

from vsgdesign.study.parameters.converter import Converter, scope_of
from vsgdesign.study.parameters.fields import (
    MOST_REFERENCE,
    fields_of,
    flag,
    number,
    picked,
    section,
    values,
    word,
)
from vsgdesign.study.parameters.grid import PLAIN, Network, SourceComponent
from vsgdesign.study.parameters.network_fields import CLEARED, NONE, Base, read_said
from vsgdesign.study.parameters.reader import TableReader

_HIGHEST_ORDER = 100.0
_MOST_REFERENCE = 2.0
"""Largest reference over S_rated where a study says nothing: more is rather a wrong unit."""
_MOST_ROWS = 5e6
"""Largest log: about 2 GB for a controller."""


@section
class SimulationSpec:
    """One EMT run."""

    duration: float = number("s", 1e-3, 36000.0)
    """Simulated time."""
    bridge: str = word(("averaged", "pwm"), default="averaged")
    """The bridge produces its reference exactly, or it switches."""
    start: str = word(("steady_state", "cold"), default="steady_state")
    """At rest in the first operating point, or with everything at zero."""
    log_interval: float = number("s", 0.0, 1.0, shown="multiple of T_s nearest to 200 µs")
    """Spacing of the rows that are written and drawn; a multiple of T_s, at most 5 million in all. Figures and verdicts
    come [from every sample](definitions.md#figures-of-a-run) instead."""
    csv_interval: float = number("s", 0.0, 10.0, default=0.002)
    """Spacing of rows in the CSV copy; no figure depends on it."""
    P_ref: float = number("W", -1.0 * MOST_REFERENCE, MOST_REFERENCE)
    """Set point at t = 0."""
    Q_ref: float = number("var", -1.0 * MOST_REFERENCE, MOST_REFERENCE)
    """Set point at t = 0."""
    reference_limit_pu: float = number("1", 0.1, 100.0, default=_MOST_REFERENCE)
    """Largest reference over the rating. More is needed where a droop takes most of it away again."""
    survival: bool = flag(default=False)
    """Also judges the events as one disturbance, as a [grid-code test](survival.md#what-survived-means) does; not with
    `[replay]`, components of the source, a `[background]` that wanders, or `[sensors]` without a distorted one."""
    survival_settling_time: float | None = number("s", 1e-3, 1000.0, default=None)
    """Longest settling time T with which `survival` judges a controller; without it, the controller's own T holds."""
    strict: bool = flag(default=False)
    """Also takes the source's sines and the logarithms of a table's schedule from no library, so that a run has
    [the bits of a page of the explorer](how-to/explore.md#a-page-to-send)."""


class Component:
    """The fields of a component of the source's voltage."""

    order: float = number("1", -_HIGHEST_ORDER, _HIGHEST_ORDER)
    """Frequency over that of the fundamental, negative for a component that turns backwards: −1 is the negative
    sequence. Not 0 and not 1; need not be whole."""
    amplitude_pu: float = number("1", 0.0, 1.0)
    """Amplitude, pu of the rated voltage. It does not change with `V_g_pu`."""
    phase: float = number("rad", -2.0 * math.pi, 2.0 * math.pi, default=0.0)
    """Angle of its space vector where that of the fundamental is zero."""


def read_components(tables: list[TableReader]) -> tuple[SourceComponent, ...]:
    """The negative sequence and the harmonics of the grid source, one table each."""
    found: list[SourceComponent] = []
    for table in tables:
        component = SourceComponent(**values(Component, table))
        order = component.order
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
    limit = values(picked(SimulationSpec, "reference_limit_pu"), table)
    default = math.nan if math.isnan(T_s) else max(round(200e-6 / T_s), 1) * T_s
    scope = scope_of(converter, limit["reference_limit_pu"])
    rest = tuple(one for one in fields_of(SimulationSpec) if one.name not in limit)
    spec = SimulationSpec(**limit, **values(rest, table, scope, {"log_interval": default}))
    log_interval = spec.log_interval
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
    """Load, fault and breaker at the start, of the [network] section, which may have more."""
    if table is None:
        return PLAIN
    said = read_said(table, Base.of(converter))
    for field, ended in (("load", NONE), ("fault", CLEARED)):
        if getattr(said, field) == ended:
            table.fault(field, ended, "there is none before the start", "Leave it out.")
    return said.on(PLAIN)
