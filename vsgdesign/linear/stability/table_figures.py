"""The figures that a gain table stores: what they are called, what limits them, and which of them can be computed again
from the file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.artifacts.gain_table import GainTable


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
