"""Traces made of signals in closed form, for the tests of the measures."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.measures import MeasureInput, Ratings
from vsgdesign.campaigns.compliance.measuring import Trace
from vsgdesign.campaigns.compliance.suite import OURS, Source, SuiteTest
from vsgdesign.study.parameters.event import Event

Array = NDArray[np.float64]

STEP_S = 5e-4
SOURCE = Source(document="test", edition="1", confidence=OURS)


def made_trace(t: Array, f_n: float = 50.0, **signals: Any) -> Trace:
    """A trace at rest at P = 0.5 with the given signals, scalars or arrays."""
    angle = 2.0 * math.pi * f_n * t
    rest = {
        "P_pu": 0.5,
        "Q_pu": 0.0,
        "f_hz": f_n,
        "V_pu": 1.0,
        "delta_rad": 0.1,
        "i_s_pu": 0.5,
        "i_phase_pu": 0.5,
        "v_alpha_pu": np.cos(angle),
        "v_beta_pu": np.sin(angle),
        "i_g_alpha_pu": 0.5 * np.cos(angle),
        "i_g_beta_pu": 0.5 * np.sin(angle),
        "P_dc_pu": 0.5,
        "v_dc_pu": 1.0,
        "limited": 0.0,
    }
    return Trace(t_s=t, **{name: np.broadcast_to(value, t.shape) for name, value in (rest | signals).items()})


def made_run(trace: Trace, *events: Event, f_n: float = 50.0, limit: float | None = 1.2, **more: Any) -> MeasureInput:
    """A run of a test with these events."""
    test = SuiteTest(id="made", group="made", title="made", source=SOURCE, scr=5.0, x_over_r=10.0, events=events)
    ratings = Ratings(S_rated=5e3, V_rated_rms=110.0, f_n_hz=f_n, i_limit_pu=limit)
    return MeasureInput(test=test, trace=trace, ratings=ratings, **more)


def times(end_s: float, begin_s: float = 0.0, step_s: float = STEP_S) -> Array:
    """Equally spaced instants, the end excluded."""
    return begin_s + step_s * np.arange(round((end_s - begin_s) / step_s), dtype=np.float64)
