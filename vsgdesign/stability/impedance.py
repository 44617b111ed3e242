"""The converter as seen from the grid, in closed form from the sampled model.

The frame is the dq frame of the grid source, with peak components. Current is positive into the grid, so that i = −Y
v at the PCC.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid, pcc_voltage
from vsgdesign.model.full_order import INPUTS, OUTPUTS, PARAMETERS
from vsgdesign.operating_point.full_order import FullOrderModel
from vsgdesign.operating_point.plant import plant_step
from vsgdesign.operating_point.plants import state_matrices

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]


def output_admittance(model: FullOrderModel, cell: int, omega: Array) -> Complex:
    """dq output admittance Y (F, 2, 2) in S at the PCC, at frequencies ω (rad/s) in the dq frame.

    The converter is linearised in its steady state on its grid, and a small phasor is added to the source. The
    sampled states follow exactly from the one-period map. Between the samples, the held bridge voltage drives the
    circuit; only its component at the frequency of the perturbation is kept (:eq:`admittance`).
    """
    v, i = _port_phasors(model, cell, omega)
    return -i @ np.linalg.inv(v)


def _port_phasors(model: FullOrderModel, cell: int, omega: Array) -> tuple[Complex, Complex]:
    """v_pcc and i_g (F, 2, 2): dq phasors (rows) for a unit source phasor on d and on q (columns)."""
    p = dict(zip(PARAMETERS, model.p[cell], strict=False))
    circuit = FilterGrid(*(p[name] for name in FilterGrid._fields))
    omega_g, T_s = p["omega_g"], model.T_s
    A, b, e = state_matrices(circuit)
    transition = plant_step(circuit, T_s, omega_g, edges=False).transition
    count, n = len(omega), model.A.shape[1]
    source = _to_sequences(np.broadcast_to(np.eye(2, dtype=complex), (count, 2, 2)))

    # What the source adds to the sampled plant in one period, per sequence: frequencies ω_g ± ω in αβ.
    driven = []
    for sign, sequence in zip((1.0, -1.0), source, strict=True):
        Omega = omega_g + sign * omega
        inner = np.linalg.solve(1j * Omega[:, None, None] * np.eye(3) - A, np.broadcast_to(e[:, None], (count, 3, 1)))
        g = np.exp(1j * Omega * T_s)[:, None, None] * inner - transition @ inner
        g = g * np.exp(-1j * omega_g * T_s)
        driven.append((g if sign > 0.0 else g.conj()) @ sequence[:, None, :])
    forcing = np.zeros((count, n, 2), dtype=complex)
    forcing[:, 0:6:2], forcing[:, 1:6:2] = _from_sequences(*driven)
    states = np.linalg.solve(np.exp(1j * omega * T_s)[:, None, None] * np.eye(n) - model.A[cell], forcing)
    rows = [OUTPUTS.index("v_b_d"), OUTPUTS.index("v_b_q")]
    bridge = _to_sequences(model.C[cell, rows] @ states)

    ports = []
    for sign, v_b, v_g in zip((1.0, -1.0), bridge, source, strict=True):
        Omega = omega_g + sign * omega
        hold = np.exp(-0.5j * Omega * T_s) * np.sinc(0.5 * Omega * T_s / np.pi)
        resolvent = np.linalg.inv(1j * Omega[:, None, None] * np.eye(3) - A)
        if sign < 0.0:
            hold, resolvent = hold.conj(), resolvent.conj()
        x = resolvent @ (b[:, None] * (hold[:, None] * v_b)[:, None, :] + e[:, None] * v_g[:, None, :])
        ports.append((pcc_voltage(x[:, 0], x[:, 1], x[:, 2], v_g, circuit), x[:, 2]))
    v, i = (np.stack(_from_sequences(ports[0][k], ports[1][k]), axis=1) for k in (0, 1))
    return v, i


def _to_sequences(dq: Complex) -> tuple[Complex, Complex]:
    """Split (F, 2, m) dq phasors into the positive and the (conjugated) negative sequence of d + jq."""
    return 0.5 * (dq[:, 0] + 1j * dq[:, 1]), 0.5 * (dq[:, 0] - 1j * dq[:, 1])


def _from_sequences(positive: Complex, negative: Complex) -> tuple[Complex, Complex]:
    """Convert the two sequences back to d and q phasors."""
    return positive + negative, -1j * (positive - negative)


def grid_impedance(R_g: float, L_g: float, omega_g: float, omega: Array) -> Complex:
    """dq impedance (F, 2, 2) of an R–L grid in a frame that rotates with ω_g."""
    Z = np.empty((len(omega), 2, 2), dtype=complex)
    Z[:, 0, 0] = Z[:, 1, 1] = R_g + 1j * omega * L_g
    Z[:, 0, 1], Z[:, 1, 0] = -omega_g * L_g, omega_g * L_g
    return Z


def passivity_index(Y: Complex) -> Array:
    """Smallest eigenvalue of (Y + Yᴴ)/2 (F,), in S; negative where the converter can feed an oscillation."""
    hermitian = 0.5 * (Y + np.conj(np.swapaxes(Y, -1, -2)))
    return np.linalg.eigvalsh(hermitian)[..., 0].astype(float)


def generalised_nyquist(model: FullOrderModel, cell: int, omega: Array) -> Complex:
    """Eigenvalues (F, 2) of Z_g(jω) Y(jω), sorted into two continuous loci."""
    p = dict(zip(PARAMETERS, model.p[cell], strict=False))
    Z = grid_impedance(p["R_g"], p["L_g"], p["omega_g"], omega)
    loci = np.linalg.eigvals(Z @ output_admittance(model, cell, omega))
    for k in range(1, len(loci)):
        straight = abs(loci[k] - loci[k - 1]).sum()
        if abs(loci[k, ::-1] - loci[k - 1]).sum() < straight:
            loci[k] = loci[k, ::-1]
    return loci


def frequency_response(model: FullOrderModel, cell: int, input_: str, output: str, omega: Array) -> Complex:
    """Response (F,) of one output to one input of the sampled model. The input is held over each period."""
    column, row = INPUTS.index(input_), OUTPUTS.index(output)
    z = np.exp(1j * omega * model.T_s)
    n = model.A.shape[1]
    states = np.linalg.solve(z[:, None, None] * np.eye(n) - model.A[cell], model.B[cell, :, [column]].T.astype(complex))
    return (model.C[cell, row] @ states)[:, 0] + model.D[cell, row, column]


def network_frequency_perturbation(
    model: FullOrderModel, cell: int, omega: Array, S_rated: float, omega_n: float
) -> Complex:
    """ΔP over Δω_g in per unit of rating and of nominal frequency (F,), the ordinate of the NFP plot (:eq:`nfp`)."""
    return frequency_response(model, cell, "omega_g", "P", omega) * omega_n / S_rated
