"""Where a converter rests when its gains follow what it measures: the steady state and the gains, together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.operating_point.sampled import SampledState, steady_state
from vsgdesign.parameters.study import Grid, GridSource, Study

GainsOfMeasured = Callable[[float, float, float], PowerLoopGains]
"""P (W), Q (var) and V (phase rms, V) at the control point to gains; NaN where there are none."""

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
    """The steady state under gains that are those of its own P, Q and V, and these gains.

    Where the droops do not depend on the measured values the first answer is the last; else gains and steady state are
    asked for in turn until they agree to 1e-10. Raises InfeasibleStudyError where there is no steady state, no gains
    there, or no agreement.
    """
    gains = gains_of(P_ref, Q_ref, study.converter.V_rated_rms)
    for _ in range(_ROUNDS):
        if not np.isfinite(gains).all():
            raise InfeasibleStudyError(
                f"no gains: R_g = {grid.R_g:.4g} Ω, L_g = {grid.L_g * 1e3:.4g} mH is no place of the "
                "schedule. Leave this grid out, or take a schedule that knows it."
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
