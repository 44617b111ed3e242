"""Threshold virtual impedance: above a threshold the current sees an impedance that grows with it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import ControllerSettings
from vsgdesign.equations.inner_loops import limit_length
from vsgdesign.equations.integration import low_pass_share
from vsgdesign.equations.limiter_interface import (
    GridEstimate,
    IntegratorSteps,
    LimitedSample,
    Limiter,
    LimiterLaw,
    LimiterParameter,
    LimiterRatings,
    LimiterView,
    Rule,
    always,
)
from vsgdesign.equations.power_loops import PowerLoopGains, References


class ThresholdMemory(NamedTuple):
    """Grid current behind its low-pass, A peak."""

    i_d: Any
    i_q: Any


class ThresholdConstants(NamedTuple):
    """Constants of the limiter."""

    smoothing: Any
    """1 − exp(−T_s/τ) of the current's low-pass; 1 means no filter."""

    i_threshold_pk: Any
    """A peak."""
    R_per_A: Any
    X_per_A: Any
    """Impedance per current above the threshold, Ω/A."""


def threshold_impedance_limit(
    memory: ThresholdMemory,
    view: LimiterView,
    grid: GridEstimate,
    refs: References,
    gains: PowerLoopGains,
    settings: ControllerSettings,
) -> LimitedSample:
    """Subtracts the drop across the impedance from the voltage error, and limits what is left by the circle
    (:eq:`threshold-impedance`)."""
    c = settings.limiter
    i_d = memory.i_d + c.smoothing * (view.i_g_d - memory.i_d)
    i_q = memory.i_q + c.smoothing * (view.i_g_q - memory.i_q)
    length_sq = i_d * i_d + i_q * i_q
    threshold_sq = c.i_threshold_pk * c.i_threshold_pk
    above = 1.0 * (length_sq > threshold_sq)
    excess = above * (np.sqrt(np.maximum(length_sq, threshold_sq)) - c.i_threshold_pk)
    drop_d = excess * (c.R_per_A * i_d - c.X_per_A * i_q)
    drop_q = excess * (c.R_per_A * i_q + c.X_per_A * i_d)
    want_d = view.i_want_d - view.K_pv * drop_d
    want_q = view.i_want_q - view.K_pv * drop_q
    i_ref_d, i_ref_q = limit_length(want_d, want_q, settings.i_max_pk)
    cut = 1.0 * (want_d * want_d + want_q * want_q > settings.i_max_pk * settings.i_max_pk)
    # The integrators also take up i_ref - i_want, and the drop is in it.
    return LimitedSample(
        i_ref_d=i_ref_d,
        i_ref_q=i_ref_q,
        e_d=view.e_d,
        e_q=view.e_q,
        P=view.P,
        Q=view.Q,
        limited=np.maximum(above, cut),
        notes=ThresholdMemory(i_d=i_d, i_q=i_q),
    )


def threshold_impedance_move(
    memory: ThresholdMemory,
    sample: LimitedSample,
    view: LimiterView,
    omega: Any,
    steps: IntegratorSteps,
    settings: ControllerSettings,
) -> Any:
    """Returns the steps that the power loops ask for, and the filtered current."""
    return steps, ThresholdMemory(i_d=sample.notes.i_d, i_q=sample.notes.i_q)


def threshold_at_rest(view: LimiterView, omega: Any, settings: ControllerSettings) -> ThresholdMemory:
    """The memory of a steady state. Returns (memory)."""
    return ThresholdMemory(i_d=view.i_g_d, i_q=view.i_g_q)


def threshold_constants(ratings: LimiterRatings, values: Mapping[str, float]) -> ThresholdConstants:
    """The impedance with which the given voltage drops at the limit of the current."""
    i_threshold_pk, ratio = values["threshold_pu"] * ratings.I_rated_pk, values["impedance_x_over_r"]
    drop_pk = values["drop_at_limit_pu"] * ratings.V_rated_pk
    per_A = drop_pk / ((ratings.i_max_pk - i_threshold_pk) * ratings.i_max_pk * math.hypot(1.0, ratio))
    return ThresholdConstants(
        smoothing=low_pass_share(values["impedance_filter_time"], ratings.T_s),
        i_threshold_pk=i_threshold_pk,
        R_per_A=per_A,
        X_per_A=ratio * per_A,
    )


THRESHOLD_IMPEDANCE = Limiter(
    "threshold_impedance",
    LimiterLaw(threshold_impedance_limit, threshold_impedance_move),
    threshold_constants,
    threshold_at_rest,
    parameters=(
        LimiterParameter(
            "threshold_pu",
            "1",
            low=Rule(lambda known: 0.3 * known.ratings.limit_pu, "0.3 I_max"),
            high=Rule(lambda known: 0.95 * known.ratings.limit_pu, "0.95 I_max"),
            default=Rule(lambda known: known.ratings.limit_pu / 1.2, "I_max/1.2"),
            meaning="current above which the impedance acts, pu of the rated peak",
        ),
        LimiterParameter(
            "drop_at_limit_pu",
            "1",
            low=always(0.02),
            high=always(1.5),
            default=always(1.0),
            meaning="voltage across the impedance at I_max, pu",
        ),
        LimiterParameter(
            "impedance_x_over_r",
            "1",
            low=always(0.0),
            high=always(50.0),
            default=always(5.0),
            meaning="X/R of the impedance",
        ),
        LimiterParameter(
            "impedance_filter_time",
            "s",
            low=always(0.0),
            high=always(0.05),
            default=always(5e-3),
            meaning="time constant of the low-pass of the current that sees the impedance; 0 means no filter",
        ),
    ),
)
"""The virtual impedance of the literature, with the circular limit behind it."""
