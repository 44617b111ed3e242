"""Compiled figures of many small linear systems: step responses and disk margins. Knows no equation of the plant."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from vsgdesign.metrics.step_response import SETTLING_BAND

FIGURES = ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q", "cross_P", "cross_Q", "disk_margin")
"""Columns of :func:`figures`. Overshoots and cross peaks are fractions of the step, settling times in s."""

STEPS_PER_SETTLING = 40
"""Time steps within a settling time: the peak of a response is then met to 1e-4 of the step."""

HORIZON = 3.2
"""How long a response is looked at, in settling times."""

_TAYLOR = 10
_HALF_NORM = 0.5


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _transition(A: Any, h: float) -> Any:
    """exp(A h) and ∫ exp(A s) ds over h, by scaling and squaring of Taylor series (to rounding for ‖A h‖ ≤ 1/2)."""
    n = A.shape[0]
    norm = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(A[i, j])
        norm = max(norm, row * h)
    squarings = 0
    while norm > _HALF_NORM:
        norm *= 0.5
        squarings += 1
    step = h / 2.0**squarings
    phi, psi = np.eye(n), np.eye(n) * step
    term = np.eye(n)
    for k in range(1, _TAYLOR + 1):
        term = (term @ A) * (step / k)
        phi += term
        psi += term * (step / (k + 1))
    for _ in range(squarings):
        psi = psi + phi @ psi
        phi = phi @ phi
    return phi, psi


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _one_step(phi: Any, drive: Any, own: Any, cross: Any, final: float, h: float, steps: int) -> Any:
    """Overshoot and settling of the own channel and the cross channel's peak, after a unit step of one input."""
    n = len(drive)
    x, new = np.zeros(n), np.zeros(n)
    overshoot, settled, before, peak = 0.0, 0.0, 1.0, 0.0
    for k in range(1, steps + 1):
        y, z = 0.0, 0.0
        for i in range(n):
            value = drive[i]
            for j in range(n):
                value += phi[i, j] * x[j]
            new[i] = value
            y += own[i] * value
            z += cross[i] * value
        x, new = new, x
        peak = max(peak, abs(z))
        overshoot = max(overshoot, y / final - 1.0)
        error = abs(y / final - 1.0)
        if error > SETTLING_BAND:
            settled = np.inf
        elif before > SETTLING_BAND:
            settled = (k - (SETTLING_BAND - error) / (before - error)) * h
        before = error
    return overshoot, settled, peak


@numba.njit(inline="always")
def _square(z: Any) -> Any:
    return z.real * z.real + z.imag * z.imag


@numba.njit(inline="always")
def _size(z: Any) -> Any:
    return abs(z.real) + abs(z.imag)


@numba.njit(inline="always")
def _inverse(z: Any) -> Any:
    """1/z without the guards against overflow that make a complex division slow."""
    return z.conjugate() * (1.0 / (z.real * z.real + z.imag * z.imag))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _loop_at(A_K: Any, B_K: Any, C_K: Any, J: Any, omega: float, work: Any) -> Any:
    """J K(jω), 2×2, with K = C_K (jω − A_K)⁻¹ B_K by elimination with partial pivoting."""
    n = A_K.shape[0]
    for i in range(n):
        for j in range(n):
            work[i, j] = -A_K[i, j]
        work[i, i] += 1j * omega
        work[i, n] = B_K[i, 0]
        work[i, n + 1] = B_K[i, 1]
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if _size(work[i, k]) > _size(work[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(k, n + 2):
                held = work[k, j]
                work[k, j] = work[pivot, j]
                work[pivot, j] = held
        inverse = _inverse(work[k, k])
        work[k, k] = inverse
        for i in range(k + 1, n):
            if work[i, k] != 0.0:
                factor = work[i, k] * inverse
                for j in range(k + 1, n + 2):
                    work[i, j] -= factor * work[k, j]
    for column in range(n, n + 2):
        for i in range(n - 1, -1, -1):
            value = work[i, column]
            for j in range(i + 1, n):
                value -= work[i, j] * work[j, column]
            work[i, column] = value * work[i, i]  # its inverse is kept there
    k11, k12, k21, k22 = 0j, 0j, 0j, 0j
    for i in range(n):
        k11 += C_K[0, i] * work[i, n]
        k12 += C_K[0, i] * work[i, n + 1]
        k21 += C_K[1, i] * work[i, n]
        k22 += C_K[1, i] * work[i, n + 1]
    return (
        J[0, 0] * k11 + J[0, 1] * k21,
        J[0, 0] * k12 + J[0, 1] * k22,
        J[1, 0] * k11 + J[1, 1] * k21,
        J[1, 0] * k12 + J[1, 1] * k22,
    )


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _disk_margin(A_K: Any, B_K: Any, C_K: Any, J: Any, omegas: Any) -> float:
    """Least balanced disk margin at the plant's output over a frequency grid (:eq:`disk-margin`)."""
    n = A_K.shape[0]
    work = np.empty((n, n + 2), dtype=np.complex128)
    largest = 0.0
    for omega in omegas:
        l11, l12, l21, l22 = _loop_at(A_K, B_K, C_K, J, omega, work)
        a11, a12, a21, a22 = 1.0 - l11, -l12, -l21, 1.0 - l22
        inverse = _inverse(a11 * a22 - a12 * a21)
        m11, m12, m21, m22 = a22 * inverse - 0.5, -a12 * inverse, -a21 * inverse, a11 * inverse - 0.5
        t = _square(m11) + _square(m22) + 2.0 * np.sqrt(_square(m12 * m21))
        d = _square(m11 * m22 - m12 * m21)
        largest = max(largest, 0.5 * (t + np.sqrt(max(t * t - 4.0 * d, 0.0))))
    return 1.0 / np.sqrt(largest)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def figures(
    A: Any,
    B: Any,
    C: Any,
    A_K: Any,
    B_K: Any,
    C_K: Any,
    J: Any,
    final_Q: Any,
    stable: Any,
    settling: float,
    omegas: Any,
) -> Any:
    """FIGURES (N, 7) of N closed loops: A (N, n, n), B (N, n, 2) from (P_ref, Q_ref), C (N, 2, n) to (P, Q).

    ``final_Q`` (N,): what Q goes to after a unit step of its reference (its droop keeps some). Unstable loops
    have infinite figures and no margin.
    """
    count = len(A)
    out = np.empty((count, 7))
    h = settling / STEPS_PER_SETTLING
    steps = int(HORIZON * STEPS_PER_SETTLING)
    for k in range(count):
        if not stable[k]:
            out[k, :6] = np.inf
            out[k, 6] = 0.0
            continue
        phi, psi = _transition(A[k], h)
        drive_P, drive_Q = psi @ B[k, :, 0].copy(), psi @ B[k, :, 1].copy()
        out[k, 0], out[k, 1], out[k, 5] = _one_step(phi, drive_P, C[k, 0], C[k, 1], 1.0, h, steps)
        out[k, 2], out[k, 3], out[k, 4] = _one_step(phi, drive_Q, C[k, 1], C[k, 0], final_Q[k], h, steps)
        out[k, 6] = _disk_margin(A_K[k], B_K[k], C_K[k], J[k], omegas)
    return out
