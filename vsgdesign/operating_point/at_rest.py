"""Steady state of a converter whose gains follow its measurements. Steady state and gains are found together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.operating_point.many import NO_GAINS, NOT_CONVERGED, Lanes
from vsgdesign.operating_point.many_rests import many_rests_with_measured_gains
from vsgdesign.operating_point.plant import TwoAxisCircuit
from vsgdesign.operating_point.sampled import SampledState, fault_of_rest, state_of_lane
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.source import GridSource
from vsgdesign.parameters.study import Study

Array = NDArray[np.float64]
GainsOfMeasured = Callable[[float, float, float], PowerLoopGains]
"""Function of P (W), Q (var) and V (phase rms, V) at the control point that returns gains, or NaN if there are none."""


def rest_with_measured_gains(
    study: Study,
    grid: Grid,
    source: GridSource,
    refs: References,
    gains_of: GainsOfMeasured,
    phase: float = 0.0,
    circuit: TwoAxisCircuit | None = None,
) -> tuple[SampledState, PowerLoopGains]:
    """The steady state with the gains that belong to its own P, Q and V, and these gains.

    If the droops do not depend on the measured values, the first result is the final one. Otherwise gains and steady
    state are computed in turn until they agree to 1e-10. ``circuit`` as in
    :func:`vsgdesign.operating_point.sampled.steady_state`. Raises InfeasibleStudyError if there is no steady state, if
    there are no gains in it, or if the iteration does not converge.
    """

    def of_many(P: Array, Q: Array, V: Array) -> PowerLoopGains:
        return PowerLoopGains(*(np.array([value]) for value in gains_of(float(P[0]), float(Q[0]), float(V[0]))))

    states, found = many_rests_with_measured_gains(study, Lanes.at(grid, source, refs), of_many, phase, circuit=circuit)
    gains = PowerLoopGains(*(float(value[0]) for value in found))
    fault = states.fault[0]
    if fault == NO_GAINS:
        raise InfeasibleStudyError(
            f"no gains: R_g = {grid.R_g:.4g} Ω, L_g = {grid.L_g * 1e3:.4g} mH is not in the "
            "schedule. Leave this grid out, or take a schedule that contains it."
        )
    if fault == NOT_CONVERGED:
        raise InfeasibleStudyError(
            "no steady state: the gains follow the measured powers and do not come to rest. Ask for other "
            "references, or start cold."
        )
    if fault:
        raise fault_of_rest(study, grid, source, refs, gains, states, loaded=circuit is not None)
    return state_of_lane(states, 0), gains
