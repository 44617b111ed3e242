"""The frozen model is the full-order model without its power loops, and its margins are those of that model's loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

from tests.design.inner.systems import datasheet
from vsgdesign.design.inner.frozen import INPUTS, frequencies, law_answers, law_matrix, margins, matrices, modes, plants
from vsgdesign.design.inner.grids import GridBox, circuits, lattice, study_of
from vsgdesign.design.inner.promises import controller_settings
from vsgdesign.design.inner.search import closed_form_starts
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.grid import Place

CASES = ("hoang2025_5kva", "lab_12kva_lcl", "utility_1mva_60hz", "sized_5mva_3300v", "sized_50kva_208v_60hz")
GRIDS = ((1.5, 0.5), (4.0, 2.0), (20.0, 20.0))


def one(gains: InnerLoopGains) -> InnerLoopGains:
    return InnerLoopGains(*(np.array([float(value)]) for value in gains))


def frozen_modes(c: Converter, f: Filter, gains: InnerLoopGains, omega_t: float, points: tuple) -> np.ndarray:
    settings = controller_settings(c, f)
    law = law_matrix(one(gains), np.array([omega_t]), settings)
    return modes(law, plants(circuits(c, f, points, "impedance"), settings, c.delay_samples, c.omega_n))[0]


@pytest.mark.parametrize("transient", [True, False])
@pytest.mark.parametrize("case", CASES)
def test_modes_are_those_of_the_full_order_with_power_loops_at_rest(case: str, transient: bool) -> None:
    """With power gains of nearly zero the full-order model has the frozen modes, their conjugates and three at rest."""
    c, f = datasheet(case)
    gains, omega_t = closed_form_starts(c, f, 10.0)[0]
    if not transient:
        gains = gains._replace(R_t=0.0, X_t=0.0, kappa=0.0)
    still = PowerLoopGains(K_ip=1e-12 / c.S_rated, D_p=0.0, K_iq=1e-12 / c.S_rated, D_q=0.0)
    study = study_of(c, f, gains, omega_t, tau=0.0)
    grids = [Place(scr, x_over_r, "impedance").grid(c) for scr, x_over_r in GRIDS]
    model = linearise_full_order(study, [Cell(grid, still, 0.1 * c.S_rated, 0.0) for grid in grids])
    assert all(fault is None for fault in model.faults)
    found = frozen_modes(c, f, gains, omega_t, GRIDS)
    assert found.shape[-1] == 6 + c.delay_samples - (0 if transient else 1)
    for full, frozen in zip(np.linalg.eigvals(model.A), np.exp(found * c.T_s), strict=True):
        both = np.concatenate([frozen, frozen.conj(), np.ones(3)])
        assert len(full) == len(both)
        far = np.abs(full[:, None] - both[None, :])
        rows, columns = linear_sum_assignment(far)
        moving = columns < 2 * len(frozen)  # the three at rest form a Jordan block, which rounding spreads
        assert far[rows, columns][moving].max() < 1e-11


def test_d_and_q_are_alike() -> None:
    """The law answers j to j: one complex coefficient says all. Read off the answers to a unit on the q axis."""
    c, f = datasheet("lab_12kva_lcl")
    gains, omega_t = closed_form_starts(c, f, 10.0)[0]
    settings = study_of(c, f, gains, omega_t).controller_settings()._replace(i_max_pk=1e9, v_max_pk=1e9)
    law = law_matrix(one(gains), np.array([omega_t]), settings)[0]
    for k in range(len(INPUTS)):
        d, q = np.zeros(len(INPUTS)), np.eye(len(INPUTS))[k]
        answer = law_answers(d, q, gains, settings)
        complex_answer = np.array(answer[0::2]) + 1j * np.array(answer[1::2])
        np.testing.assert_allclose(complex_answer, 1j * law[:, k], rtol=1e-12, atol=1e-15)


def loop_by_states(c: Converter, f: Filter, law: np.ndarray, point: tuple, z: np.ndarray) -> tuple:
    """S and G_i K_i at z from the closed loop's own states, without any elimination: an independent way."""
    settings = controller_settings(c, f)
    circuit = circuits(c, f, [point], "impedance")[0]
    # The circuit again from its differential equation and SciPy's exponential.
    Lo, Ro = circuit.L_2 + circuit.L_g, circuit.R_2 + circuit.R_g
    A = np.array(
        [
            [-(circuit.R_1 + circuit.R_c) / circuit.L_1, -1 / circuit.L_1, circuit.R_c / circuit.L_1],
            [1 / circuit.C, 0.0, -1 / circuit.C],
            [circuit.R_c / Lo, 1 / Lo, -(Ro + circuit.R_c) / Lo],
        ]
    )
    M = np.zeros((4, 4))
    M[:3, :3], M[0, 3] = A * settings.T_s, settings.T_s / circuit.L_1
    E = expm(M)
    turn = np.exp(-1j * c.omega_n * settings.T_s)
    Phi, Gamma = turn * E[:3, :3], turn * E[:3, 3]
    sensors = np.array([[circuit.R_c, 1.0, -circuit.R_c], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    memory = 4 if c.delay_samples else 3
    at = z[:, None, None]
    x = np.linalg.solve(at * np.eye(3) - Phi, Gamma.astype(complex)[:, None])
    G = (sensors @ x)[..., 0] * (turn / at[..., 0] if c.delay_samples else 1.0)
    # Controller: memory m' = F m + B y with u' = turn·v_b; v_b = H m + D y.
    F = np.vstack([law[1:, 3 : 3 + memory], turn * law[:1, 3 : 3 + memory]])[:memory]
    B = np.vstack([law[1:, :3], turn * law[:1, :3]])[:memory]
    K = law[0, :3] + law[0, 3 : 3 + memory] @ np.linalg.solve(at * np.eye(memory) - F, B)
    return 1.0 / (1.0 - (G * K).sum(axis=1)), G * K


@pytest.mark.parametrize("case", CASES)
def test_margins_are_those_of_the_loop_solved_state_by_state(case: str) -> None:
    c, f = datasheet(case)
    gains, omega_t = closed_form_starts(c, f, 10.0)[0]
    if case == "sized_5mva_3300v":  # the closed form leaves this one unstable
        gains = gains._replace(K_pc=0.2 * gains.K_pc, K_ic=0.2 * gains.K_ic)
    settings = controller_settings(c, f)
    law = law_matrix(one(gains), np.array([omega_t]), settings)
    circuit = plants(circuits(c, f, GRIDS, "impedance"), settings, c.delay_samples, c.omega_n)
    omega = frequencies(c.T_s, 240)
    scales = np.array([1.0, 1.0 / c.Z_base, 1.0 / c.Z_base])
    found = margins(law, circuit, modes(law, circuit), omega, scales)[0]
    fine = np.linspace(-np.pi, np.pi, 6000) / c.T_s
    dense = np.unique(np.concatenate([fine, np.linspace(-2e3, 2e3, 6000)]))
    for point, (disk, sensors, _) in zip(GRIDS, found, strict=True):
        S, parts = loop_by_states(c, f, law[0], point, np.exp(1j * dense * c.T_s))
        # Both look at points: neither finds the very peak, and a maximum between two lies above both.
        assert disk == pytest.approx(1.0 / np.abs(S - 0.5).max(), rel=5e-3)
        assert sensors == pytest.approx(1.0 / (np.abs(parts).sum(axis=1) * np.abs(S)).max(), rel=5e-3)


def test_noise_is_the_rms_of_the_output_for_white_noise() -> None:
    """Parseval: the mean of the spectrum is the sum of the squared pulse responses, here of the whole closed loop."""
    c, f = datasheet("lab_12kva_lcl")
    gains, omega_t = closed_form_starts(c, f, 10.0)[0]
    settings = controller_settings(c, f)
    law = law_matrix(one(gains), np.array([omega_t]), settings)
    circuit = plants(circuits(c, f, [(4.0, 2.0)], "impedance"), settings, c.delay_samples, c.omega_n)
    scales = np.array([1.0, 1.0 / c.Z_base, 1.0 / c.Z_base])
    found = margins(law, circuit, modes(law, circuit), frequencies(c.T_s, 240), scales)[0, 0, 2]
    A = matrices(law, circuit)[0, 0]
    answers = law[0]
    # Noise w enters where y does: x' = A x + B w, v_b = C x + D w.
    turn = circuit.turn
    B = np.vstack([np.zeros((3, 3)), answers[1:, :3], turn * answers[:1, :3]]) * scales
    C = np.concatenate([answers[0, :3] @ circuit.sensors[0], answers[0, 3:]])
    power, x = np.abs(answers[0, :3] * scales) ** 2, B
    total = power.sum()
    for _ in range(20_000):
        total += float((np.abs(C @ x) ** 2).sum())
        x = A @ x
    assert found == pytest.approx(np.sqrt(total), rel=0.01)  # the integral is over points that are 0.4 % of it apart


def test_lattice_has_its_limits_and_runs_x_over_r_fastest() -> None:
    points = lattice(GridBox(), 7, 5)
    assert len(points) == 35
    assert points[0] == (1.3, 0.3)
    assert points[1][0] == 1.3
    assert points[-1] == (20.0, 20.0)
    assert lattice(GridBox(scr=(2.0, 2.0), x_over_r=(1.0, 1.0)), 7, 5) == ((2.0, 1.0),)


@pytest.mark.parametrize("case", CASES[:3])
def test_no_smaller_error_of_all_sensors_is_unstable_and_that_one_is(case: str) -> None:
    """Errors of the margin's size and the worst angles put a mode on the unit circle; random angles leave it inside."""
    c, f = datasheet(case)
    gains, omega_t = closed_form_starts(c, f, 10.0)[0]
    settings = controller_settings(c, f)
    law = law_matrix(one(gains), np.array([omega_t]), settings)
    point = (20.0, 20.0)
    circuit = plants(circuits(c, f, [point], "impedance"), settings, c.delay_samples, c.omega_n)
    omega = frequencies(c.T_s, 240)
    margin = margins(law, circuit, modes(law, circuit), omega, np.ones(3))[0, 0, 1]

    def fastest(errors: np.ndarray) -> float:
        wrong = law.copy()
        wrong[:, :, :3] *= 1.0 + errors
        return float(np.abs(np.linalg.eigvals(matrices(wrong, circuit))).max())

    # The critical frequency, looked for again on the loop by states, between points of the coarse grid.
    at, worst = omega, np.ones(3, dtype=complex)
    for _ in range(3):
        S, parts = loop_by_states(c, f, law[0], point, np.exp(1j * at * c.T_s))
        k = int(np.argmax(np.abs(S) * np.abs(parts).sum(axis=1)))
        worst = np.exp(1j * (np.angle(1.0 / S[k]) - np.angle(parts[k])))
        at = np.linspace(at[max(k - 1, 0)], at[min(k + 1, len(at) - 1)], 200)
    assert fastest(0.99 * margin * worst) < 1.0 < fastest(1.02 * margin * worst)
    rng = np.random.default_rng(3)
    for _ in range(200):
        assert fastest(0.99 * margin * np.exp(2j * np.pi * rng.random(3))) < 1.0
