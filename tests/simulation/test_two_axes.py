"""A circuit whose axes differ, by full matrices: against the usual case, an ODE solver and a matrix exponential."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from tests.oracles.emt_reference import at_rest, run_reference
from tests.simulation.studies import GAINS, lc_study, lcl_study
from tests.simulation.test_emt_against_dop853 import (
    EVERYTHING,
    RAMPS,
    SAG,
    TOLERANCE,
    errors_pu,
    library_start,
    random_numbers,
)
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.plant import TwoAxisCircuit, plant_step, two_axes
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.study.parameters import Grid, Study

CHANGES = [GainChange(0.0, GAINS)]
OMEGA = 2.0 * np.pi * 50.0

DISTORTED = """
[[events]]
time = "0.7 ms"
components = [{ order = -1, amplitude_pu = 0.05, phase = 1 }, { order = -5, amplitude_pu = 0.04 }]
"""

EVENTS = '[[events]]\ntime = "2.0123 ms"\ngrid = { scr = 4 }\n' + RAMPS


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_equal_axes_give_the_usual_run(build: Callable[..., Study], bridge: str) -> None:
    """With ramps, a negative sequence, harmonics, and a grid that changes between two samples."""
    study = build("40 ms", EVENTS + DISTORTED)
    usual = simulate(study, CHANGES, bridge=bridge, log_states=10**6)
    full = simulate(study, CHANGES, bridge=bridge, log_states=10**6, circuit=lambda g: two_axes(study.circuit(g)))
    scale = np.abs(usual.log).max(axis=0) + 1e-300
    assert np.max(np.abs(full.log - usual.log)[:, :-2] / scale[:-2]) < 1e-12
    turned = np.exp(1j * full.column("theta")) - np.exp(1j * usual.column("theta"))
    assert np.max(np.abs(turned)) < 1e-12
    # Given as it is, it goes the usual way, to the bit.
    same = simulate(study, CHANGES, bridge=bridge, circuit=study.circuit)
    assert same.log.tobytes() == usual.log.tobytes()


def other_axis(study: Study) -> Callable[[Grid], Grid]:
    """Another impedance on the β axis, on all grids but the first."""
    return lambda grid: grid if grid == study.grid else Grid(0.4 * grid.R_g, 1.7 * grid.L_g)


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_unequal_axes_against_an_ode_solver(build: Callable[..., Study], bridge: str) -> None:
    """The source is distorted, the grid becomes unequal between two samples, and then the source sags."""
    study = build("25 ms", '[[events]]\ntime = "1.0123 ms"\ngrid = { scr = 4 }\n' + SAG + DISTORTED)
    beta = other_axis(study)
    run = simulate(
        study,
        CHANGES,
        bridge=bridge,
        log_states=10**6,
        circuit=lambda grid: two_axes(study.circuit(grid), study.circuit(beta(grid))),
    )
    start = library_start(study, CHANGES)
    errors = errors_pu(study, run, run_reference(study, CHANGES, bridge == "pwm", start, beta))
    assert max(errors.values()) < TOLERANCE, errors
    # …and the axes do differ: a run with equal ones is far away.
    equal = errors_pu(study, run, run_reference(study, CHANGES, bridge == "pwm", start))
    assert equal["i_g"] > 0.05


@pytest.mark.parametrize("recorded", [False, True])
def test_unequal_axes_in_a_restless_grid(tmp_path: Path, recorded: bool) -> None:
    """With a background, and with a recorded voltage."""
    np.savez(tmp_path / "g.npz", v=np.cos(2.0 * np.pi * 50.1 * np.arange(2000) / 5000.0), fs=5000.0)
    record = f'[replay]\nfile = "{tmp_path / "g.npz"}"\nscale = "rated"\n'
    study = lcl_study(
        "12 ms", '[[events]]\ntime = "1.0123 ms"\ngrid = { scr = 4 }\n' + (record if recorded else EVERYTHING)
    )
    beta = other_axis(study)
    own = lambda grid: two_axes(study.circuit(grid), study.circuit(beta(grid)))  # noqa: E731
    run = simulate(study, CHANGES, bridge="pwm", log_states=10**6, circuit=own)
    reference = run_reference(study, CHANGES, True, library_start(study, CHANGES), beta, **random_numbers(study))
    errors = errors_pu(study, run, reference)
    assert max(errors.values()) < TOLERANCE, errors


def test_a_cold_start_may_be_unequal_from_the_first() -> None:
    study = lcl_study("10 ms", simulation='start = "cold"')
    beta = Grid(0.4 * study.grid.R_g, 1.7 * study.grid.L_g)
    circuit = two_axes(study.circuit(), study.circuit(beta))
    run = simulate(study, CHANGES, log_states=10**6, circuit=lambda _: circuit)
    errors = errors_pu(study, run, run_reference(study, CHANGES, False, at_rest(study), lambda _: beta))
    assert max(errors.values()) < TOLERANCE, errors


def coupled(pairs: int) -> TwoAxisCircuit:
    """Random passive states, with α and β coupled to each other."""
    rng = np.random.default_rng(pairs)
    n = 2 * pairs
    skew = rng.normal(size=(n, n))
    return TwoAxisCircuit(
        3e3 * (skew - skew.T) - 200.0 * np.eye(n), 1e3 * rng.normal(size=(n, 2)), 1e3 * rng.normal(size=(n, 2))
    )


@pytest.mark.parametrize("pairs", [3, 4, 6])
def test_a_step_of_any_circuit_is_one_matrix_exponential(pairs: int) -> None:
    """SciPy's, of the circuit with its inputs as states: the bridge held, the source a turning pair, times 1, s, s²."""
    circuit, h = coupled(pairs), 80e-6
    n, step = 2 * pairs, plant_step(circuit, h, OMEGA)
    turn = np.array([[0.0, -OMEGA], [OMEGA, 0.0]])
    # z_m = s^m e^{jωs}: z_0' = Ω z_0, z_1' = Ω z_1 + z_0, z_2' = Ω z_2 + 2 z_1.
    M = np.zeros((n + 8, n + 8))
    M[:n, :n], M[:n, n : n + 2] = circuit.A, circuit.B
    for m in range(3):
        at = n + 2 + 2 * m
        M[at : at + 2, at : at + 2] = turn
        if m:
            M[at : at + 2, at - 2 : at] = m * np.eye(2)
    for m in range(3):
        M[:n, n + 2 :] = 0.0
        M[:n, n + 2 + 2 * m : n + 4 + 2 * m] = circuit.E
        # s^m starts from z_0 alone, scaled to seconds.
        exact = expm(M * h)
        np.testing.assert_allclose(step.transition, exact[:n, :n], atol=1e-13)
        np.testing.assert_allclose(step.bridge, exact[:n, n : n + 2], rtol=1e-11, atol=1e-14)
        scale = np.abs(exact[:n, n + 2 : n + 4]).max()
        np.testing.assert_allclose(step.source[m], exact[:n, n + 2 : n + 4], atol=1e-9 * scale if m else 1e-12 * scale)
    # The edge polynomial at both ends of the interval: nothing, and all of it.
    powers = (-1.0) ** np.arange(len(step.edge))
    np.testing.assert_allclose(np.einsum("k,kij->ij", powers, step.edge), 0.0, atol=1e-13)
    np.testing.assert_allclose(step.edge.sum(axis=0), step.bridge, rtol=1e-11, atol=1e-14)


def test_more_states_run_too() -> None:
    """A fourth pair that nothing feeds stays at rest and changes nothing; one that decays does so exactly."""
    study = lc_study("10 ms", '[[events]]\ntime = "2.0123 ms"\ngrid = { scr = 4 }\n', simulation='start = "cold"')

    def widened(grid: Grid) -> TwoAxisCircuit:
        own = two_axes(study.circuit(grid))
        A = np.zeros((8, 8))
        A[:6, :6], A[6:, 6:] = own.A, -50.0 * np.eye(2)
        A[6:, 2:4] = 10.0 * np.eye(2)  # it follows the capacitor voltage
        rest = np.zeros((2, 2))
        return TwoAxisCircuit(A, np.vstack([own.B, rest]), np.vstack([own.E, rest]))

    wide = simulate(study, CHANGES, circuit=widened)
    usual = simulate(study, CHANGES)
    scale = np.abs(usual.log).max(axis=0) + 1e-300
    assert np.max(np.abs(wide.log - usual.log)[:, :12] / scale[:12]) < 1e-12
    assert wide.final_plant.shape == (8,)
    assert np.hypot(*wide.final_plant[6:]) > 1.0


def test_what_cannot_start_or_does_not_fit_is_refused() -> None:
    study = lc_study("5 ms", '[[events]]\ntime = "2 ms"\ngrid = { scr = 4 }\n')
    other = FilterGrid(**{**study.circuit()._asdict(), "L_g": 2e-3})
    with pytest.raises(InfeasibleStudyError, match="only the study's own circuit with equal axes has a steady state"):
        simulate(study, CHANGES, circuit=lambda grid: two_axes(study.circuit(grid), other))

    def unlike(grid: Grid) -> TwoAxisCircuit:
        return two_axes(study.circuit(grid)) if grid == study.grid else coupled(4)

    with pytest.raises(InfeasibleStudyError, match="has 6 and 8 states on different grids"):
        simulate(study, CHANGES, circuit=unlike)
