"""The one-period map: against the EMT kernel through transients, against a second writing, against scipy's expm."""

from __future__ import annotations

import cmath
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from tests.model.one_period import OnePeriod
from tests.oracles.emt_circuit import circuit_matrices
from tests.oracles.emt_controller import SampledController, State
from tests.stability.studies import (
    CASES,
    LABORATORY,
    PUBLISHED,
    UTILITY,
    Situation,
    case_study,
    designed,
    random_situations,
    rated,
    situation,
)
from vsgdesign.equations.controller_data import flat_settings
from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS, PARAMETERS, full_order_map
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order, parameter_values
from vsgdesign.simulation import GainChange, Simulation, simulate
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import GridSource, Place

Array = NDArray[np.float64]


def turning_states(study: Study, run: Simulation, gains, refs: tuple[float, float], names: tuple[str, ...]) -> Array:
    """Every logged state of a run in the source's frame, as rows of z (from the second sample on).

    The voltage that waits out the delay is not logged: it is what the independent controller asks for one sample
    before.
    """
    source = run.column("v_g_alpha") + 1j * run.column("v_g_beta")
    turn = np.conj(source / np.abs(source))
    complex_ = {n: (run.column(f"{n}_alpha") + 1j * run.column(f"{n}_beta")) for n in ("i_s", "v_c", "i_g")}
    theta, omega, V, P_f, Q_f, xi_vd, xi_vq, xi_id, xi_iq, i_f_d, i_f_q, *_ = run.controller_log.T
    controller, waiting = SampledController(study), np.zeros(len(theta), np.complex128)
    for k in range(len(theta) - 1):
        state = State(
            theta[k],
            omega[k],
            V[k],
            complex(P_f[k], Q_f[k]),
            complex(xi_vd[k], xi_vq[k]),
            complex(xi_id[k], xi_iq[k]),
            complex(i_f_d[k], i_f_q[k]),
        )
        i_s, v_c, i_g = (complex(complex_[n][k]) for n in ("i_s", "v_c", "i_g"))
        v = v_c + study.filter.R_c * (i_s - i_g)
        _, waiting[k + 1], _ = controller.step(state, v, i_s, i_g, refs, gains)
    values = {
        "delta": np.angle(np.exp(1j * theta) * turn),
        "omega_i": omega,
        "V": V,
        "P_f": P_f,
        "Q_f": Q_f,
        "xi_vd": xi_vd,
        "xi_vq": xi_vq,
        "xi_id": xi_id,
        "xi_iq": xi_iq,
        "i_f_d": i_f_d,
        "i_f_q": i_f_q,
        "pending_d": (waiting * turn).real,
        "pending_q": (waiting * turn).imag,
    }
    for n, x in complex_.items():
        values |= {f"{n}_d": (x * turn).real, f"{n}_q": (x * turn).imag}
    return np.stack([values[n] for n in names], axis=1)[1:]


@pytest.mark.parametrize(("delay", "R_t_pu"), [(0, 0.0), (1, 0.0), (0, 0.1), (1, 0.2)])
@pytest.mark.parametrize("case", CASES)
def test_a_period_of_the_emt_is_a_step_of_the_map(case: str, delay: int, R_t_pu: float) -> None:
    """A cold start, off nominal frequency, with filters: 600 states far from rest, limits included.

    Each is taken from the run, stepped once by the map and compared with the run's next. Measured: 3e-14 of rated.
    """
    study = case_study(case, tau_P=0.004, tau_Q=0.002, delay=delay)
    c = study.converter
    study = replace(study, inner_gains=study.inner_gains._replace(R_t=R_t_pu * c.Z_base))
    grid = Place(4.0, 2.0, study.scr_basis).grid(c)
    source = GridSource(0.97 * c.V_rated_rms, 1.004 * c.omega_n)
    gains = designed(study, grid, 0.3)
    cell = Cell(grid, gains, 0.5 * c.S_rated, 0.1 * c.S_rated, source)
    spec = replace(study.simulation, duration=600 * c.T_s, start="cold", P_ref=cell.P_ref, Q_ref=cell.Q_ref)
    run = simulate(
        replace(study, grid=grid, grid_source=source, simulation=spec), [GainChange(0.0, gains)], log_states=600
    )
    functions = full_order_map(delay, True, True, R_t_pu > 0.0, 8)
    z = turning_states(study, run, gains, (cell.P_ref, cell.Q_ref), functions.states)
    p = np.array([*parameter_values(study, cell), *flat_settings(study.controller_settings())])
    following = np.array(functions.step.map(len(z) - 1)(z[:-1].T, np.tile(p[:, None], len(z) - 1))[0]).T
    difference = following - z[1:]
    k = functions.states.index("delta")
    difference[:, k] = np.angle(np.exp(1j * difference[:, k]))
    scale = rated(study, functions.states)
    travelled = np.abs(np.diff(z, axis=0) / scale).max()
    # A state that has grown beyond rated (a start against a dead capacitor) is measured by its own size.
    error = np.abs(difference / np.maximum(scale, np.abs(z[1:]))).max()
    print(f"{case}, delay {delay}: {error:.1e}; largest move in a period {travelled:.2f} of rated")
    assert travelled > 0.05  # it is a transient
    assert error < 1e-12


@pytest.fixture(scope="module")
def situations() -> list[Situation]:
    """Eight random ones, and the first four again with a transient resistance."""
    plain = random_situations(8, seed=5)
    damped = [
        replace(
            s.study,
            omega_t=40.0 * (k + 1),
            inner_gains=s.study.inner_gains._replace(R_t=0.1 * s.study.converter.Z_base),
        )
        for k, s in enumerate(plain[:4])
    ]
    return [*plain, *(situation(study, s.cell) for study, s in zip(damped, plain, strict=False))]


def oracle(s: Situation) -> OnePeriod:
    source = s.cell.source or s.study.grid_source
    refs = {"P_ref": s.cell.P_ref, "Q_ref": s.cell.Q_ref, "V_g": source.V_g_rms, "omega_g": source.omega_g}
    return OnePeriod(s.study, s.cell.grid, s.cell.gains._asdict(), refs)


def test_against_a_second_writing(situations: list[Situation]) -> None:
    """Random states around the steady one, both maps, limits included: 1e-12 of rated. The steady one stays."""
    rng, limited = np.random.default_rng(6), 0
    for s in situations:
        names, scale, second = s.model.states, rated(s.study, s.model.states), oracle(s)
        for spread in (0.0, *([0.3] * 5)):
            z = s.model.z[0] + spread * scale * rng.standard_normal(len(scale))
            expected, _ = second(dict(zip(names, z, strict=True)), {})
            got = np.array(s.model.map.step(z, s.model.p[0])[0]).ravel()
            error = np.abs((got - [expected[n] for n in names]) / scale).max()
            assert error < 1e-12, (spread, error)
            if spread == 0.0:
                assert np.abs((got - z) / scale).max() < 1e-12
        limited += second.limited
    assert limited > 5


def test_matrices_are_the_derivatives_of_the_second_writing(situations: list[Situation]) -> None:
    """A, B, C, D entry by entry against central differences of the oracle, in per unit: 1e-9 of the largest of a row.

    Differences with steps of 1e-5 of rated leave 1e-10 of curvature and 1e-11 of rounding. Measured: 3e-11.
    """
    worst = 0.0
    for s in situations:
        names, scale, second = s.model.states, rated(s.study, s.model.states), oracle(s)
        c = s.study.converter
        V_pk = np.sqrt(2.0) * c.V_rated_rms
        S, V = c.S_rated, c.V_rated_rms
        of_input = dict(zip(INPUTS, (S, S, c.omega_n, V, S, S, 1.0, V), strict=True))
        of_output = np.array([S, S, c.omega_n, V, 1.0, V_pk, V_pk])
        rest = dict(zip(names, s.model.z[0], strict=True))
        A, B, C, D = (m[0] for m in (s.model.A, s.model.B, s.model.C, s.model.D))
        h = 1e-5

        def both(z: dict[str, float], push: dict[str, float], second: OnePeriod = second, names=names) -> Array:
            after, y = second(z, push)
            return np.array([*(after[n] for n in names), *(y[n] for n in OUTPUTS)])

        out = np.concatenate([scale, of_output])
        columns, library = [], []
        for k, name in enumerate(names):
            up, down = ({**rest, name: rest[name] + sign * h * scale[k]} for sign in (1.0, -1.0))
            columns.append((both(up, {}) - both(down, {})) / (2.0 * h * out))
            library.append(np.concatenate([A[:, k], C[:, k]]) * scale[k] / out)
        for k, name in enumerate(INPUTS):
            up, down = ({name: sign * h * of_input[name]} for sign in (1.0, -1.0))
            columns.append((both(rest, up) - both(rest, down)) / (2.0 * h * out))
            library.append(np.concatenate([B[:, k], D[:, k]]) * of_input[name] / out)
        expected, got = np.stack(columns, axis=1), np.stack(library, axis=1)
        error = np.abs(got - expected) / np.maximum(1.0, np.abs(expected).max(axis=1, keepdims=True))
        worst = max(worst, float(error.max()))
    print(f"worst entry {worst:.1e}")
    assert worst < 1e-9


@pytest.mark.parametrize(
    ("case", "scr", "ratio"), [(PUBLISHED, 2.0, 1.0), (LABORATORY, 20.0, 0.3), (UTILITY, 1.5, 20.0)]
)
def test_the_exponential_inside(case: str, scr: float, ratio: float) -> None:
    """With a delay the plant's part of A and of the pending voltage is Φ and Γ, turned back: scipy's, to 1e-13."""
    study = case_study(case, delay=1)
    grid = Place(scr, ratio, study.scr_basis).grid(study.converter)
    source = GridSource(study.converter.V_rated_rms, 1.003 * study.converter.omega_n)
    gains = designed(study, grid)._replace(D_p=0.0)  # or its droop asks for more than the grid carries
    model = linearise_full_order(study, [Cell(grid, gains, 0.0, 0.0, source)])
    A, b, _ = circuit_matrices(study, grid)
    T, omega = study.converter.T_s, source.omega_g
    M = np.zeros((4, 4), complex)
    M[:3, :3], M[:3, 3] = A, b
    expected = expm(M * T)[:3] * cmath.exp(-1j * omega * T)
    order = [model.states.index(f"{n}_{a}") for n in ("i_s", "v_c", "i_g", "pending") for a in "dq"]
    block = model.A[0][np.ix_(order[:6], order)]
    complex_ = block[0::2, 0::2] + 1j * block[1::2, 0::2]
    np.testing.assert_allclose(block[1::2, 1::2] + 1j * -block[0::2, 1::2], complex_, rtol=0, atol=1e-15)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    print(f"{case}: {np.abs((complex_ - expected) / scale).max():.1e}")
    assert np.abs((complex_ - expected) / scale).max() < 1e-13


def test_names() -> None:
    """What structure has which states, and that names are not repeated."""
    for delay, filter_P, filter_Q, transient in (
        (0, False, False, False),
        (0, True, False, True),
        (1, False, True, False),
        (1, True, True, True),
    ):
        names = full_order_map(delay, filter_P, filter_Q, transient, 6).states
        assert len(set(names)) == len(names) == 13 + 2 * delay + filter_P + filter_Q + 2 * transient
        assert ("i_f_d" in names) == ("i_f_q" in names) == transient
        assert ("pending_d" in names, "P_f" in names, "Q_f" in names) == (bool(delay), filter_P, filter_Q)
    assert len(set(PARAMETERS)) == len(PARAMETERS)


def test_a_cell_without_a_steady_state_is_recorded() -> None:
    """Between two good cells: the reason is kept and the arrays hold the two."""
    study = case_study(PUBLISHED)
    grid = Place(2.0, 1.0, study.scr_basis).grid(study.converter)
    gains = designed(study, grid)
    cells = [Cell(grid, gains, P, 0.0) for P in (1000.0, 80000.0, 2000.0)]
    model = linearise_full_order(study, cells)
    assert model.faults[0] is None
    assert model.faults[2] is None
    assert "no operating point" in (model.faults[1] or "")
    assert model.index.tolist() == [0, 2]
    assert model.A.shape == (2, 13, 13)
    alone = linearise_full_order(study, [cells[2]])
    np.testing.assert_array_equal(model.A[1], alone.A[0])
    nothing = linearise_full_order(study, [cells[1]])
    assert nothing.A.shape == (0, 13, 13)
    assert nothing.B.shape == (0, 13, len(INPUTS))
