"""The kinds of disturbance of [verification], with their weights and the ranges that are drawn from."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.fields import F_N, Field, drawn, fields_of, number, subtable
from vsgdesign.study.parameters.ranges import Range

_LIMITED, _SIXTY = "1 with `projection`, else 0", (0.0, math.radians(60.0))


def _weight(shown: str) -> Any:
    return number("1", 0.0, 1e6, default=None, shown=shown)


class _Step:
    """Small steps of a reference."""

    weight: float | None = _weight("1 always")
    """Weight among all disturbances."""
    size: Range = drawn("1", 1e-4, 1.0, default=(0.05, 0.05), shown="5 %")
    """Of S_rated."""


class _Grid:
    """Jumps to another grid."""

    weight: float | None = _weight("1 always")
    """Weight among all disturbances."""
    phase: Range | None = drawn("rad", 0.0, math.pi, default=None, shown="0 to 30° with `projection`, else 0")
    """Jump of the source's phase at the same instant."""


class _Phase:
    """Jumps of the phase."""

    weight: float | None = _weight(_LIMITED)
    """Weight among all disturbances."""
    jump: Range = drawn("rad", 0.0, math.pi, default=_SIXTY)
    """Jump of the source's phase."""


class _Sag:
    """Sags of the voltage."""

    weight: float | None = _weight(_LIMITED)
    """Weight among all disturbances."""
    depth: Range = drawn("1", 0.0, 1.0, default=(0.2, 1.0))
    """Lost share of the source voltage."""
    duration: Range = drawn("s", 0.01, 10.0, default=(0.05, 1.0), logarithmic=True)
    """Length, uniform in its logarithm."""
    phase: Range = drawn("rad", 0.0, math.pi, default=_SIXTY)
    """Jump of the source's phase at the beginning, which goes back at the end."""


class _Ramp:
    """Ramps of the frequency."""

    weight: float | None = _weight("never")
    """Weight among all disturbances."""
    size: Range = drawn("Hz", 1e-3, 0.1 * F_N, default=(0.1, 1.0))
    """By how much."""
    rate: Range = drawn("Hz/s", 1e-2, 100.0, default=(0.5, 4.0), logarithmic=True)
    """How fast, uniform in its logarithm."""
    hold: Range = drawn("s", 0.0, 10.0, default=(0.0, 1.0))
    """How long it stays."""


class _Reference:
    """Large steps of P_ref."""

    weight: float | None = _weight("never")
    """Weight among all disturbances."""


class _Loss:
    """Losses of one unit of a plant."""

    weight: float | None = _weight("1 in a plant of several units, else never")
    """Weight among all disturbances."""


class _Stepped:
    """Steps of a quantity by a size, up or down (:class:`vsgdesign.study.parameters.event_kinds.StepOfKind`)."""

    weight: float | None = _weight("never")
    """Weight among all disturbances."""
    size: Range = drawn("1", 1e-4, 1e3)
    """By how much, pu."""


class _Families:
    """The kinds of disturbance. Where a weight or a range has no default, the current limiter decides."""

    step: Any = subtable(_Step, shown="as below")
    """Small steps of a reference."""
    grid: Any = subtable(_Grid, shown="as below")
    """Jumps to another grid."""
    phase: Any = subtable(_Phase, shown="as below")
    """Jumps of the phase."""
    sag: Any = subtable(_Sag, shown="as below")
    """Sags of the voltage."""
    ramp: Any = subtable(_Ramp, shown="as below")
    """Ramps of the frequency."""
    reference: Any = subtable(_Reference, shown="as below")
    """Large steps of P_ref."""


FAMILIES = tuple(one.name for one in fields_of(_Families))
"""The kinds of disturbance, in the order of their numbers. Those that kinds of events add follow (:func:`families`)."""


LOSS = "loss"
"""The family that a plant has besides those of one converter; the last one of all."""


def families() -> tuple[str, ...]:
    """The names of all kinds of disturbance, in the order of their numbers."""
    return (*FAMILIES, *EVENT_KINDS.steps, LOSS)


def family_fields() -> tuple[Field, ...]:
    """A table for each kind of disturbance, in the order of :func:`families`."""
    weight, size = fields_of(_Stepped)
    steps = {step.name: step for _, step in EVENT_KINDS.steps.values()}
    of = {
        name: (
            weight,
            replace(
                size,
                unit="1" if step.unit == "pu" else step.unit,
                low=0.0 if step.new else size.low,
                high=step.most,
                default=step.size,
                home=None if step.new else size.home,
                explained="The new value." if step.new else size.explained,
            ),
        )
        for name, step in steps.items()
    }
    more = (
        Field(kind="table", name=name, of=of[name], default=None, shown="as below", explained=f"{steps[name].title}.")
        for name in steps
    )
    loss = Field(
        kind="table",
        name=LOSS,
        of=fields_of(_Loss),
        default=None,
        shown="as below",
        explained="Losses of one unit of a plant.",
    )
    return (*fields_of(_Families), *more, loss)
