"""What a controller is held to in random cases, with its limits, and the figures that these limits are about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vsgdesign.artifacts.ready import Ready
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.simulation.survival.demand import demand_of, settling_time_of
from vsgdesign.study.parameters.study import ControllerSpec, Study

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


def verified_promises(
    study: Study, spec: ControllerSpec, ready: Ready, families: Mapping[str, bool]
) -> tuple[Promise, ...]:
    """The promises of a controller. ``families``: whether the cases of a family are steps, by its name.

    A step keeps the overshoot and the settling time that the page of a run holds the controller to
    (:func:`vsgdesign.simulation.scenario.promises.promises_of`); an overshoot within the 2 % band counts as none.
    Any other case is survived: the converter is at its new rest in 2 T + 0.2 s, as in docs/survival.md. If the current
    is limited, it is at most 5 % above its limit later than 5 ms after an event.
    """
    from vsgdesign.simulation.scenario.promises import promises_of

    steps = tuple(name for name, step in families.items() if step)
    others = tuple(name for name, step in families.items() if not step)
    asked, found = promises_of(study, spec, ready), []
    overshoots = [pct for pct in (asked.overshoot_pct, asked.overshoot_Q_pct) if pct is not None]
    if steps and overshoots:
        # Twelve digits: the exponential in it may differ in the last one from one machine to the next.
        limit = float(f"{max(max(overshoots) / 100.0, SETTLING_BAND):.12g}")
        found.append(Promise(name="overshoot", figure="overshoot", limit=limit, families=steps))
    if steps and asked.settling_time is not None:
        found.append(Promise(name="settling", figure="settling_s", limit=asked.settling_time, families=steps))
    if others:
        limit = demand_of(study.converter, settling_time_of(spec, ready)).deadline_s
        found.append(Promise(name="survival", figure="recovery_s", limit=limit, families=others, survival=True))
    limit_pu = study.with_limit_of(spec).converter.current_limit_pu
    if limit_pu is not None:
        found.append(Promise(name="current", figure="peak_pu", limit=LIMIT_ROOM * limit_pu, families=tuple(families)))
    return tuple(found)
