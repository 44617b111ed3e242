"""A frequency scan of the converter in the time domain, with nothing of the library's models in it.

The source gets a small sinusoid on its d, then on its q axis. Between samples the circuit is propagated exactly, as one
matrix exponential of circuit, held bridge voltage and three oscillators (the source and its two sidebands); the
controller is the published one in complex numbers. Fourier integrals of the *continuous* v_pcc and i_g over whole
periods come from another exponential, so nothing is lost between the samples either.
"""

from __future__ import annotations

import cmath
import math
from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from tests.oracles.emt_circuit import circuit_matrices
from vsgdesign.linear.operating_point.full_order import Cell
from vsgdesign.linear.operating_point.sampled import steady_state
from vsgdesign.study.parameters import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def scan(study: Study, cell: Cell, hz: Array, settle_s: float, amplitude: float = 1e-4) -> Complex:
    """dq admittance (F, 2, 2) at the PCC in the source's frame, −i v⁻¹; every frequency whole periods in one second."""
    return np.stack([_at(study, cell, float(f), settle_s, amplitude) for f in hz])


def _at(study: Study, cell: Cell, hz: float, settle_s: float, amplitude: float) -> Complex:
    c, grid = study.converter, cell.grid
    source = cell.source or study.grid_source
    T = 1.0 / (c.f_sw * c.samples_per_carrier)
    window = round(1.0 / T)
    assert abs(window * T - 1.0) < 1e-12
    assert hz == round(hz)
    omega, omega_g = 2.0 * math.pi * hz, source.omega_g
    bands = np.array([omega_g, omega_g + omega, omega_g - omega])
    A, b, e = circuit_matrices(study, grid)
    M = np.zeros((7, 7), complex)
    M[:3, :3], M[:3, 3] = A, b
    M[:3, 4:] = e[:, None]
    M[4:, 4:] = np.diag(1j * bands)
    step = expm(M * T)[:3]
    # v_pcc = v_g + R_g i_g + L_g di_g/dt, and i_g, out of (x, v_b, v_g in three parts).
    v_row = grid.L_g * M[2].copy()
    v_row[2] += grid.R_g
    v_row[4:] += 1.0
    i_row = np.zeros(7, complex)
    i_row[2] = 1.0
    integrals = np.empty((2, 2, 7), complex)
    for k in (1, 2):
        big = np.zeros((14, 14), complex)
        big[:7, :7] = M - 1j * bands[k] * np.eye(7)
        big[:7, 7:] = np.eye(7)
        over = expm(big * T)[:7, 7:]
        integrals[k - 1, 0], integrals[k - 1, 1] = v_row @ over, i_row @ over
    start = steady_state(study, grid, source, study.converter.references(cell.P_ref, cell.Q_ref), cell.gains)
    s = start.controller
    state = np.array([s.theta, s.omega_i, s.V, s.P_f, s.Q_f])
    pi = np.array([complex(s.xi_vd, s.xi_vq), complex(s.xi_id, s.xi_iq)])
    peak = math.sqrt(2.0) * source.V_g_rms
    v, i = np.empty((2, 2), np.complex128), np.empty((2, 2), np.complex128)
    for axis, direction in enumerate((1.0, 1j)):
        sizes = np.array([peak, 0.5 * amplitude * peak * direction, 0.5 * amplitude * peak * direction], complex)
        sums = _compiled()(
            round(settle_s / T),
            window,
            start.plant[0::2] + 1j * start.plant[1::2],
            complex(*start.pending),
            state.copy(),
            pi.copy(),
            step,
            integrals,
            sizes,
            bands,
            constants(study, cell, T),
            c.delay_samples,
        )
        for port, target in ((0, v), (1, i)):
            plus, minus = sums[0, port], np.conj(sums[1, port])
            target[:, axis] = plus + minus, -1j * (plus - minus)
    return -i @ np.linalg.inv(v)


def constants(study: Study, cell: Cell, T: float) -> Complex:
    """What the controller multiplies with, all as complex numbers."""
    c, f, inner, g = study.converter, study.filter, study.inner_gains, cell.gains
    smoothing = [1.0 if tau == 0.0 else 1.0 - math.exp(-T / tau) for tau in (study.tau_P, study.tau_Q)]
    lead = cmath.exp(1j * c.omega_n * (c.delay_samples + 0.5) * T)
    return np.array([
        T, g.K_ip, g.D_p, g.K_iq, g.D_q, cell.P_ref, cell.Q_ref, c.omega_n, c.V_rated_rms,
        inner.K_pv, inner.K_iv, inner.K_pc, inner.K_ic, inner.K_ff,
        1j * c.omega_n * f.C, 1j * c.omega_n * f.L_1, lead, f.R_c, smoothing[0], smoothing[1],
        g.K_pq, g.K_qp, g.k_P, g.k_Q,
    ], complex)  # fmt: skip


@cache
def _compiled():
    return numba.njit(_run)


def _run(settle, window, x, pending, state, pi, step, integrals, sizes, bands, k, delay):
    T = k[0].real
    sums = np.zeros((2, 2), np.complex128)
    X = np.zeros(7, np.complex128)
    for n in range(settle + window):
        theta, omega_i, V = state[0], state[1], state[2]
        v = x[1] + k[17] * (x[0] - x[2])
        S = 1.5 * v * np.conj(x[2])
        P = state[3] + k[18].real * (S.real - state[3])
        Q = state[4] + k[19].real * (S.imag - state[4])
        omega = omega_i - k[22].real * P - k[23].real * (Q + k[4].real * V)
        e_P = k[5].real - P + k[2].real * (k[7].real - omega)
        e_Q = k[6].real - Q + k[4].real * (k[8].real - V)

        frame = np.exp(-1j * theta)
        v_dq, i_s, i_g = v * frame, x[0] * frame, x[2] * frame
        error = math.sqrt(2.0) * V - v_dq
        i_ref = k[9] * error + pi[0] + k[13] * i_g + k[14] * v_dq
        pi[0] += T * k[10] * error
        v_b = k[11] * (i_ref - i_s) + pi[1] + v_dq + k[15] * i_s
        pi[1] += T * k[12] * (i_ref - i_s)
        v_b = v_b / frame * k[16]
        state[0] = (theta + T * omega) % (2.0 * math.pi)
        state[1] = omega_i + T * (k[1].real * e_P + k[20].real * e_Q)
        state[2] = V + T * (k[21].real * e_P + k[3].real * e_Q)
        state[3], state[4] = P, Q
        applied = v_b
        if delay == 1:
            applied = pending
            pending = v_b

        for m in range(3):  # as a slice, the message of an error is compiled too, and takes longer than all the rest
            X[m] = x[m]
        X[3] = applied
        for m in range(3):
            X[4 + m] = sizes[m] * np.exp(1j * (bands[m] * (n * T)))
        if n >= settle:
            for band in range(2):
                turn = np.exp(-1j * (bands[band + 1] * (n * T)))
                for port in range(2):
                    total = 0j
                    for j in range(7):
                        total += integrals[band, port, j] * X[j]
                    sums[band, port] += total * turn
        following = np.zeros(3, np.complex128)
        for row in range(3):
            for j in range(7):
                following[row] += step[row, j] * X[j]
        x = following
    return sums / (window * T)
