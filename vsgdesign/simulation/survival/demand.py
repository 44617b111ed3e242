"""What a disturbance asks of a converter: by when it must be at rest, and below which current."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from vsgdesign.artifacts.ready import Ready
from vsgdesign.metrics.survival import GRACE_S, SETTLING_TIMES, SurvivalDemand
from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.study import ControllerSpec

SETTLING_TIMES_FOR_EVER = 3.0
"""The deadline in settling times for a schedule that stays stale for ever (:func:`settling_times_asked`)."""


def settling_time_of(spec: ControllerSpec, ready: Ready) -> float:
    """T of a controller: that of its table's specification, or of its closed form, s."""
    table = ready.table(spec)
    if table is not None and "settling_time" in table.specification:
        return float(table.specification["settling_time"])
    return spec.target.settling_time


def silent_s_of(spec: ControllerSpec) -> float:
    """For how long a controller is told nothing after a change of the grid, s; 0 where it is told at once or finds the
    grid by itself."""
    return 0.0 if spec.knowledge is None else spec.knowledge.silent_s


def settling_times_asked(silent_s: Any, settling_time: float) -> Any:
    """The deadline in settling times T (s) for a schedule that is silent for ``silent_s`` after a change; an array or a
    number.

    A schedule that is silent until after the longest deadline, 3 T + 0.2 s, stays stale for ever as far as a run can
    tell, and has this deadline. All others have 2 T + 0.2 s.
    """
    for_ever = np.asarray(silent_s) >= SETTLING_TIMES_FOR_EVER * settling_time + GRACE_S
    return np.where(for_ever, SETTLING_TIMES_FOR_EVER, SETTLING_TIMES)


def demand_of(
    converter: Converter,
    settling_time: float,
    *,
    silent_s: float = 0.0,
    limit_pu: float | None = None,
    cycle_s: float | None = None,
) -> SurvivalDemand:
    """What is asked of a converter whose power loops have the settling time T (s).

    ``silent_s``: for how long its schedule is told nothing after a change, s, which decides the deadline. ``limit_pu``:
    limit of its current; None: the converter's own. ``cycle_s``: period of the grid at the end, s; None: nominal.
    """
    return SurvivalDemand(
        S_rated=converter.S_rated,
        settling_time=settling_time,
        cycle_s=2.0 * math.pi / converter.omega_n if cycle_s is None else cycle_s,
        i_max_pu=converter.current_limit_pu if limit_pu is None else limit_pu,
        settling_times=float(settling_times_asked(silent_s, settling_time)),
    )
