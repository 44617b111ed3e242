"""Steady state of a converter whose gains follow its measurements. Steady state and gains are found together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.operating_point.sampled import SampledState, steady_state
from vsgdesign.parameters.study import Grid, GridSource, Study

GainsOfMeasured = Callable[[float, float, float], PowerLoopGains]
"""Function of P (W), Q (var) and V (phase rms, V) at the control point that returns gains, or NaN if there are none."""

_ROUNDS = 100
_TOLERANCE = 1e-10


def rest_with_measured_gains(
    study: Study,
    grid: Grid,
    source: GridSource,
    P_ref: float,
    Q_ref: float,
    gains_of: GainsOfMeasured,
    phase: float = 0.0,
) -> tuple[SampledState, PowerLoopGains]:
    """The steady state with the gains that belong to its own P, Q and V, and these gains.

    If the droops do not depend on the measured values, the first result is the final one. Otherwise gains and steady
    state are computed in turn until they agree to 1e-10. Raises InfeasibleStudyError if there is no steady state, if
    there are no gains in it, or if the iteration does not converge.
    """
    gains = gains_of(P_ref, Q_ref, study.converter.V_rated_rms)
    for _ in range(_ROUNDS):
        if not np.isfinite(gains).all():
            raise InfeasibleStudyError(
                f"no gains: R_g = {grid.R_g:.4g} Ω, L_g = {grid.L_g * 1e3:.4g} mH is not in the "
                "schedule. Leave this grid out, or take a schedule that contains it."
            )
        state = steady_state(study, grid, source, P_ref, Q_ref, gains, phase)
        before, at = gains, state.controller
        gains = gains_of(at.P_f, at.Q_f, at.V)
        scale = np.abs(before) + np.abs(gains)
        if np.all(np.abs(np.subtract(gains, before)) <= _TOLERANCE * scale):
            return state, before
    raise InfeasibleStudyError(
        "no steady state: the gains follow the measured powers and do not come to rest. Ask for other "
        "references, or start cold."
    )
