"""Steady states of many sampled converters whose gains follow their own measured powers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.dc_control import RestCurve
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.many import (
    NO_GAINS,
    NO_POINT,
    NOT_CONVERGED,
    Lanes,
    ManyStates,
    Paths,
    clamped_lanes,
    lanes_of,
    paths_of,
    points_of,
    power_of,
    states_at,
    with_voltage_droop,
)
from vsgdesign.linear.operating_point.plant import TwoAxisCircuit
from vsgdesign.linear.operating_point.sampled import SampledState, fault_of_rest, state_of_lane
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
GainsOfMany = Callable[[Array, Array, Array], PowerLoopGains]
"""Function of P (W), Q (var) and V (phase rms, V) at the control points, (N,) each, that returns gains of arrays (N,),
with NaN where there are none."""

_ROUNDS = 100
_PLAIN_ROUNDS = 8
"""Rounds before the secant is taken: most lanes need fewer."""
_STARTS = np.array([(1.0, 1.0, 1.0), (1.0, 1.0, 0.85), (1.0, 1.0, 0.7), (0.0, 0.0, 1.0), (1.0, 1.0, 1.25)])
"""Measured P, Q and V with which the first gains are made, as shares of the references and the rated voltage, until
there is a steady state for them."""
_MOST_LOSSES = 10
"""Rounds without a point, as when a step goes too far, after which there is none."""
_LONGEST = 30.0
"""Most of the last step that a secant may add or take back."""
_TOLERANCE = 1e-10


def many_rests_with_measured_gains(
    study: Study,
    lanes: Lanes,
    gains_of: GainsOfMany,
    phase: Array | float = 0.0,
    *,
    circuit: TwoAxisCircuit | Sequence[TwoAxisCircuit] | None = None,
    links: Sequence[DcLink] | None = None,
) -> tuple[ManyStates, PowerLoopGains]:
    """The steady states with the gains that belong to their own P, Q and V, and these gains.

    Gains and steady states are computed in turn until they agree to 1e-10, with secant steps after some rounds. If the
    droops do not depend on the measured values, the first state is the final one. A lane for which there are no gains,
    or no steady state with them, has its reason in ``fault``. The other arguments are those of
    :func:`vsgdesign.linear.operating_point.many.many_steady_states`.
    """
    lanes, _ = lanes_of(study, lanes, PowerLoopGains(0.0, 0.0, 0.0, 0.0))
    paths = paths_of(study, lanes, circuit)
    return with_voltage_droop(
        study, links, lanes, lambda shifted: _rests(study, shifted, gains_of, phase, paths, links)
    )


def _rests(
    study: Study,
    lanes: Lanes,
    gains_of: GainsOfMany,
    phase: Array | float,
    paths: Paths,
    links: Sequence[DcLink] | None,
) -> tuple[ManyStates, PowerLoopGains]:
    c, count = study.converter, len(lanes.R_g)
    scale = np.array([[c.S_rated], [c.S_rated], [c.V_rated_rms]])
    first = np.array([lanes.P_ref, lanes.Q_ref, np.full(count, c.V_rated_rms)])
    measured, losses, step = first.copy(), np.zeros(count, dtype=int), np.ones(count)
    at_last, change_last = (np.full(first.shape, np.nan) for _ in range(2))  # the last ones with a point
    V, delta, fault = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count, dtype=int)
    point_of = np.full((2, count), np.nan)  # P at rest and D_q of the point V, delta

    def gains_now() -> Array:
        return np.array([np.full(count, value, dtype=float) for value in gains_of(*measured)])

    gains, active = gains_now(), np.arange(count)
    for k in range(_ROUNDS):
        missing = ~np.isfinite(gains[:, active]).all(axis=0)
        fault[active[missing]] = NO_GAINS
        active = active[~missing]
        if not active.size:
            break
        some, laws = Lanes._make(value[active] for value in lanes), PowerLoopGains(*gains[:, active])
        some = clamped_lanes(study, None if links is None else [links[k] for k in active], some, laws)
        P = power_of(some, laws)
        asked = np.array([P, laws.D_q])
        if not np.array_equal(asked, point_of[:, active]):  # a point depends on nothing else of the gains
            V[active], delta[active] = points_of(Paths._make(value[active] for value in paths), some, laws)
            point_of[:, active] = asked
        reached = np.array([P, some.Q_ref + laws.D_q * (some.V_n - V[active]), V[active]])
        there = np.isfinite(V[active])
        lost, active, reached = active[~there], active[there], reached[:, there]
        # No point with these gains: a shorter step from the last ones that had one, or another start.
        losses[lost] += 1
        begun = np.isfinite(at_last[0, lost])
        hopeless = losses[lost] >= np.where(begun, _MOST_LOSSES, len(_STARTS))
        fault[lost[hopeless]] = NO_POINT
        lost, begun = lost[~hopeless], begun[~hopeless]
        step[lost[begun]] *= 0.5
        shorter = at_last[:, lost] + step[lost] * change_last[:, lost]
        measured[:, lost] = np.where(begun, shorter, first[:, lost] * _STARTS[losses[lost] % len(_STARTS)].T)

        at, change = measured[:, active], reached - measured[:, active]
        measured[:, active] = at + step[active] * change
        if k >= _PLAIN_ROUNDS:
            measured[:, active] = _secant(at, change, at_last[:, active], change_last[:, active], scale)
        at_last[:, active], change_last[:, active] = at, change
        following, before = gains_now(), gains[:, active]
        near = np.abs(following[:, active] - before) <= _TOLERANCE * (np.abs(before) + np.abs(following[:, active]))
        still = (np.abs(change) <= 0.1 * _TOLERANCE * scale).all(axis=0)
        settled = np.where((k < _PLAIN_ROUNDS) & (step[active] == 1.0), near.all(axis=0), still)
        active = np.concatenate([active[~settled], lost])
        gains[:, active] = following[:, active]
    fault[active] = NOT_CONVERGED
    V[fault > 0] = np.nan
    found = PowerLoopGains(*gains)
    lanes = clamped_lanes(study, links, lanes, found)
    return states_at(study, paths, lanes, found, V, delta, phase, fault, links), found


def _secant(at: Array, change: Array, at_last: Array, change_last: Array, scale: Array) -> Array:
    """Where the change of the measured values vanishes if it goes on as between two rounds; (3, N) all."""
    difference = (change - change_last) / scale
    along = np.sum(change / scale * difference, axis=0) / np.maximum(np.sum(difference * difference, axis=0), 1e-300)
    along = np.clip(along, -_LONGEST, _LONGEST)
    found = at + change - along * (at + change - at_last - change_last)
    return np.where(np.isfinite(found), found, at + change)


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
    :func:`vsgdesign.linear.operating_point.sampled.steady_state`. Raises InfeasibleStudyError if there is no steady
    state, if there are no gains in it, or if the iteration does not converge.
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


_APART = 0.02
"""By how much powers lie apart between which a curve is drawn, of the rating."""


def reactive_curve(
    study: Study,
    lanes: Lanes,
    gains: PowerLoopGains,
    P_end: Array,
    circuit: TwoAxisCircuit | Sequence[TwoAxisCircuit] | None = None,
) -> RestCurve:
    """How Q follows P where a clamp holds the power elsewhere than at ``P_end`` (N,), W: through the rests at P_end, at
    what is asked for and without power (:eq:`dc-clamped-q`). Where two of them are the same, or have no rest, it is
    the chord of the others."""
    lanes, gains = lanes_of(study, lanes, gains)
    paths, asked, apart = paths_of(study, lanes, circuit), power_of(lanes, gains), _APART * study.converter.S_rated

    def Q_at(P: Array) -> Array:
        V, _ = points_of(paths, lanes._replace(P_ref=P + lanes.P_ref - asked), gains)
        return lanes.Q_ref + gains.D_q * (lanes.V_n - V)

    none = np.zeros_like(asked)
    none = np.where((np.abs(P_end) < apart) | (np.abs(asked) < apart), 0.5 * (P_end + asked), none)
    points = [np.broadcast_to(P, asked.shape) for P in (P_end, asked, none)]
    of_points = [Q_at(P) for P in points]
    chords = []
    for k in (1, 2):
        there = np.abs(points[k] - P_end) >= apart
        with np.errstate(divide="ignore", invalid="ignore"):
            chord = (of_points[k] - of_points[0]) / (points[k] - P_end)
        chords.append(np.where(there & np.isfinite(chord), chord, np.nan))
    with np.errstate(divide="ignore", invalid="ignore"):
        bend = (chords[1] - chords[0]) / (points[2] - points[1])
    bend = np.where(np.isfinite(bend), bend, 0.0)
    first = np.where(np.isfinite(chords[0]), chords[0] - bend * (points[1] - P_end), chords[1])
    return RestCurve(P_end, of_points[0], np.where(np.isfinite(first), first, 0.0), bend)
