"""Cells whose modes are defective: no basis of eigenvectors, so a sum over modes is wrong or cannot be formed.

Systems are built from Jordan blocks, whose resolvent is known in closed form: 1/(z − a)ᵏ⁺¹ on the k-th diagonal.
"""

from __future__ import annotations

from typing import Any, cast

import control
import numpy as np
import pytest
from numpy.typing import NDArray

from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.loops import BREAKS, FullOrderLoop
from vsgdesign.linear.stability.step_responses import full_order_step
from vsgdesign.metrics.modes import partial_fractions

T_S = 1e-4
ORDER = 9
SPREAD = [0.1 * k for k in range(1, 8)]
POLES = {
    "two equal": [0.9, 0.9, *SPREAD],
    "chain at zero": [0.0, 0.0, 0.0, *SPREAD[1:]],
    "all in one": [0.5] * ORDER,
    "a hair apart": [0.9, 0.9 + 1e-9, *SPREAD],
    "simple": [0.1 * k for k in range(1, 10)],
}
OMEGA = np.geomspace(10.0, 0.99 * np.pi / T_S, 40)


def jordan(poles: list[float]) -> NDArray[np.float64]:
    """Equal and nearly equal neighbours are coupled."""
    return np.diag(poles) + np.diag(np.where(np.abs(np.diff(poles)) < 1e-8, 1.0, 0.0), k=1)


def resolvent(J: NDArray[np.float64], z: complex) -> NDArray[np.complex128]:
    """(zI − J)⁻¹ of an upper bidiagonal J as products: no solver and no eigenvector."""
    R = np.zeros(J.shape, dtype=complex)
    for i in range(ORDER):
        product = 1.0 / (z - J[i, i])
        R[i, i] = product
        for k in range(i + 1, ORDER):
            product = product * J[k - 1, k] / (z - J[k, k])
            R[i, k] = product
    return R


def model(rotated: bool) -> tuple[FullOrderModel, list[NDArray[np.float64]], NDArray[np.float64]]:
    """One cell per entry of POLES; ``rotated``: in other coordinates, so that no structure helps."""
    rng = np.random.default_rng(5)
    Q = np.linalg.qr(rng.normal(size=(ORDER, ORDER)))[0] if rotated else np.eye(ORDER)
    parts = [jordan(poles) for poles in POLES.values()]
    A = np.array([Q @ J @ Q.T for J in parts])
    B = rng.normal(size=(len(A), ORDER, len(INPUTS)))
    C = rng.normal(size=(len(A), len(OUTPUTS), ORDER))
    D = np.zeros((len(A), len(OUTPUTS), len(INPUTS)))
    empty = np.zeros((len(A), 0))
    none = cast(Any, None)
    states = tuple(f"x{k}" for k in range(ORDER))
    made = FullOrderModel(
        states=states,
        T_s=T_S,
        z=empty,
        p=empty,
        A=A,
        B=B,
        C=C,
        D=D,
        index=np.arange(len(A)),
        faults=(None,) * len(A),
        map=none,
    )
    return made, parts, Q


@pytest.mark.parametrize("rotated", [False, True])
@pytest.mark.parametrize("broken_at", BREAKS)
def test_sensitivity_of_defective_cells(rotated: bool, broken_at: str) -> None:
    made, parts, Q = model(rotated)
    ports = ("P_meas", "Q_meas", "P", "Q") if broken_at == "output" else ("theta_cmd", "V_cmd", "delta", "V")
    columns, rows = [INPUTS.index(n) for n in ports[:2]], [OUTPUTS.index(n) for n in ports[2:]]
    loop = FullOrderLoop(made, broken_at)
    on = loop.on(OMEGA)
    for cell, J in enumerate(parts):
        b, c = Q.T @ made.B[cell][:, columns], made.C[cell][rows] @ Q
        at = loop.at(np.full(len(OMEGA), cell), OMEGA)
        for k, omega in enumerate(OMEGA):
            expected = c @ resolvent(J, np.exp(1j * omega * T_S)) @ b + np.eye(2)
            # The nearest pole is 0.1 away and up to nine deep: 1e9 times rounding of J's own rotation at worst.
            scale = np.abs(expected).max()
            np.testing.assert_allclose(on[cell, k], expected, rtol=0.0, atol=1e-8 * scale, err_msg=f"{cell}")
            np.testing.assert_allclose(at[k], on[cell, k], rtol=0.0, atol=1e-8 * scale)


def test_only_defective_cells_are_told_apart() -> None:
    for rotated in (False, True):
        made, _, _ = model(rotated)
        told = partial_fractions(made.A, made.B, made.C).usable
        assert dict(zip(POLES, told.tolist(), strict=True)) == {name: name == "simple" for name in POLES}


def test_units_of_the_states_have_no_say() -> None:
    made, _, _ = model(rotated=True)
    units = np.diag(10.0 ** np.linspace(-6.0, 6.0, ORDER))
    A, B, C = units @ made.A @ np.linalg.inv(units), units @ made.B, made.C @ np.linalg.inv(units)
    assert partial_fractions(A, B, C).usable.tolist() == [name == "simple" for name in POLES]


@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize("rotated", [False, True])
def test_step_responses_of_defective_cells(rotated: bool, every: int) -> None:
    made, _, _ = model(rotated)
    row, column, count = OUTPUTS.index("P"), INPUTS.index("P_ref"), 200
    t, y = full_order_step(made, "P_ref", "P", count * T_S, every)
    np.testing.assert_allclose(t, np.arange(0, count + 1, every) * T_S, rtol=1e-14)
    for cell in range(len(made.A)):
        system = control.ss(made.A[cell], made.B[cell][:, [column]], made.C[cell][[row]], 0.0, T_S)
        inputs: Any = np.ones(count + 1)
        expected = control.forced_response(system, np.arange(count + 1) * T_S, inputs).outputs
        np.testing.assert_allclose(y[cell], expected[::every], rtol=1e-9, atol=1e-9 * np.abs(expected).max())
