"""The sampled full-order loop at places, with all gains that an estimate within its error leads to: its matrices in a
state that no change of gains moves, and the part of it that the gains act on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.full_order.points import AtRest, rests_at
from vsgdesign.certificate.region import Region, System
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops_about_rest
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.full_order import sample_matrices
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

MOVED = ("delta", "omega_r", "V")
"""The states into which the gains feed the powers; ω_r is in the place of ω_i (:eq:`moving-state`)."""

_NONE = References(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MovingLoops:
    """N points (N, 6): the names of n states, A (N, n, n) of one sample in SI, and the rests. NaN without a rest."""

    points: Array
    states: tuple[str, ...]
    A: Array
    at: AtRest

    @property
    def moved(self) -> list[int]:
        """The places of ``MOVED`` among the states."""
        return [self.states.index(name) for name in MOVED]


def loops_at(study: Study, system: System, points: Array) -> MovingLoops:
    """The loops at points (N, 6) with the gains of their estimates, in the state of :eq:`moving-state`.

    What a limiter remembers is not part of the loop at rest and is left out.
    """
    at, states, lanes = rests_at(study, system, points)
    names, A = sample_matrices(study, states, lanes, at.gains)
    kept = [k for k, name in enumerate(names) if not name.startswith("limiter_")]
    others = [k for k in range(len(names)) if k not in kept]
    if np.nan_to_num(A[:, kept][:, :, others]).any():
        raise InfeasibleStudyError(f'the limiter "{study.current_limiter}" changes what small signals do at rest.')
    names, A = tuple(names[k] for k in kept), A[:, kept][:, :, kept]
    k = names.index("omega_i")
    free = (1.0 - at.gains.k_P * at.gains.D_p)[:, None]
    A[:, :, k] *= free
    A[:, k, :] /= free
    return MovingLoops(points, (*names[:k], MOVED[1], *names[k + 1 :]), A, at)


def feeds(gains: PowerLoopGains) -> Array:
    """−(ω − ω_r, dω_r/dt, dV/dt) of one unit of P + D_p Δω_r and of Q + D_q V, (…, 3, 2) in SI (:eq:`moving-feeds`)."""
    columns = [power_loops_about_rest(0.0, 0.0, P, Q, _NONE, gains) for P, Q in ((1.0, 0.0), (0.0, 1.0))]
    rows = [np.stack(np.broadcast_arrays(*(-column[i] for column in columns)), axis=-1) for i in range(3)]
    found: Any = np.stack(np.broadcast_arrays(*rows), axis=-2)
    return found


def powers_of(loops: MovingLoops, T_s: float) -> Array:
    """The rows (N, 2, n) of P + D_p Δω_r and Q + D_q V, both behind their filters, from what the loops do with them."""
    _, k, m = loops.moved
    eye = np.eye(len(loops.states))
    own = feeds(loops.at.gains)[:, 1:, :]
    found: Any = np.linalg.solve(own, (eye[[k, m]] - loops.A[:, [k, m], :]) / T_s)
    return found


DROOPS, PRODUCTS = "droops", "products"


def kind_of(system: System) -> str | None:
    """What stays the same at a change of gains: the droops, or the products of gain and droop; None: neither, and what
    is fed back is not one pair of quantities for all gains."""
    schedule: Any = system.schedule
    inner = getattr(schedule, "schedule", schedule)
    structure = STRUCTURES[inner.structure]
    if structure.P_droop and structure.Q_droop:
        return DROOPS
    return PRODUCTS if not structure.P_droop and not structure.Q_droop else None


def estimates(region: Region, angle: float, steps: int) -> Array:
    """Errors (steps², 2) of R_g and L_g on a lattice over the error set on a grid of this angle."""
    shares = np.linspace(-1.0, 1.0, steps) * region.largest_error
    scales = region.error_scales(np.array([angle])) if region.error_Z else (np.ones(1), np.ones(1))
    every = [shares * float(scale[0]) for scale in scales]
    return np.stack([one.ravel() for one in np.meshgrid(*every, indexing="ij")], axis=1)


def with_estimates(places: Array, errors: Array) -> Array:
    """Points (N·M, 6): each of N places (4,) with each of M errors."""
    return np.hstack([np.repeat(places, len(errors), axis=0), np.tile(errors, (len(places), 1))])
