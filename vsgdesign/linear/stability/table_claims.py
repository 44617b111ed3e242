"""What a gain table says of itself, against itself: its box, status, worst figures, causes and counts.

:data:`FIGURES` are the figures that it stores: what they are called, what limits them, and which of them can be
computed again from the file. Nothing is simulated or designed here. A sentence names the field and both values.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.artifacts.design_inputs import contradictions
from vsgdesign.artifacts.gain_table import GainTable, fill_outside
from vsgdesign.artifacts.guarded_file import is_number
from vsgdesign.artifacts.table_text import CAUSES
from vsgdesign.metrics.met import most_overshoot, most_settling_time


@dataclass(frozen=True)
class Figure:
    """What is known of a margin that a table stores: how it is called, judged, and compared with a new computation."""

    title: str
    unit: str
    tolerance: float = 0.0
    """How well a stored value must agree with the reduced model, in the unit."""
    relative: bool = False
    """Whether the tolerance is of the value instead."""
    smaller_is_better: bool = False
    asked: str = ""
    """Key of the specification that limits it; empty where none does."""
    factor: float = 1.0
    """From the specification's unit to this one."""
    of_step: bool = False
    """Whether it is read from a step response: computed on demand, and no promise where the law is inertia."""
    is_time: bool = False
    """Whether it is drawn from its least value on, instead of from zero."""
    at_design_point: bool = True
    """Whether there is a value at the design point beside the worst of the box."""


_OVERSHOOT: dict[str, Any] = {"smaller_is_better": True, "asked": "overshoot", "factor": 100.0, "of_step": True}
_SETTLING: dict[str, Any] = {"smaller_is_better": True, "asked": "settling_time", "of_step": True, "is_time": True}


def _defined(name: str, tolerance: float, **more: Any) -> Figure:
    one = DEFINITIONS[name]
    return Figure(one.heading, one.unit, tolerance, **more)


FIGURES = {
    "overshoot_P_pct": Figure("Overshoot of P", "%", 0.1, **_OVERSHOOT),
    "settling_P_s": Figure("2 % settling of P", "s", 0.01, relative=True, **_SETTLING),
    "overshoot_Q_pct": Figure("Overshoot of Q", "%", 0.1, **_OVERSHOOT),
    "settling_Q_s": Figure("2 % settling of Q", "s", 0.01, relative=True, **_SETTLING),
    "disk_margin_output": _defined("disk_margin_output", 0.02, asked="disk_margin"),
    "disk_margin_input": _defined("disk_margin_input", 0.02),
    "damping_power_loops": _defined("damping_power_loops", 0.005, asked="damping_ratio"),
    "decay_1_s": Figure("Decay of the slowest mode", "1/s", 0.01, relative=True),
    "H_s": Figure("Inertia constant", "s", 1e-3, relative=True),
}
"""Margins by name."""
OF_BEFORE = {"disk_margin_smaller": _defined("disk_margin_smaller", 0.02)}
"""Margins that only files of earlier versions have."""

OF_THE_DESIGN = {
    "cross_peak": Figure("Peak of the other power per step", "1"),
    "full_order_decay_1_s": Figure("Decay of the slowest mode, full order", "1/s", at_design_point=False),
    "differential_decay_1_s": Figure(
        "Decay of the differential mode", "1/s", asked="differential_decay", at_design_point=False
    ),
    "scenarios": Figure("Scenarios of the design", "1", at_design_point=False),
}
"""Margins that a design stores as well, over its whole box, and that no check computes again."""

WORST = "worst_"
"""A name with this prefix is the worst value over the specification's box."""


def figure_of(name: str) -> Figure:
    """What is known of a margin; a name that is not known is its own title."""
    named = FIGURES | OF_BEFORE | OF_THE_DESIGN
    if name.startswith(WORST) and name[len(WORST) :] in named:
        known = named[name[len(WORST) :]]
        return replace(known, title=f"{known.title}, worst of the box")
    return named.get(name, Figure(name, "1"))


def limit_of(table: GainTable, name: str) -> float | None:
    """The limit that the specification sets for a margin, in the margin's unit; None if it sets none."""
    figure = figure_of(name)
    value = table.specification.get(figure.asked)
    if table.law == "inertia" and figure.of_step:
        return None  # with this law the settling time is a time scale, no promise
    return (
        figure.factor * value
        if isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0
        else None
    )


CARRIED = "carried, not checked"
"""What is said of a figure in a file that no check computes again."""


def is_carried(name: str) -> bool:
    """Whether a margin is only carried by the file: :func:`~vsgdesign.linear.stability.gain_table.check_table` does not
    compute it again."""
    return name not in FIGURES | OF_BEFORE


_SLACK = 1e-6
"""Relative: the design compares exactly, a file has the same numbers."""
_EXPLAINED = 40
"""Relaxed cells up to which a build names the cause of each (:mod:`vsgdesign.design.table`)."""

_SMALLER = ("settling_time", "overshoot")
_LIMITED = (*_SMALLER, "disk_margin", "damping_ratio")
"""Fields of a specification that limit a figure; the first ones from above."""


def claim_faults(table: GainTable) -> Iterator[str]:
    """Where a table contradicts itself, one sentence each."""
    yield from contradictions(table)
    yield from _box_faults(table)
    yield from _figure_faults(table)
    yield from _worst_faults(table)
    yield from _met_faults(table)
    yield from _relaxed_faults(table)
    yield from _outside_faults(table)
    yield from _between_faults(table)
    yield from _cause_faults(table)


def where(table: GainTable, cells: NDArray[np.bool_]) -> tuple[tuple[int, int], str]:
    """The first of some cells, and its place in words with how many more there are."""
    i, j = (int(k) for k in np.argwhere(cells)[0])
    rest = int(cells.sum()) - 1
    more = f" and {rest} more cell{'s' if rest > 1 else ''}" if rest else ""
    return (i, j), f"at SCR {table.scr[i]:g}, X/R {table.x_over_r[j]:g}{more}"


def shown(value: float) -> str:
    """A figure with enough digits to tell it from its neighbour."""
    return f"{value:.6g}"


def _box_faults(table: GainTable) -> Iterator[str]:
    for name in ("scr", "x_over_r"):
        box, axis = getattr(table.validity, name), getattr(table, name)
        if box[0] < axis[0] * (1.0 - _SLACK) or box[1] > axis[-1] * (1.0 + _SLACK):
            yield f"validity.{name} is {box[0]:g} to {box[1]:g}, beyond the axis {name}, {axis[0]:g} to {axis[-1]:g}"


def _figure_faults(table: GainTable) -> Iterator[str]:
    for name, values in (("price", table.price), *_of(table, "worst_cross_peak")):
        if (bad := table.valid & (values < 0.0)).any():
            at, place = where(table, bad)
            yield f"{name} is {shown(values[at])} {place}, must be at least 0"
    for name, values in _of(table, "scenarios"):
        if (bad := table.valid & np.isfinite(values) & ((values < 1.0) | (values != np.round(values)))).any():
            at, place = where(table, bad)
            yield f"{name} is {shown(values[at])} {place}, must be a whole number of at least 1"


def _of(table: GainTable, name: str) -> list[tuple[str, Any]]:
    return [(f"margins.{name}", table.figures[name])] if name in table.figures else []


def _worst_faults(table: GainTable) -> Iterator[str]:
    """The design point on the exact grid is one of the places of which the worst is taken."""
    figures = table.figures
    for name, nominal in figures.items():
        if WORST + name not in figures:
            continue
        worst, figure = figures[WORST + name], figure_of(name)
        better = nominal - worst if figure.smaller_is_better else worst - nominal
        allowed = figure.tolerance * np.abs(nominal) if figure.relative else figure.tolerance
        if (bad := table.valid & (better > allowed)).any():
            at, place = where(table, bad)
            yield (
                f"margins.{WORST}{name} is {shown(worst[at])} {place}, better than {shown(nominal[at])} of "
                f"margins.{name} at the design point"
            )


def _judged(table: GainTable) -> Iterator[tuple[str, Any, float, Any]]:
    """Each figure that the specification limits: its name, its values, the limit, and where it is beyond."""
    figures = table.figures
    for name, figure in FIGURES.items():
        limit = limit_of(table, name)
        key = WORST + name if WORST + name in figures else name
        if limit is None or key not in figures:
            continue
        values = figures[key]
        smaller = figure.smaller_is_better
        kept = values <= _most(figure.asked, limit, figure.factor) if smaller else values >= limit * (1.0 - _SLACK)
        yield key, values, limit, ~kept


def _most(asked: str, limit: float, factor: float = 1.0) -> float:
    """The largest value that keeps the limit of a field of the specification. ``factor``: the limit over the field."""
    if asked == "settling_time":
        return float(most_settling_time(limit))
    return factor * float(most_overshoot(limit / factor)) if asked == "overshoot" else limit * (1.0 + _SLACK)


def _met_faults(table: GainTable) -> Iterator[str]:
    met = table.status == "met"
    for name, values, limit, beyond in _judged(table):
        if (bad := met & beyond & (np.isfinite(values) | name.startswith(WORST))).any():
            at, place = where(table, bad)
            value = f"is {shown(values[at])}" if np.isfinite(values[at]) else "is not known"
            yield f"status is met {place}, but margins.{name} {value} and the specification asks for {limit:g}"
    for name, values in _of(table, "full_order_decay_1_s"):
        if (bad := met & (values <= 0.0)).any():
            at, place = where(table, bad)
            yield f"status is met {place}, but margins.{name} is {shown(values[at])} 1/s: it is unstable"
    if (bad := met & (np.char.find(table.active, "→") >= 0)).any():
        at, place = where(table, bad)
        yield f'status is met {place}, but active says what it misses: "{table.active[at]}"'


def _relaxed_faults(table: GainTable) -> Iterator[str]:
    """A relaxed cell of a designed table misses a promise, or its cause says what between the nodes does."""
    relaxed = table.status == "relaxed"
    judged = list(_judged(table))
    worst = [name for name, *_ in judged if name.startswith(WORST)]
    if not table.design_inputs or not worst or (relaxed.sum() > _EXPLAINED and table.causes):
        return
    missing = np.any([beyond for *_, beyond in judged], axis=0) | (np.char.find(table.active, "→") >= 0)
    named = [(cause["scr"], cause["x_over_r"]) for cause in table.causes]
    explained = np.array([[(s, x) in named for x in table.x_over_r] for s in table.scr])
    if (bad := relaxed & ~missing & ~explained).any():
        at, place = where(table, bad)
        found = ", ".join(f"{name} {shown(values[at])}" for name, values, *_ in judged)
        yield f"status is relaxed {place}, but every promise is kept there ({found}) and causes names no reason"


def _outside_faults(table: GainTable) -> Iterator[str]:
    for name, values in (*table.gains._asdict().items(), *table.figures.items()):
        if (bad := ~table.valid & np.isfinite(values)).any():
            at, place = where(table, bad)
            yield f"status is outside {place}, but {name} has the value {shown(values[at])} there"
            break
    for name, values in table.columns.items():
        made = fill_outside(values, table.valid)
        if (bad := values != made).any():
            at, place = where(table, bad)
            yield (
                f"columns.{name} is {shown(values[at])} {place}, outside: its nearest designed cell has "
                f"{shown(made[at])}"
            )


def _between_faults(table: GainTable) -> Iterator[str]:
    look = table.between
    if look is None:
        return
    met, judged = table.status == "met", look["points"] - look["outside"]
    if met.all() and look["promised"] != judged:
        yield f"between.promised is {look['promised']}, all cells are met and {judged} grids were judged"
    if not met.any() and look["promised"]:
        yield f"between.promised is {look['promised']}, but no cell is met"
    for k, place in enumerate(look["broken"]):
        for name in ("scr", "x_over_r"):
            axis, value = getattr(table, name), place[name]
            if not axis[0] * (1.0 - _SLACK) <= value <= axis[-1] * (1.0 + _SLACK):
                yield f"between.broken[{k}].{name} is {value:g}, the axis has {axis[0]:g} to {axis[-1]:g}"


def _cause_faults(table: GainTable) -> Iterator[str]:
    nodes = list(itertools.product(table.scr.tolist(), table.x_over_r.tolist()))
    places = [(cause["scr"], cause["x_over_r"]) for cause in table.causes]
    for k, cause in enumerate(table.causes):
        name, at = f"causes[{k}]", places[k]
        if cause["cause"] not in CAUSES:
            yield f'{name}.cause is "{cause["cause"]}", must be one of {", ".join(CAUSES)}'
        if at not in nodes:
            yield f"{name} is about SCR {at[0]:g}, X/R {at[1]:g}, which is no node of the table"
        elif (status := table.status.ravel()[nodes.index(at)]) != "relaxed":
            yield f"{name} is about SCR {at[0]:g}, X/R {at[1]:g}, whose status is {status} and not relaxed"
        if at in places[:k]:
            yield f"{name} is about SCR {at[0]:g}, X/R {at[1]:g} again"
        yield from _missed_faults(table.specification, cause, name)


def _missed_faults(asked: Mapping[str, Any], cause: Mapping[str, Any], name: str) -> Iterator[str]:
    """What is missed is beyond the specification, and what is kept without the cause is within it."""
    for part, says, within in (("missed", "is missed", False), ("keeps", "is kept without the cause", True)):
        for key, value in (cause[part] or {}).items():
            limit = asked.get(key)
            if key not in _LIMITED or not is_number(limit) or not is_number(value):
                continue
            larger, smaller = value > _most(key, limit), value < limit * (1.0 - _SLACK)
            if (larger if key in _SMALLER else smaller) is within:
                yield f"{name}.{part}.{key} {says} with {shown(value)}, but the specification asks for {limit:g}"
