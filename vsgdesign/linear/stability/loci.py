"""Modes along a parameter, the states that take part in them, and the parameters that move them; a mode in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.model.full_order import PARAMETERS
from vsgdesign.linear.operating_point.full_order import FullOrderModel, parameter_sensitivities, parameter_sensitivity
from vsgdesign.linear.stability.maps import GainLaw, cells_under, grid_arrays, reduced_cells
from vsgdesign.metrics.modes import Eigen, damping_ratio, eigenvalue_sensitivity, participation_factors, to_continuous
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True)
class Mode:
    """One mode of a cell: s in 1/s, damping ratio, and the states with the largest participation (name, share)."""

    s: complex
    damping: float
    participation: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class ModeSensitivity:
    """How a parameter moves one mode: ds/dp, and relative to the parameter, p·ds/dp in 1/s."""

    parameter: str
    value: float
    ds_dp: complex
    relative: complex


def modes(
    states: Sequence[str],
    A: Array,
    T_s: float | None = None,
    count: int = 4,
    known: Eigen | None = None,
    most: int | None = None,
) -> tuple[Mode, ...]:
    """Modes of one matrix, the least stable first; ``T_s`` of a sampled model, None for a continuous one.

    ``count``: of the states that take part in each. ``known``: the eigenvectors of A, if they were computed before.
    ``most``: how many modes are asked for, None for all.
    """
    eigenvalues, shares = participation_factors(A, known) if count or known is None else (known.values, A[:0])
    s: Complex = eigenvalues.astype(complex) if T_s is None else to_continuous(eigenvalues, T_s)
    found, damping = [], damping_ratio(s).tolist()
    for k in np.argsort(-s.real, kind="stable").tolist()[:most]:
        order = np.argsort(-shares[:, k], kind="stable")[:count].tolist()
        found.append(Mode(complex(s[k]), damping[k], tuple((str(states[j]), float(shares[j, k])) for j in order)))
    return tuple(found)


def track(eigenvalues: Complex) -> Complex:
    """Eigenvalues (K, n) along a path, with the order of each step matched to the step before: n continuous loci."""
    from scipy.optimize import linear_sum_assignment

    loci = np.array(eigenvalues, dtype=complex)
    for k in range(1, len(loci)):
        with np.errstate(invalid="ignore"):  # a mode that ends within a sample, z = 0, is s = −∞ before and after
            distance = np.abs(loci[k - 1][:, None] - loci[k][None, :])
        distance[~np.isfinite(distance)] = 1e12
        loci[k] = loci[k][linear_sum_assignment(distance)[1]]
    return loci


_NEWTON_STEPS = 25
_NEWTON_TOLERANCE = 1e-12

RANKED = tuple(name for name in PARAMETERS if name not in ("omega_0", "omega_g", "V_n"))
"""Parameters that are ranked by their relative effect. A frequency or voltage reference is not changed by per cents.
"""


def mode_sensitivities(
    model: FullOrderModel, cell: int, s: complex, parameters: Sequence[str] = RANKED
) -> tuple[ModeSensitivity, ...]:
    """ds/dp of the mode nearest to ``s`` for every parameter, the largest relative effect first.

    With z = e^{sT}: ds/dp = (dz/dp)/(z T_s). The steady state follows the parameter.
    """
    z = np.linalg.eigvals(model.A[cell])
    k = int(np.argmin(np.abs(z - np.exp(s * model.T_s))))
    found = []
    for name in parameters:
        value = float(model.p[cell, PARAMETERS.index(name)])
        eigenvalues, dz = eigenvalue_sensitivity(model.A[cell], parameter_sensitivity(model, cell, name))
        ds = complex(dz[k] / (eigenvalues[k] * model.T_s))
        found.append(ModeSensitivity(name, value, ds, value * ds))
    return tuple(sorted(found, key=lambda item: -abs(item.relative)))


@dataclass(frozen=True)
class ModeMovements:
    """How every parameter moves every mode of one cell, relative to the parameter: p·ds/dp in 1/s."""

    s: Complex
    """(n,) modes in 1/s."""
    parameters: tuple[str, ...]
    relative: Complex
    """(parameters, n)."""

    def strongest(self, s: complex, count: int = 1) -> list[tuple[str, complex]]:
        """The parameters that move the mode nearest to ``s`` most, the strongest first, and p·ds/dp in 1/s."""
        mode = int(np.argmin(np.abs(self.s - s)))
        order = np.argsort(-np.abs(self.relative[:, mode]), kind="stable")[:count].tolist()
        return [(self.parameters[k], complex(self.relative[k, mode])) for k in order]


def mode_movements(model: FullOrderModel, cell: int, parameters: Sequence[str] = RANKED) -> ModeMovements:
    """The sensitivities of :func:`mode_sensitivities` for all modes of a cell at once."""
    p = model.p[cell]
    z, right, left = model.eigen.values[cell], model.eigen.right[cell], model.eigen.left[cell]
    dA = parameter_sensitivities(model, cell, parameters)
    dz = ((left @ dA) * right.T).sum(axis=-1)
    values = np.array([p[PARAMETERS.index(name)] for name in parameters])
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = values[:, None] * dz / (z * model.T_s)
    return ModeMovements(to_continuous(z, model.T_s), tuple(parameters), np.where(np.isfinite(relative), relative, 0.0))


def parameter_locus(model: FullOrderModel, cell: int, parameter: str, values: Sequence[float] | Array) -> Complex:
    """Eigenvalues s (K, n) of one cell along any of PARAMETERS, tracked; NaN where there is no steady state.

    The steady state follows by Newton's method on the one-period map, from the cell's own value outwards. The
    controller's constants (its limits, ω₀C and ω₀L_1) do not change, as for the sensitivities.
    """
    if parameter not in PARAMETERS:
        raise ValueError(f'parameter = "{parameter}": must be one of {", ".join(PARAMETERS)}')
    column = PARAMETERS.index(parameter)
    wanted = np.asarray(values, dtype=float)
    spread: Complex = np.full((len(wanted), len(model.states)), np.nan + 0j)
    own = float(model.p[cell, column])
    for side in (np.flatnonzero(wanted >= own), np.flatnonzero(wanted < own)):
        z, p = model.z[cell].copy(), model.p[cell].copy()
        for k in sorted(side.tolist(), key=lambda index: abs(wanted[index] - own)):
            p[column] = wanted[k]
            found = _follow(model, z, p)
            if found is None:
                break
            z, A = found
            spread[k] = to_continuous(np.linalg.eigvals(A), model.T_s)
    good = np.flatnonzero(np.isfinite(spread.real).any(axis=1))
    spread[good] = track(spread[good])
    return spread


def _follow(model: FullOrderModel, z: Array, p: Array) -> tuple[Array, Array] | None:
    """The fixed point of the map at p by Newton's method from z, and the Jacobian there; None without convergence."""
    size = 1.0 + np.abs(z)
    for _ in range(_NEWTON_STEPS):
        A = np.array(model.map.linear(z, p)[0])
        gap = np.array(model.map.step(z, p)[0]).ravel() - z
        if not np.isfinite(gap).all():
            return None
        if np.max(np.abs(gap) / size) < _NEWTON_TOLERANCE:
            return z, A
        z = z - np.linalg.solve(A - np.eye(len(z)), gap)
    return None


def stability_limit(
    study: Study, law: GainLaw, scr: float, P: float, Q: float, bracket: tuple[float, float] = (0.05, 20.0)
) -> float:
    """The X/R at which the coupled reduced model loses stability at an SCR, by root finding (relative 1e-10).

    Below it the loop is unstable. Raises InfeasibleStudyError if the bracket contains no change of stability or no
    operating point.
    """
    from scipy.optimize import brentq

    def abscissa(log_ratio: float) -> float:
        R_g, L_g = grid_arrays(study, np.array([scr]), np.array([np.exp(log_ratio)]))
        cells = cells_under(study, law, R_g, L_g, P, Q)
        if not cells.good.all():
            return float("nan")
        return float(np.linalg.eigvals(reduced_cells(study, cells).A).real.max())

    grid = np.linspace(np.log(bracket[0]), np.log(bracket[1]), 60)
    values = np.array([abscissa(x) for x in grid])
    falls = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if falls.size == 0:
        raise InfeasibleStudyError(
            f"no loss of stability at SCR {scr:g} between X/R {bracket[0]:g} and {bracket[1]:g}: "
            f"{'stable wherever an operating point exists' if not (values > 0).any() else 'unstable throughout'}"
        )
    k = int(falls[-1])
    return float(np.exp(brentq(abscissa, grid[k], grid[k + 1], xtol=1e-11)))  # type: ignore[arg-type]


_QUANTITIES = {
    "i_s": "converter current",
    "v_c": "capacitor voltage",
    "i_g": "grid current",
    "pending": "delayed bridge voltage",
    "delta": "angle",
    "omega_i": "frequency integrator",
    "V": "voltage integrator",
    "P_f": "P filter",
    "Q_f": "Q filter",
    "ripple_P": "notch of P",
    "mean_P": "notch of P",
    "ripple_Q": "notch of Q",
    "mean_Q": "notch of Q",
    "xi_v": "voltage-loop integrators",
    "xi_i": "current-loop integrators",
    "i_f": "low-pass of the transient impedance",
    "v_dc": "voltage of the dc link",
    "p_dc": "power of the bridge in the period before",
    "dc_p": "power of the dc source",
}
LEAST_SHARE = 0.1
MOST_NAMED = 3
MODE_WORDS = {
    "swings": "a mode that swings at {:.3g} Hz in P and Q",
    "still": "a mode that does not swing",
    "grows": "and grows at {:.3g} 1/s",
    "decays": "and decays at {:.3g} 1/s",
    "whole": "{} {} (damping ratio {}; {})",
}
"""What is said of a mode; a page has the same words."""


def quantity_of(state: str) -> str:
    """The meaning of a state of the full-order model, both axes under one name; an unknown state has its own name."""
    for name in (state, state.removesuffix("_d").removesuffix("_q"), state.removesuffix("d").removesuffix("q")):
        if name in _QUANTITIES:
            return _QUANTITIES[name]
    return state


def shares_of(mode: Mode) -> dict[str, float]:
    """Participation by quantity, the largest first, from the states of the mode."""
    shares: dict[str, float] = {}
    for state, share in mode.participation:
        shares[quantity_of(state)] = shares.get(quantity_of(state), 0.0) + share
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def mode_in_words(mode: Mode) -> str:
    """Frequency, growth or decay rate, damping ratio, and the quantities with the largest participation."""
    rate, frequency, said = mode.s.real, abs(mode.s.imag) / (2.0 * math.pi), MODE_WORDS
    what = said["swings"].format(frequency) if frequency > 1e-3 * abs(rate) else said["still"]
    pace = said["grows" if rate > 0.0 else "decays"].format(abs(rate))
    named = [(name, share) for name, share in shares_of(mode).items() if share >= LEAST_SHARE][:MOST_NAMED]
    states = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in named)
    damping = f"{mode.damping:.2g}".replace("-", "−")
    return said["whole"].format(what, pace, damping, states)
