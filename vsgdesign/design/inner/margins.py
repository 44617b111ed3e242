"""Margins of one complex loop that is broken at the bridge: compiled, over M laws × G circuits × frequencies."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.inner.frozen import MEASURED, Complex, Plants

Array = NDArray[np.float64]

FIGURES = ("disk", "sensors", "noise")

_WIDTHS = (-1.0, 0.0, 1.0)
"""Where a mode's peak is looked at, in half-widths (−Re s) from its frequency."""

_LOWEST = 2.0
"""rad/s: below it the loop's integrators leave nothing of S."""
_LINEAR_FROM = 0.2
"""Share of the Nyquist frequency from which the points are evenly spaced: filter resonances lie there."""


def frequencies(T_s: float, points: int) -> Array:
    """``points`` frequencies a sign, rad/s, ascending: a third of them logarithmic to a fifth of Nyquist, then linear.

    Both signs: a complex loop answers differently to them.
    """
    nyquist = np.pi / T_s
    few = points // 3
    low = np.geomspace(_LOWEST, _LINEAR_FROM * nyquist, few)
    high = np.linspace(_LINEAR_FROM * nyquist, nyquist, points - few + 1)[1:]
    positive = np.concatenate([low, high])
    return np.concatenate([-positive[::-1], positive])


class Rational(NamedTuple):
    """From the law's output to v, i_s, i_g of each circuit, as a quotient of polynomials in z."""

    numerator: Complex
    """(G, 3 sensors, 3), highest power first."""
    denominator: Complex
    """(G, 4)."""
    late: complex
    """What the computed voltage has become when it acts, times z where that is a sample later; 0 without delay."""


def rational(circuits: Plants) -> Rational:
    """C adj(zI − A) b over det(zI − A), by Faddeev and LeVerrier."""
    A, b = circuits.A, circuits.b
    eye = np.eye(3)
    trace = np.trace(A, axis1=1, axis2=2)
    first = A - trace[:, None, None] * eye
    c_1 = -0.5 * np.trace(A @ first, axis1=1, axis2=2)
    second = A @ first + c_1[:, None, None] * eye
    c_0 = -np.trace(A @ second, axis1=1, axis2=2) / 3.0
    adjugate_b = np.stack([b, (first @ b[..., None])[..., 0], (second @ b[..., None])[..., 0]], axis=-1)
    numerator = circuits.sensors @ adjugate_b
    denominator = np.stack([np.ones(len(A)), -trace, c_1, c_0], axis=-1).astype(complex)
    return Rational(numerator, denominator, circuits.turn if circuits.delay else 0j)


def margins(law: Complex, circuits: Plants, modes: Complex, omega: Array, scales: Array) -> Array:
    """FIGURES (M, G, 3) of M stable loops: disk margin, all-sensor margin, noise gain.

    Peaks are looked for at ``omega`` (rad/s, both signs) and about every mode (M, G, n). ``scales`` (3): what one per
    cent is of each sensor, over one per cent of the base voltage. (:eq:`inner-disk-margin`, :eq:`all-sensor-margin`,
    :eq:`inner-noise`)
    """
    plant = rational(circuits)
    half = 0.5 * (omega[1:] - omega[:-1])
    weights = np.concatenate([[half[0]], half[1:] + half[:-1], [half[-1]]]) / (omega[-1] - omega[0])
    z = np.exp(1j * omega * circuits.T_s)
    return _margins(
        np.ascontiguousarray(law),
        plant.numerator,
        plant.denominator,
        plant.late,
        np.ascontiguousarray(modes),
        z,
        weights,
        scales,
        circuits.T_s,
    )


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _controller(law: Any, late: complex, z: complex, K: Any) -> None:
    """K (3): the law's output per v, i_s and i_g at z, its memory eliminated in the order i_f, ξ_v, ξ_i, u."""
    xi_v, xi_i, i_f, u = 3, 4, 5, 6
    per_i_f = 1.0 / (z - law[3, i_f])
    per_xi_v = 1.0 / (z - law[1, xi_v])
    per_xi_i = law[0, xi_i] / (z - law[2, xi_i])
    closed = 1.0 / (1.0 - (law[0, u] + per_xi_i * law[2, u]) * late / z)
    for k in range(MEASURED):
        f = law[3, k] * per_i_f
        x = (law[1, k] + law[1, i_f] * f) * per_xi_v
        direct = law[0, k] + law[0, xi_v] * x + law[0, i_f] * f
        K[k] = closed * (direct + per_xi_i * (law[2, k] + law[2, xi_v] * x + law[2, i_f] * f))


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _plant(numerator: Any, denominator: Any, late: complex, z: complex, G: Any) -> None:
    """G (3): v, i_s and i_g per output of the law."""
    scale = 1.0 / (((z + denominator[1]) * z + denominator[2]) * z + denominator[3])
    if late != 0.0:
        scale = scale * late / z
    for k in range(MEASURED):
        G[k] = ((numerator[k, 0] * z + numerator[k, 1]) * z + numerator[k, 2]) * scale


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _at(K: Any, G: Any) -> Any:
    """|S − ½|², (Σ|G_i K_i||S|)² and |S|² of one frequency."""
    L, each = 0.0j, 0.0
    for k in range(MEASURED):
        part = G[k] * K[k]
        L -= part
        each += np.sqrt(part.real * part.real + part.imag * part.imag)
    S = 1.0 / (1.0 + L)
    size = S.real * S.real + S.imag * S.imag
    return size - S.real + 0.25, each * each * size, size


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _margins(
    laws: Any,
    numerators: Any,
    denominators: Any,
    late: complex,
    modes: Any,
    z: Any,
    weights: Any,
    scales: Any,
    T_s: float,
) -> Any:
    count_laws, count_plants, points = len(laws), len(numerators), len(z)
    G = np.empty((count_plants, points, MEASURED), dtype=np.complex128)
    for g in range(count_plants):
        for f in range(points):
            _plant(numerators[g], denominators[g], late, z[f], G[g, f])
    K = np.empty((points, MEASURED), dtype=np.complex128)
    noise_of_K = np.empty(points)
    K_at, G_at = np.empty(MEASURED, dtype=np.complex128), np.empty(MEASURED, dtype=np.complex128)
    found = np.empty((count_laws, count_plants, 3))
    for m in range(count_laws):
        for f in range(points):
            _controller(laws[m], late, z[f], K[f])
            power = 0.0
            for k in range(MEASURED):
                part = K[f, k] * scales[k]
                power += part.real * part.real + part.imag * part.imag
            noise_of_K[f] = power * weights[f]
        for g in range(count_plants):
            disk, sensors, noise = 0.0, 0.0, 0.0
            for f in range(points):
                near, each, size = _at(K[f], G[g, f])
                disk, sensors = max(disk, near), max(sensors, each)
                noise += noise_of_K[f] * size
            for mode in range(modes.shape[2]):
                s = modes[m, g, mode]
                for width in _WIDTHS:
                    angle = (s.imag - width * s.real) * T_s
                    if abs(angle) <= np.pi:  # false for the mode at −∞, too
                        point = np.cos(angle) + 1j * np.sin(angle)
                        _controller(laws[m], late, point, K_at)
                        _plant(numerators[g], denominators[g], late, point, G_at)
                        near, each, size = _at(K_at, G_at)
                        disk, sensors = max(disk, near), max(sensors, each)
            found[m, g, 0] = 1.0 / np.sqrt(disk)
            found[m, g, 1] = 1.0 / np.sqrt(sensors)
            found[m, g, 2] = np.sqrt(noise)
    return found
