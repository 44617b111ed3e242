"""A proof over a region: one quadratic Lyapunov function for every grid, operating point and estimate error.

The schedule is the closed-form one, fed a wrong estimate and the measured P, Q and V. Cells enter as vertices of
a linear matrix inequality; a cutting plane keeps only those that matter, so thousands of cells cost a few small
semidefinite programs. What the solver returns is then verified by eigenvalues, on the grid and on fresh points.

The model is the coupled one with three states: ideal inner loops, and the power filters left out. Their states are
powers, whose size changes with the grid: no one function of them suits all grids.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.parameters.study import ControllerSpec, Study, grid_from_scr
from vsgdesign.runtime.closed_form import closed_form_schedule
from vsgdesign.stability.cells import cell_set, reduced_cells

Array = NDArray[np.float64]

_ROUNDS = 40
_STRICT = 1e-7
"""How far below zero the inequality is asked of the solver, in its scaled coordinates."""

POWER_MARGIN = 1.3
"""Static limit of the region: 3V²/|Z| over |S|."""


@dataclass(frozen=True)
class Region:
    """Where a certificate is asked for. Limits of SCR (on the study's basis), X/R, P (W), Q (var); the error is
    relative, of R_g and of L_g, each anywhere within ± it."""

    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    P: tuple[float, float]
    Q: tuple[float, float]
    error: float = 0.0


@dataclass(frozen=True)
class Points:
    """Cells as columns: grid, operating point, errors of R_g and L_g, each (N,), and the state matrices (N, n, n)."""

    columns: Array
    A: Array


@dataclass(frozen=True)
class Certificate:
    """xᵀP x decays at least as e^{−2·decay·t} along every change of grid and estimate within the region.

    x = (δ, ω_i, V) as deviations over ``scale``. ``checked`` and ``fresh`` count the cells and the
    random points at which the inequality was verified by eigenvalues, ``largest`` is the largest eigenvalue of
    Aᵀ P + P A + 2·decay·P found (negative: it holds). Between the points it is not proved: gridded, refined.
    """

    controller: str
    region: Region
    decay: float
    P: Array
    scale: Array
    checked: int
    fresh: int
    vertices: int
    largest: float


@dataclass(frozen=True)
class Counterexample:
    """A cell of the region that no certificate can cover, and its least stable eigenvalue (1/s)."""

    controller: str
    region: Region
    scr: float
    x_over_r: float
    P: float
    Q: float
    error_R: float
    error_L: float
    eigenvalue: complex


def certify(
    study: Study, spec: ControllerSpec, region: Region, *, nodes: int = 15, fresh: int = 20_000, seed: int = 0
) -> Certificate | Counterexample:
    """The largest decay that one Lyapunov function proves over the region (to 2 %), or a counterexample.

    Points outside the static limits (no operating point, V outside the converter's limits, 3V²/\\|Z\\| below
    POWER_MARGIN·\\|S\\|) are not part of the region. A counterexample is returned where a cell is unstable by
    itself. Raises InfeasibleStudyError where the region is empty, or where every cell is stable but no common
    function exists.
    """
    if spec.gains is not None or spec.kind != "scheduled":
        raise InfeasibleStudyError(f"controller {spec.name}: a certificate is made for a scheduled controller")
    rng = np.random.default_rng(seed)
    points = _evaluate(study, spec, _nodes(region, nodes))
    points = _join(points, _evaluate(study, spec, _random(region, fresh, rng)))
    if len(points.A) == 0:
        raise InfeasibleStudyError("the region has no cell within the static limits: widen it, or ask for less power")
    eigenvalues = np.linalg.eigvals(points.A)
    worst = int(np.argmax(eigenvalues.real.max(axis=1)))
    limit = -float(eigenvalues[worst].real.max())
    if limit <= 0.0:
        return _counterexample(spec, region, points.columns[worst], eigenvalues[worst])
    scale = np.array([1.0, np.sqrt(spec.target.k_1), study.converter.V_rated_rms])
    A = points.A * (scale[None, None, :] / scale[None, :, None])
    best: tuple[Array, int] | None = None
    low, high, proved = 0.0, limit, 0.0
    while high - low > 0.02 * limit:
        decay = 0.5 * (low + high)
        found = _common_function(A, decay)
        if found is None:
            high = decay
        else:
            low, best, proved = decay, found, decay
    if best is None:
        raise InfeasibleStudyError(
            f"controller {spec.name}: every cell is stable (slowest {limit:.3g} 1/s), but no common quadratic function "
            "exists. Shrink the region or the error."
        )
    P, vertices = best
    # Verified where nothing was fitted: new points, and a decay that gives way until it holds there.
    verify = _evaluate(study, spec, _random(region, fresh, rng))
    A_fresh = verify.A * (scale[None, None, :] / scale[None, :, None])
    largest = max(_largest(A, P, proved), _largest(A_fresh, P, proved))
    while largest >= 0.0 and proved > 1e-3 * limit:
        proved *= 0.98
        largest = max(_largest(A, P, proved), _largest(A_fresh, P, proved))
    if largest >= 0.0:
        raise InfeasibleStudyError(f"controller {spec.name}: what holds on the grid does not hold between its nodes")
    return Certificate(spec.name, region, proved, P, scale, len(A), len(A_fresh), vertices, largest)


def region_of(
    study: Study, controller: str | None, scr: tuple[float, float] | None, x_over_r: tuple[float, float] | None,
    P_pu: tuple[float, float], Q_pu: tuple[float, float], error: float,
) -> tuple[ControllerSpec, Region]:  # fmt: skip
    """A controller by name (None: the last scheduled one) and a region, from limits in per unit of rating.

    None for ``scr`` or ``x_over_r``: the limits of the study's stability axes. Raises InfeasibleStudyError with
    every fault found.
    """
    scheduled = [spec for spec in study.controllers if spec.kind == "scheduled"]
    chosen = [spec for spec in scheduled if controller in (None, spec.name)]
    axes, S = study.stability, study.converter.S_rated
    scr = (axes.scr[0], axes.scr[-1]) if scr is None else scr
    x_over_r = (axes.x_over_r[0], axes.x_over_r[-1]) if x_over_r is None else x_over_r
    faults = []
    if not chosen:
        names = ", ".join(spec.name for spec in scheduled) or "none"
        faults.append(f"controller = {controller}: no such scheduled controller; there are: {names}")
    for name, (low, high), least in (
        ("scr", scr, 0.05), ("x-over-r", x_over_r, 1e-3), ("p-pu", P_pu, -2.0), ("q-pu", Q_pu, -2.0),
    ):  # fmt: skip
        if not (least <= low <= high < np.inf):
            faults.append(f"{name} = {low:g} {high:g}: must be two numbers, the smaller first, from {least:g} up")
    if not 0.0 <= error < 0.9:
        faults.append(f"error = {error:g}: must be from 0 to 0.9, a fraction of the value")
    if faults:
        raise InfeasibleStudyError("; ".join(faults))
    region = Region(scr, x_over_r, (P_pu[0] * S, P_pu[1] * S), (Q_pu[0] * S, Q_pu[1] * S), error)
    return chosen[-1], region


def _nodes(region: Region, count: int) -> Array:
    """(N, 6) points: SCR and X/R log-spaced, P and Q at their limits and middle, errors at −, 0, +."""
    axes = [
        np.geomspace(*region.scr, count),
        np.geomspace(*region.x_over_r, count),
        np.unique([region.P[0], 0.5 * sum(region.P), region.P[1]]),
        np.unique([region.Q[0], 0.5 * sum(region.Q), region.Q[1]]),
        *([np.unique([-region.error, 0.0, region.error])] * 2),
    ]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def _random(region: Region, count: int, rng: np.random.Generator) -> Array:
    """(N, 6) points, log-uniform in SCR and X/R, uniform in the rest."""
    low = np.array([*np.log([region.scr[0], region.x_over_r[0]]), region.P[0], region.Q[0], *[-region.error] * 2])
    high = np.array([*np.log([region.scr[1], region.x_over_r[1]]), region.P[1], region.Q[1], *[region.error] * 2])
    points = rng.uniform(low, high, (count, 6))
    points[:, :2] = np.exp(points[:, :2])
    return points


def _evaluate(study: Study, spec: ControllerSpec, columns: Array) -> Points:
    """State matrices of the points that lie within the static limits."""
    scr, ratio, P, Q, e_R, e_L = columns.T
    unit = [grid_from_scr(1.0, float(x), study.scr_basis, study.converter) for x in ratio]
    R_g = np.array([grid.R_g for grid in unit]) / scr
    L_g = np.array([grid.L_g for grid in unit]) / scr
    source = study.grid_source
    R, X = study.filter.R_2 + R_g, source.omega_g * (study.filter.L_2 + L_g)
    with np.errstate(invalid="ignore"):
        V_rms = operating_point(P, Q, source.V_g_rms, R, X)[0]
        low, high = study.converter.V_limits_rms
        S_limit = study.converter.Z_base * study.converter.S_rated * (V_rms / study.converter.V_rated_rms) ** 2
        inside = (V_rms >= low) & (V_rms <= high) & (S_limit / np.hypot(R, X) >= POWER_MARGIN * np.hypot(P, Q))
    keep = np.flatnonzero(inside)
    schedule = closed_form_schedule(study, spec.target)
    gains = schedule.gains_measured(
        R_g[keep] * (1.0 + e_R[keep]), L_g[keep] * (1.0 + e_L[keep]), P[keep], Q[keep], V_rms[keep]
    )
    gains = PowerLoopGains(*(np.broadcast_to(np.asarray(value, dtype=float), keep.shape) for value in gains))
    cells = cell_set(study, R_g[keep], L_g[keep], P[keep], Q[keep], gains)
    return Points(columns[keep], reduced_cells(replace(study, tau_P=0.0, tau_Q=0.0), cells).A)


def _join(one: Points, other: Points) -> Points:
    return Points(np.concatenate([one.columns, other.columns]), np.concatenate([one.A, other.A]))


def _largest(A: Array, P: Array, decay: float) -> float:
    return float(_residual(A, P, decay).max()) if len(A) else -np.inf


def _residual(A: Array, P: Array, decay: float) -> Array:
    """Largest eigenvalue of Aᵀ P + P A + 2·decay·P of each cell (:eq:`certificate`)."""
    product = P @ A
    return np.linalg.eigvalsh(np.swapaxes(product, 1, 2) + product + 2.0 * decay * P)[:, -1].astype(float)


def _common_function(A: Array, decay: float) -> tuple[Array, int] | None:
    """P ⪰ I for all cells at a decay and the number of vertices it took; None where there is none."""
    active = [int(np.argmax(np.linalg.eigvals(A).real.max(axis=1)))]
    for _ in range(_ROUNDS):
        P = _solve(A[active], decay)
        if P is None:
            return None
        residual = _residual(A, P, decay)
        violated = [int(k) for k in np.argsort(-residual)[:4] if residual[k] >= 0.0 and k not in active]
        if residual.max() < 0.0:
            return P, len(active)
        if not violated:
            return None  # the solver's accuracy is spent
        active += violated
    return None


def _solve(A: Array, decay: float) -> Array | None:
    """The best-conditioned P for a few vertices, by cvxpy and Clarabel; None where infeasible."""
    import cvxpy as cp

    n = A.shape[1]
    P: Any = cp.Variable((n, n), symmetric=True)
    size: Any = cp.Variable()
    constraints = [P >> np.eye(n), P << size * np.eye(n)]
    constraints += [a.T @ P + P @ a + 2.0 * decay * P << -_STRICT * np.eye(n) for a in A]
    problem = cp.Problem(cp.Minimize(size), constraints)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": taken as a no below
            problem.solve(solver=cp.CLARABEL)
    except cp.SolverError:
        return None
    if problem.status != cp.OPTIMAL or P.value is None:
        return None
    return 0.5 * (P.value + P.value.T)


def _counterexample(spec: ControllerSpec, region: Region, point: Array, eigenvalues: Any) -> Counterexample:
    least = complex(eigenvalues[int(np.argmax(eigenvalues.real))])
    scr, ratio, P, Q, e_R, e_L = (float(value) for value in point)
    return Counterexample(spec.name, region, scr, ratio, P, Q, e_R, e_L, least)
