"""The circuit at one frequency, number by number, against the same with matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from evidence._random_studies import bare
from tests.codegen.twins import twin
from tests.codegen.wasm_host import wasm_loop
from vsgdesign.codegen.llvm import LoopSpec, empty_rows, flat_block
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.sampled_path import SampledPath, Transition, droop_step, sampled_path, source_response
from vsgdesign.linear.operating_point.many import Lanes, lanes_of, paths_of, points_of
from vsgdesign.linear.operating_point.plant import plant_steps
from vsgdesign.study.parameters import Study

COUNT = 40
CASES = ["hoang2025_5kva", "lab_12kva_lcl", "utility_1mva_60hz"]


def drawn(case: str) -> tuple[Study, Lanes]:
    """A converter on drawn grids, at drawn frequencies and powers."""
    study, rng = bare(case), np.random.default_rng(29)
    c = study.converter
    Z, angle = c.Z_base / rng.uniform(1.5, 20.0, COUNT), rng.uniform(0.3, 1.5, COUNT)
    omega = c.omega_n * rng.uniform(0.9, 1.1, COUNT)
    V_g, P = c.V_rated_rms * rng.uniform(0.6, 1.1, COUNT), c.S_rated * rng.uniform(-1.0, 1.0, COUNT)
    Q = c.S_rated * rng.uniform(-0.4, 0.4, COUNT)
    return study, lanes_of(study, Lanes(Z * np.cos(angle), Z * np.sin(angle) / c.omega_n, V_g, omega, P, Q), NO_DROOP)[
        0
    ]


NO_DROOP = PowerLoopGains(*[0.0] * len(PowerLoopGains._fields))


def of_source(study: Study, lanes: Lanes) -> tuple[Transition, FilterGrid, Any]:
    """Φ and the circuits on the grids, and the steps that NumPy's matrices give."""
    steps = plant_steps(study, lanes.R_g, lanes.L_g, study.converter.T_s, lanes.omega_g)
    circuit = study.circuit()._replace(R_g=lanes.R_g, L_g=lanes.L_g)
    return Transition(*steps.transition.reshape(-1, 9).T), circuit, steps


def complex_of(x: Any) -> np.ndarray:
    return np.stack([one.re + 1j * one.im for one in x], axis=-1)


@pytest.mark.parametrize("case", CASES)
def test_what_the_source_adds(case: str) -> None:
    study, lanes = drawn(case)
    transition, circuit, steps = of_source(study, lanes)
    *found, turn = source_response(transition, circuit, study.converter.T_s, lanes.omega_g)
    # The last two are differences of larger numbers, in both.
    for m, (one, digits) in enumerate(zip(found, (1e-13, 1e-11, 1e-8), strict=True)):
        expected = steps.source[:, m]
        np.testing.assert_allclose(complex_of(one), expected, rtol=0.0, atol=digits * np.abs(expected).max())
    np.testing.assert_allclose(turn.re + 1j * turn.im, np.exp(1j * lanes.omega_g * study.converter.T_s), rtol=1e-15)


def path_of(study: Study, lanes: Lanes) -> SampledPath:
    transition, circuit, steps = of_source(study, lanes)
    of_constant, _, _, turn = source_response(transition, circuit, study.converter.T_s, lanes.omega_g)
    b_1, b_2, b_3 = steps.bridge.T
    return sampled_path(transition, b_1, b_2, b_3, of_constant, turn, study.filter.R_c, lanes.V_g_rms)


@pytest.mark.parametrize("case", CASES)
def test_the_path_that_the_samples_see(case: str) -> None:
    study, lanes = drawn(case)
    expected = paths_of(study, lanes, None)
    for name, values in path_of(study, lanes)._asdict().items():
        np.testing.assert_allclose(values, getattr(expected, name), rtol=1e-9, atol=1e-12, err_msg=name)


def both(
    transition: Transition, circuit: FilterGrid, h: Any, omega: Any, b_1: Any, b_2: Any, b_3: Any, V_g: Any
) -> Any:
    """Returns (of_constant, of_slope, of_square, turn, path)."""
    of_constant, of_slope, of_square, turn = source_response(transition, circuit, h, omega)
    path = sampled_path(transition, b_1, b_2, b_3, of_constant, turn, circuit.R_c, V_g)
    return of_constant, of_slope, of_square, turn, path


def test_another_host_has_the_bits_of_python() -> None:
    study, lanes = drawn(CASES[1])
    transition, circuit, steps = of_source(study, lanes)
    arguments = transition, circuit, study.converter.T_s, lanes.omega_g, *steps.bridge.T, lanes.V_g_rms
    block = flat_block(both)
    given = np.array([np.broadcast_to(one, (COUNT,)) for value in arguments for one in flat(value)])
    outputs = tuple(name for name, _ in block.outputs)
    spec = LoopSpec((block,), ((block.inputs[0], outputs[0]),), block.inputs[1:], logged=outputs, lanes=2, strict=True)
    rows, log = empty_rows(spec, COUNT // 2), np.zeros((COUNT // 2, 1, len(outputs), 2))
    rows[:] = np.swapaxes(given.reshape(len(given), -1, 2), 0, 1)
    wasm_loop(spec)(0, 1, rows, np.zeros(0), log=log, every=1)
    own = twin(both)
    for k, column in enumerate(given.T.tolist()):
        numbers = iter(column)
        filled = [
            type(one)(*[next(numbers) for _ in one]) if isinstance(one, tuple) else next(numbers) for one in arguments
        ]
        np.testing.assert_array_equal(log[k // 2, 0, :, k % 2], flat(own(*filled)))


def flat(value: Any) -> list[Any]:
    return [leaf for item in value for leaf in flat(item)] if isinstance(value, tuple) else [value]


@pytest.mark.parametrize("case", CASES)
def test_a_fixed_number_of_steps_finds_the_rest_or_says_that_there_is_none(case: str) -> None:
    """As a loop of another host, a sample for each step, from the nominal voltage and no angle: eight steps, then the
    error."""
    study, lanes = drawn(case)
    c, path = study.converter, path_of(study, lanes)
    D_q = np.where(np.arange(COUNT) % 2, c.S_rated / (0.5 * c.V_rated_rms), 0.0)
    lanes = lanes._replace(P_ref=np.where(np.arange(COUNT) % 5, 1.0, 6.0) * lanes.P_ref)  # more than some grids carry
    V, delta = points_of(paths_of(study, lanes, None), lanes, PowerLoopGains(*[np.zeros(COUNT)] * 8)._replace(D_q=D_q))
    block = flat_block(droop_step)
    constant = tuple(name for name in block.inputs if name not in ("V_rms", "delta"))
    state = ("V_rms", "next_V"), ("delta", "next_delta")
    spec = LoopSpec((block,), state, constant, logged=("error",), lanes=2, strict=True)
    rows, log = empty_rows(spec, COUNT // 2), np.zeros((COUNT // 2, 9, 1, 2))
    given = {"V_rms": c.V_rated_rms, "delta": 0.0, "P": lanes.P_ref, "Q_0": lanes.Q_ref + D_q * lanes.V_n, "D_q": D_q}
    given |= {"V_g_rms": path.V_rms, "R": path.R, "X": path.X}
    for at, name in enumerate(spec.rows):
        rows[:, at] = np.broadcast_to(given[name], (COUNT,)).reshape(-1, 2)
    wasm_loop(spec)(0, 9, rows, np.zeros(0), log=log, every=1)
    found = log[:, 8, 0].ravel() <= 1e-9
    assert 0 < np.isnan(V).sum() < COUNT // 2
    np.testing.assert_array_equal(found, np.isfinite(V))
    np.testing.assert_allclose(rows[:, 0].ravel()[found], V[found], rtol=1e-9)
    np.testing.assert_allclose(rows[:, 1].ravel()[found] + path.angle[found], delta[found], atol=1e-9)
