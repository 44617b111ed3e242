"""What has to hold for a step to stay clear of the limits, as plain equations for arrays and for symbols on boxes;
and how far the resting point moves with a reference or the grid source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.region import OMEGA_SCALE, Cells, System
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.power_flow import admittance, jacobian_from_admittance
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.equilibrium import acting_current_pk
from vsgdesign.study.parameters.study import Study


def rest_shift(
    jacobian: tuple[Any, Any, Any, Any],
    P: Any,
    Q: Any,
    V_rms: Any,
    gains: PowerLoopGains,
    *,
    P_ref: Any = 0.0,
    Q_ref: Any = 0.0,
    V_g: Any = 0.0,
    omega_g: Any = 0.0,
) -> tuple[Any, Any, Any]:
    """Step of the resting point (δ, ω_r, V) when a reference or the grid source changes a little (:eq:`rest-shift`).

    The changes are those of P_ref (W), Q_ref (var), the source's voltage V_g as a share of itself, and its frequency
    omega_g (rad/s). P, Q and V are those at rest, ``jacobian`` is A, B, C, D there. ω_i is continuous, so that a step
    of P_ref or Q_ref moves ω_r instead of its rest. P and Q are homogeneous of second degree in (V, V_g); their
    derivatives with respect to ln V_g are therefore 2P − BV and 2Q − DV. Returns (delta, omega_r, V) in rad, rad/s
    and V: what the state lacks to its new rest right after the step.
    """
    A, B, C, D = jacobian
    P_rest = P_ref - gains.D_p * omega_g
    P_shift = P_rest - V_g * (2.0 * P - B * V_rms)
    Q_shift = Q_ref - V_g * (2.0 * Q - D * V_rms)
    D_loop = D + gains.D_q
    determinant = A * D_loop - B * C
    delta = (D_loop * P_shift - B * Q_shift) / determinant
    V = (A * Q_shift - C * P_shift) / determinant
    omega_r = omega_g + (gains.k_P * P_ref + gains.k_Q * Q_ref) / (1.0 - gains.k_P * gains.D_p)
    return delta, omega_r, V


Array = NDArray[np.float64]

STEPS = ("P_ref", "Q_ref", "phase", "V_g", "omega_g")
"""The steps, each alone. Their units are the rated power for P and Q, rad, the source's own voltage, and rad/s."""


@dataclass(frozen=True)
class ActingLimits:
    """From where on a limit of the controller acts, in per unit of the rated peak current and the rated voltage."""

    current_pu: float | None
    """None: the converter has no current limit."""
    V_low_pu: float | None
    V_high_pu: float | None
    """Between which V has to stay; None: nothing keeps V."""
    limiter: str
    """Name of the current limiter."""
    soft: bool
    """Whether the current is that of the limiter's soft limit."""
    clips_V: bool
    """Whether the limiter keeps V within the two voltages."""


_BEYOND_PU = 0.15, 0.05
"""How far V may leave the converter's limits where no limit acts at all: as far as the limiters' default box."""


def acting_limits(study: Study) -> ActingLimits:
    """The limits of a study's controllers: the lower of the soft and the hard limit of the current, and those of V.

    A limiter that does not clip V leaves V free. Without a limit of the current no limit acts: V then has to stay
    within the converter's limits and a little beyond them.
    """
    c = study.converter
    settings = study.controller_settings()
    low, high = (getattr(settings.limiter, name, None) for name in ("V_low", "V_high"))
    limited, clips = c.current_limit_pu is not None, False
    V_limits: tuple[float | None, float | None] = None, None
    if not limited:
        V_limits = max(c.V_min_pu - _BEYOND_PU[0], 0.0), c.V_max_pu + _BEYOND_PU[1]
    elif low is not None and high is not None:
        clips, V_limits = True, (float(low / c.V_rated_rms), float(high / c.V_rated_rms))
    acting_pk = acting_current_pk(study)
    return ActingLimits(
        current_pu=acting_pk / c.I_rated_pk if limited else None,
        V_low_pu=V_limits[0],
        V_high_pu=V_limits[1],
        limiter=study.current_limiter,
        soft=limited and acting_pk < settings.i_max_pk,
        clips_V=clips,
    )


@dataclass(frozen=True)
class LevelShape:
    """A function xᵀPx of the scaled states, and how far its sublevel sets {xᵀPx ≤ c} reach."""

    P: Array
    """(3, 3)."""
    V_reach: float
    """Largest ΔV² over the set with c = 1, in pu²."""
    reach: tuple[float, float]
    """a and b with |Δv| ≤ a + bV for c = 1 and every V in per unit between the static limits (:eq:`voltage-reach`)."""

    @classmethod
    def of(cls, P: Array, V_min_pu: float, V_max_pu: float) -> LevelShape:
        """The reach of a function's sets. As a function of V the largest |Δv| is convex: a chord is above it."""
        inverse = np.linalg.inv(P)
        block = inverse[np.ix_((0, 2), (0, 2))]
        ends = [np.sqrt(np.linalg.eigvalsh(block * np.outer((V, 1.0), (V, 1.0)))[-1]) for V in (V_min_pu, V_max_pu)]
        slope = float(ends[1] - ends[0]) / (V_max_pu - V_min_pu)
        return cls(P, float(inverse[2, 2]), (float(ends[0]) - slope * V_min_pu, slope))


class StepTerms(NamedTuple):
    """Both sides of :eq:`step-conditions`, in units that make strong and weak grids alike. A step of size s leaves
    every limit alone where s²·weight·reach² ≤ M_I², M_I ≥ 0, s²·weight·V_reach ≤ (V_high − V)² and the same below."""

    weights: list[Any]
    """b′Pb of one unit of each step."""
    reach_sq: Any
    """(|Y||Δv|)² for a level of 1."""
    current_margin: Any
    """M_I."""
    V: Any
    """V at rest, pu."""


class Cell(NamedTuple):
    """A cell in units of an impedance of ``size`` (pu): P, Q, V and 1/V in pu, the path r + jx in these units, and the
    gains with V as its logarithm and powers in V² over the impedance."""

    P: Any
    Q: Any
    V: Any
    inverse_V: Any
    size: Any
    r: Any
    x: Any
    gains: PowerLoopGains


def step_terms(cell: Cell, shunt: float, shape: LevelShape, limit_pu: float, typical_pu: Any) -> StepTerms:
    """The terms of a cell, as numbers, arrays or symbols. ``shunt``: ωC of the filter, pu.

    ``typical_pu``: a current m > 0 with which |i| ≤ (i²/m + m)/2 replaces the root of the resting current; exact at
    i = m.
    """
    size, r, x = cell.size, cell.r, cell.x
    rated = size * PHASES * (cell.inverse_V * cell.inverse_V)  # the rated power in these units
    p, q = rated * cell.P, rated * cell.Q
    J = jacobian_from_admittance(p, q, 1.0, *admittance(1.0, r, x, r * r + x * x))
    changes: list[dict[str, Any]] = [{"P_ref": rated}, {"Q_ref": rated}, {}, {"V_g": 1.0}, {"omega_g": 1.0}]
    weights = []
    for change in changes:
        shift = rest_shift(J, p, q, 1.0, cell.gains, **change) if change else (1.0, 0.0, 0.0)
        weights.append(_square([shift[0], shift[1] * (1.0 / OMEGA_SCALE), shift[2] * cell.V], shape.P))
    b = size * shunt
    free, turned = 1.0 - b * x, b * r
    reach = shape.reach[0] + shape.reach[1] * cell.V
    admittance_sq = (free * free + turned * turned) / (r * r + x * x)
    active, reactive = cell.P * cell.inverse_V, cell.Q * cell.inverse_V - cell.V * shunt
    rest_sq = active * active + reactive * reactive
    margin = size * (limit_pu - 0.5 * typical_pu - rest_sq * (0.5 / typical_pu))
    return StepTerms(weights, admittance_sq * (reach * reach), margin, cell.V)


def _square(vector: list[Any], P: Array) -> Any:
    """vᵀPv; what is zero in the vector leaves no trace."""
    total: Any = 0.0
    for i in range(3):
        for j in range(i, 3):
            if not (isinstance(vector[i], float) and vector[i] == 0.0) and not (
                isinstance(vector[j], float) and vector[j] == 0.0
            ):
                total = total + vector[i] * vector[j] * float(P[i, j] * (1.0 if i == j else 2.0))
    return total


def rest_current_pu(system: System, cells: Cells) -> Array:
    """Converter current at rest, pu of the rated one: grid current and the capacitor's (:eq:`converter-current`)."""
    c = system.study.converter
    _, _, P, Q, _, _ = cells.points.T
    V = cells.V_rms / c.V_rated_rms
    shunt = c.omega_n * system.study.filter.C * c.Z_base
    return np.hypot(P / c.S_rated / V, Q / c.S_rated / V - shunt * V)


def step_sizes(system: System, cells: Cells, shape: LevelShape, limits: ActingLimits) -> Array:
    """The largest step of each kind, (5, M), for which no limit acts in each of the cells; zero where none is left."""
    c = system.study.converter
    V = cells.V_rms / c.V_rated_rms
    unit = cells.V_rms**2 / c.Z_base
    _, _, P, Q, _, _ = cells.points.T
    g = cells.gains
    gains = PowerLoopGains(
        g.K_ip, g.D_p / unit, g.K_iq, g.D_q * cells.V_rms / unit, g.K_pq, g.K_qp, g.k_P * unit, g.k_Q * unit
    )
    rest = np.maximum(rest_current_pu(system, cells), 1e-6)
    limit = 1.0 if limits.current_pu is None else limits.current_pu
    shunt = c.omega_n * system.study.filter.C * c.Z_base
    path = cells.R / c.Z_base, cells.X / c.Z_base
    path = cells.R / c.Z_base, cells.X / c.Z_base
    cell = Cell(P / c.S_rated, Q / c.S_rated, V, 1.0 / V, 1.0, *path, gains)
    terms = step_terms(cell, shunt, shape, limit, rest)
    margin = np.full(V.shape, np.inf)
    if limits.V_low_pu is not None and limits.V_high_pu is not None:
        room = np.minimum(limits.V_high_pu - V, V - limits.V_low_pu)
        margin = np.maximum(room, 0.0) ** 2 / shape.V_reach
    if limits.current_pu is not None:
        margin = np.minimum(margin, np.maximum(terms.current_margin, 0.0) ** 2 / terms.reach_sq)
    return np.sqrt(np.array([margin / np.broadcast_to(weight, V.shape) for weight in terms.weights]))
