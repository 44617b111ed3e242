"""What a controller is held to in random cases, with its limits, and the figures that these limits are about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.metrics.met import most_overshoot, most_settling_time
from vsgdesign.simulation.lanes.cases import REACTIVE
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
    """What is asked for, in the figure's unit."""
    families: tuple[str, ...]
    limit_Q: float | None = None
    """What is asked of a step of Q_ref, where that is another value."""
    survival: bool = False
    """Whether a case that is not survived breaks it, whatever the figure says."""

    @property
    def unit(self) -> str:
        """Unit of the limit."""
        return FIGURES[self.figure]

    @property
    def most(self) -> float:
        """Largest value that keeps it (:mod:`vsgdesign.metrics.met`); of a step of P_ref, where ``limit_Q`` differs."""
        return self._most(self.limit)

    def most_of(self, signal: NDArray[np.int8], noise: Any = 0.0) -> NDArray[np.float64]:
        """Largest value that keeps it in each case, (N,). ``signal``: which reference a case steps; ``noise``: what
        noise may do to its overshoot, as a share of the step."""
        of_Q = self.most if self.limit_Q is None else self._most(self.limit_Q)
        more = np.nan_to_num(noise) if self.figure == "overshoot" else 0.0
        return np.where(np.asarray(signal) == REACTIVE, of_Q, self.most) + more

    def _most(self, limit: float) -> float:
        if self.figure == "settling_s":
            return float(most_settling_time(limit))
        return float(most_overshoot(limit)) if self.figure == "overshoot" else limit


def verified_promises(
    study: Study, spec: ControllerSpec, ready: Ready, families: Mapping[str, bool]
) -> tuple[Promise, ...]:
    """The promises of a controller. ``families``: whether the cases of a family are steps, by its name.

    A step keeps the overshoot and the settling time that the page of a run holds the controller to
    (:func:`vsgdesign.simulation.scenario.promises.promises_of`), by the same rule (:mod:`vsgdesign.metrics.met`). Any
    other case is survived: the converter is at its new rest in 2 T + 0.2 s, as in docs/survival.md. If the current
    is limited, it is at most 5 % above its limit later than 5 ms after an event.
    """
    from vsgdesign.simulation.scenario.promises import promises_of

    steps = tuple(name for name, step in families.items() if step)
    others = tuple(name for name, step in families.items() if not step)
    asked, found = promises_of(study, spec, ready), []
    if steps and asked.overshoot_pct is not None:
        limit, limit_Q = _share(asked.overshoot_pct), _share(asked.overshoot_Q_pct or 0.0)
        differs = None if limit_Q == limit else limit_Q
        found.append(Promise(name="overshoot", figure="overshoot", limit=limit, limit_Q=differs, families=steps))
    if steps and asked.settling_time is not None:
        found.append(Promise(name="settling", figure="settling_s", limit=asked.settling_time, families=steps))
    if others:
        limit = demand_of(study.converter, settling_time_of(spec, ready)).deadline_s
        found.append(Promise(name="survival", figure="recovery_s", limit=limit, families=others, survival=True))
    limit_pu = study.with_limit_of(spec).converter.current_limit_pu
    if limit_pu is not None:
        found.append(Promise(name="current", figure="peak_pu", limit=LIMIT_ROOM * limit_pu, families=tuple(families)))
    return tuple(found)


def _share(pct: float) -> float:
    """A share of a percentage, in twelve digits: an exponential in it may differ in the last one between machines."""
    return float(f"{pct / 100.0:.12g}")
