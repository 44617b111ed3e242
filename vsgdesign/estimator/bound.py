"""Cramér–Rao bounds: how precise any unbiased estimator of the grid can be with given signals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.identification.classical import space_vector_variance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bound:
    """Least standard deviations: of R_g in Ω, of L_g in H, of Z relative to |Z|. Infinite: not identifiable."""

    R_g: float
    L_g: float
    Z: float


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviation of one sample of one phase's sensor, V and A, independent from sample to sample."""

    v: float
    i: float


def phasor_variance(deviation: float, samples: float, channels: str = "alpha_beta") -> float:
    """E|n|² of a phasor over ``samples`` samples, as space vector or from phase A (:eq:`phasor-noise`)."""
    if channels == "phase_a":
        return 4.0 * deviation**2 / samples
    return space_vector_variance(deviation) / samples


def fisher_information(
    i: ArrayLike,
    omega: ArrayLike,
    v_variance: float,
    i_variance: float,
    R_g: float,
    L_g: float,
    nuisance: ArrayLike | None = None,
) -> Array:
    """(2, 2) information on (R_g, L_g) from M phasors of v and i (:eq:`fisher-information`).

    ``i`` (M,) are the true currents (A peak), ``omega`` their angular frequencies in the stationary frame, the
    variances E|n|² of a phasor of v and i (V², A²). ``nuisance`` (M, K), complex: how K unknown *complex* numbers
    enter the M equations; the grid's own phasor is a column with ones at the fundamental.
    """
    i = np.atleast_1d(np.asarray(i, dtype=complex))
    omega = np.broadcast_to(np.asarray(omega, dtype=float), i.shape)
    # Ideal sensors: as good as none, so that the information is large and not infinite.
    weight = 2.0 / (1e-30 + v_variance + np.abs(R_g + 1j * omega * L_g) ** 2 * i_variance)
    rows = np.column_stack([i, 1j * omega * i])
    if nuisance is not None:
        # Unknown complex numbers: a complex projection takes them out.
        root = np.sqrt(weight)[:, None]
        basis, _ = np.linalg.qr(root * np.asarray(nuisance, dtype=complex))
        scaled = root * rows
        left = scaled - basis @ (basis.conj().T @ scaled)
        rounding = 1e-10 * np.linalg.norm(scaled, axis=0)
        rows = np.where(np.linalg.norm(left, axis=0) > rounding, left, 0.0) / root
    return np.real(rows.conj().T @ (weight[:, None] * rows))


def bound_of(information: Array, omega: float, R_g: float, L_g: float) -> Bound:
    """The bound of (R_g, L_g), both unknown (:eq:`cramer-rao`); infinite where the information is singular."""
    scale = np.array([1.0, 1.0 / omega])  # both in Ω
    scaled = information * np.outer(scale, scale)
    values = np.linalg.eigvalsh(scaled)
    if not values[0] > 1e-12 * values[-1]:
        return Bound(math.inf, math.inf, math.inf)
    R_var, X_var = np.diag(np.linalg.inv(scaled))
    size = math.hypot(R_g, omega * L_g)
    return Bound(math.sqrt(R_var), math.sqrt(X_var) / omega, math.sqrt(R_var + X_var) / size)


def bound_of_known_ratio(information: Array, R_g: float, L_g: float) -> Bound:
    """The bound where X/R is known, so that R_g and L_g are one number (:eq:`cramer-rao-ratio`)."""
    direction = np.array([R_g, L_g])
    known = float(direction @ information @ direction)
    share = 1.0 / math.sqrt(known) if known > 0.0 else math.inf
    return Bound(share * R_g, share * L_g, share)


def steady_window_bound(
    i: complex,
    omega: float,
    noise: SensorNoise,
    samples: int,
    R_g: float,
    L_g: float,
    *,
    channels: str = "phase_a",
    known_ratio: bool = False,
    known_phase: bool = True,
) -> Bound:
    """The bound of one steady window (:eq:`bound-steady`) with the current ``i`` (A peak) at ω (rad/s).

    ``known_phase``: whether the grid's phasor is known, as published. Without it, the bound is infinite.
    ``known_ratio``: whether X/R is known.
    """
    v_variance, i_variance = (phasor_variance(deviation, samples, channels) for deviation in (noise.v, noise.i))
    information = fisher_information(i, omega, v_variance, i_variance, R_g, L_g, None if known_phase else [[1.0]])
    return bound_of_known_ratio(information, R_g, L_g) if known_ratio else bound_of(information, omega, R_g, L_g)


def windows_bound(i: ArrayLike, omega: float, noise: SensorNoise, samples: int, R_g: float, L_g: float) -> Bound:
    """The bound of M steady windows of one grid whose phasor is unknown but constant (:eq:`bound-two-windows`).

    ``i`` (M,) are the currents of the windows, A peak, of ``samples`` samples each; ω in rad/s.
    """
    i = np.asarray(i, dtype=complex)
    v_variance, i_variance = (phasor_variance(deviation, samples) for deviation in (noise.v, noise.i))
    information = fisher_information(i, omega, v_variance, i_variance, R_g, L_g, np.ones((len(i), 1)))
    return bound_of(information, omega, R_g, L_g)


def probe_bound(
    i: ArrayLike, omega: ArrayLike, omega_g: float, noise: SensorNoise, samples: float, R_g: float, L_g: float
) -> Bound:
    """The bound of a probe with M lines beside the fundamental (:eq:`bound-probe`).

    ``i`` (M,) are the true currents of the lines, A peak, at ``omega`` (M,) rad/s in the stationary frame, measured
    over ``samples`` samples. An injection has one line, a binary sequence has many.
    """
    v_variance, i_variance = (phasor_variance(deviation, samples) for deviation in (noise.v, noise.i))
    return bound_of(fisher_information(i, omega, v_variance, i_variance, R_g, L_g), omega_g, R_g, L_g)


def tracked_probe_bound(
    i: ArrayLike,
    omega: ArrayLike,
    omega_g: float,
    noise: SensorNoise,
    samples: float,
    memory: float,
    R_g: float,
    L_g: float,
) -> Bound:
    """The bound of a probe that is tracked with exponential forgetting (:eq:`bound-tracked`).

    ``i`` (M,) are the true currents of its lines at ``omega`` (M,) rad/s, and a cycle has ``samples`` samples. With
    every cycle, the weight of the cycles before falls by the factor 1 − 1/``memory``.
    """
    return probe_bound(i, omega, omega_g, noise, samples * effective_cycles(memory), R_g, L_g)


def effective_cycles(memory: float) -> float:
    """Number of equally weighted cycles whose mean has the noise of one with the weights λ^k, λ = 1 − 1/``memory``.

    It is 2·memory − 1 (:eq:`bound-tracked`). Raises ValueError for a memory below 1.
    """
    if not memory >= 1.0:
        raise ValueError(f"memory = {memory:g} cycles: must be at least 1.")
    return 2.0 * memory - 1.0


def sensor_noise(
    converter: Any, noise: tuple[float, float], adc_bits: int = 0, adc_range_pu: float = 3.0
) -> SensorNoise:
    """Noise of a recipe's sensors in V and A: white, and the rounding of the conversion as if it were white."""
    from vsgdesign.equations.frames import rms_to_peak

    step = 2.0 * adc_range_pu / 2.0**adc_bits if adc_bits else 0.0
    ratings = (rms_to_peak(converter.V_rated_rms), converter.I_rated_pk)
    v, i = (rated * math.sqrt(share**2 + step**2 / 12.0) for rated, share in zip(ratings, noise, strict=True))
    return SensorNoise(v, i)
