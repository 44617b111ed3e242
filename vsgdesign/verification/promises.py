"""What a controller is held to in random cases, with its limits, and the figures that these limits are about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.metrics.survival import SurvivalDemand
from vsgdesign.parameters.study import ControllerSpec, Study

FIGURES = {
    "overshoot": "1",
    "settling_s": "s",
    "recovery_s": "s",
    "peak_pu": "pu",
    "first_peak_pu": "pu",
    "above_s": "s",
    "limited_s": "s",
    "swing_rad": "rad",
}
"""Every figure of a case with its unit, as the batch runner measures them. The overshoot is a share of the step."""

LIMIT_ROOM = 1.05
"""How far the current may be above its limit later than 5 ms after an event: the switched bridge's ripple, and what a
sampled loop overshoots."""


@dataclass(frozen=True, kw_only=True)
class Promise:
    """One limit that a figure has to keep in every case of some families."""

    name: str
    figure: str
    """A name of :data:`FIGURES`."""
    limit: float
    """Largest value that keeps it, in the figure's unit."""
    families: tuple[str, ...]
    survival: bool = False
    """Whether a case that is not survived breaks it, whatever the figure says."""

    @property
    def unit(self) -> str:
        """Unit of the limit."""
        return FIGURES[self.figure]


def settling_time_of(study: Study, spec: ControllerSpec, table: GainTable | None) -> float:
    """T, s: that of the table's specification, else of the study's, else of the closed form."""
    if table is not None and "settling_time" in table.specification:
        return float(table.specification["settling_time"])
    if study.specification is not None and study.specification.settles:
        return study.specification.settling_time
    return spec.target.settling_time


def promises_of(
    study: Study, spec: ControllerSpec, table: GainTable | None, families: Mapping[str, bool]
) -> tuple[Promise, ...]:
    """The promises of a controller. ``families``: whether the cases of a family are steps, by its name.

    A step keeps the overshoot and the settling time that the specification of the table or of the study asks for. Any
    case is survived: the converter is at its new rest in 2 T + 0.2 s, as in docs/survival.md. If the current is
    limited, it is at most 5 % above its limit later than 5 ms after an event.
    """
    steps = tuple(name for name, step in families.items() if step)
    every = tuple(families)
    found = []
    asked = _asked(study, table)
    if steps and "overshoot" in asked:
        found.append(Promise(name="overshoot", figure="overshoot", limit=asked["overshoot"], families=steps))
    if steps and "settling_time" in asked:
        found.append(Promise(name="settling", figure="settling_s", limit=asked["settling_time"], families=steps))
    demand = SurvivalDemand(
        S_rated=study.converter.S_rated,
        settling_time=settling_time_of(study, spec, table),
        cycle_s=0.0,
        i_max_pu=None,
    )
    found.append(Promise(name="survival", figure="recovery_s", limit=demand.deadline_s, families=every, survival=True))
    limit_pu = study.with_limit_of(spec).converter.current_limit_pu
    if limit_pu is not None:
        found.append(Promise(name="current", figure="peak_pu", limit=LIMIT_ROOM * limit_pu, families=every))
    return tuple(found)


def _asked(study: Study, table: GainTable | None) -> dict[str, float]:
    """Overshoot and settling time of the specification; empty where it holds the inertia instead."""
    if table is not None:
        asked = table.specification
        if asked.get("aim", "settling") != "settling":
            return {}
        return {name: float(asked[name]) for name in ("overshoot", "settling_time") if asked.get(name) is not None}
    if study.specification is None or not study.specification.settles:
        return {}
    return {"overshoot": study.specification.overshoot, "settling_time": study.specification.settling_time}
