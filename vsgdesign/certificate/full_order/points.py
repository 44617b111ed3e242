"""The sampled full-order loop at points of a region, by the eigenvalues of its own model: the least decay that a search
finds. A proof of more would be refuted by it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import CertificateCell
from vsgdesign.certificate.proof import worst_points
from vsgdesign.certificate.region import Region, System, nodes, random_points
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.full_order import slowest_decay
from vsgdesign.linear.operating_point.many import Lanes, ManyStates, many_steady_states, paths_of
from vsgdesign.runtime.table import TableSchedule
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_NODES, _RANDOM = 6, 3_000
_KEPT, _TRIES = 40, 12
"""Of the search among the worst: places that are kept from round to round, and steps from each."""


class AtRest(NamedTuple):
    """Grids (Ω, H), the voltage of the sampled rest (V, phase rms) and the gains that the estimate leads to, (N,)
    each."""

    R_g: Array
    L_g: Array
    V_rms: Array
    gains: PowerLoopGains


def at_rest(study: Study, system: System, points: Array) -> AtRest:
    """The sampled rests at points (N, 6) within the static limits. A table's estimates are drawn to its axes as the
    scheduler draws them. NaN where there is no rest, or there are no gains."""
    c, source = study.converter, study.grid_source
    Z_g = SCR_BASES[study.scr_basis].magnitude(points[:, 0] * c.Z_base, np.sin(points[:, 1]))
    R_g, L_g = Z_g * np.cos(points[:, 1]), Z_g * np.sin(points[:, 1]) / c.omega_n
    P, Q = points[:, 2], points[:, 3]
    one = np.ones(len(points))
    paths = paths_of(study, Lanes(R_g, L_g, source.V_g_rms * one, source.omega_g * one, P, Q), None)
    with np.errstate(invalid="ignore"):
        V, _ = operating_point(P, Q, paths.V_rms, paths.R, paths.X)
    R_hat, L_hat = R_g * (1.0 + points[:, 4]), L_g * (1.0 + points[:, 5])
    schedule: Any = system.schedule
    if isinstance(schedule, TableSchedule):
        axes = (schedule.scr[0], schedule.scr[-1]), (schedule.r_over_x[0], schedule.r_over_x[-1])
        R_hat, L_hat, _ = schedule.drawn_to(R_hat, L_hat, *axes)
    gains = schedule.gains_measured(R_hat, L_hat, P, Q, V)
    return AtRest(R_g, L_g, V, PowerLoopGains(*(np.broadcast_to(np.asarray(x, dtype=float), V.shape) for x in gains)))


def decays_at(study: Study, system: System, points: Array) -> Array:
    """The decay of the slowest mode of the full-order model at points (N, 6) within the static limits, 1/s: negative
    where it grows, NaN where there is no rest."""
    if len(points) == 0:
        return np.zeros(0)
    at, states, lanes = rests_at(study, system, points)
    return slowest_decay(study, states, lanes, at.gains)


def rests_at(study: Study, system: System, points: Array) -> tuple[AtRest, ManyStates, Lanes]:
    """What is at rest at points (N, 6), with the set points with which the droops lead to the P and Q of each, and the
    lanes of the loop there."""
    at, source = at_rest(study, system, points), study.grid_source
    own = np.full_like(at.R_g, source.omega_g)
    V_g = np.full_like(own, source.V_g_rms)
    lanes = Lanes(at.R_g, at.L_g, V_g, own, points[:, 2], points[:, 3], own, at.V_rms)
    states = many_steady_states(study, lanes, at.gains)
    if system.apart:  # the same rest, and a circuit that ends at the units' node
        lanes = lanes._replace(R_g=np.zeros_like(own), L_g=np.zeros_like(own))
    return at, states, lanes


def least_decay(study: Study, system: System, region: Region, seed: int = 0, count: int = _RANDOM) -> CertificateCell:
    """The point with the least decay that random points, corners of the region and a search from the worst of them
    find.

    Raises InfeasibleStudyError where the region has no point within the static limits.
    """
    rng = np.random.default_rng(seed)
    corners = nodes(region, _NODES)
    if len(corners) > count:
        corners = corners[rng.choice(len(corners), count, replace=False)]
    points = np.concatenate([corners, random_points(region, count, rng)])
    if (why := system.emptiness(points)) is not None:
        raise InfeasibleStudyError(f"the region has no cell within the static limits: {why}. Widen the region.")

    def shortfall(places: Array, _A: Array) -> Array:
        return -np.nan_to_num(decays_at(study, system, places), nan=np.inf)

    points, A = system.matrices(points, partial=True)
    points, worth = worst_points(system, region, shortfall, points, A, rng, kept=_KEPT, tries=_TRIES)
    worst = points[0]
    scr, ratio = 1.0 / float(worst[0]), float(np.tan(worst[1]))
    P, Q, error_R, error_L = (float(value) for value in worst[2:])
    return CertificateCell(scr=scr, x_over_r=ratio, P=P, Q=Q, error_R=error_R, error_L=error_L, decay=-float(worth[0]))
