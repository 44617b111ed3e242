"""Traced programs and what encloses them: against samples, and against eigenvalues."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.examples import examples
from vsgdesign.certificate import taylor_kernel
from vsgdesign.certificate.box_check import COORDINATES, FOLLOWED, KERNEL, survey
from vsgdesign.certificate.proof import arrays
from vsgdesign.certificate.taylor_kernel import LANES, limits, negative, rows, run_program, sum_up
from vsgdesign.certificate.tracing import Symbol, Tracer, program_of

Array = NDArray[np.float64]


def enclosed(formula: Callable[..., Any], centre: Array, radius: Array, parameters: Any = ((),)) -> Array:
    """Registers (rows, LANES) of a formula of d variables over a box, all lanes the same."""
    d = len(centre)
    tracer = Tracer(d)
    program = program_of(tracer, [formula(*tracer.symbols())])
    registers = np.zeros((program.registers, rows(d), LANES))
    for k in range(d):
        registers[k, 0], registers[k, 1 + k] = centre[k], radius[k]
        sum_up(registers[k], d)
    own = np.repeat(np.array(parameters, dtype=float).reshape(-1, 1), LANES, axis=1)
    run_program(program.code, program.number, program.places, program.factors, registers, own, d)
    return registers[program.outputs[0]]


def value_at(form: Array, t: Array) -> tuple[Array, float]:
    """The polynomial of a form at places t (M, d), and the bound on what is left."""
    d = t.shape[1]
    i, j = np.triu_indices(d)
    last = 1 + d + len(i)
    value = form[0, 0] + t @ form[1 : 1 + d, 0] + (t[:, i] * t[:, j]) @ form[1 + d : last, 0]
    return value, float(form[last : last + d, 0].sum())


def formula(x: Any, y: Any, z: Any) -> Any:
    return (x * y - z) / (x * x + z + 1.0) + np.sqrt(x + y) * np.sin(z) - np.cos(x * z) + (y - 2.0) * x


@examples(25)
@given(
    st.lists(st.floats(0.3, 3.0), min_size=3, max_size=3),
    st.lists(st.floats(0.01, 0.25) | st.just(0.0), min_size=3, max_size=3),
    st.integers(0, 2**31),
)
def test_forms_hold_every_value(middle: list[float], width: list[float], seed: int) -> None:
    c, r = np.array(middle), np.array(width) * np.array(middle)
    t = np.random.default_rng(seed).uniform(-1.0, 1.0, (100, 3))
    t[:8] = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    form = enclosed(formula, c, r)
    polynomial, rest = value_at(form, t)
    exact = formula(*(c + r * t).T)
    # Rounding is enclosed; 1e-14 is for this test's own.
    assert np.all(np.abs(exact - polynomial) <= rest + 1e-14 * np.abs(exact).max())
    low, high = np.empty(LANES), np.empty(LANES)
    limits(form, 3, low, high)
    assert np.all((exact >= low[0] - 1e-14) & (exact <= high[0] + 1e-14))


def test_what_is_left_shrinks_with_the_cube_of_the_box() -> None:
    def rest(width: float) -> float:
        form = enclosed(lambda x, y: np.sin(x * y) / y, np.array([1.0, 2.0]), np.array([width, width]))
        return value_at(form, np.zeros((1, 2)))[1]

    assert rest(0.05) / rest(0.1) == pytest.approx(1.0 / 8.0, rel=0.2)


@pytest.mark.parametrize("function", [lambda x: 1.0 / x, np.sqrt])
def test_a_function_outside_its_domain_has_no_bound(function: Callable[[Any], Any]) -> None:
    form = enclosed(function, np.array([0.05]), np.array([0.15]))
    assert not np.isfinite(value_at(form, np.zeros((1, 1)))[1])


def test_a_root_with_a_least_value_encloses_what_is_above_it() -> None:
    form = enclosed(lambda x: x.sqrt(0.5), np.array([0.6]), np.array([0.4]))
    t = np.linspace(-0.25, 1.0, 50)[:, None]
    polynomial, rest = value_at(form, t)
    assert np.all(np.abs(np.sqrt(0.6 + 0.4 * t[:, 0]) - polynomial) <= rest)
    assert rest < 0.1


def test_what_cancels_leaves_no_trace() -> None:
    form = enclosed(lambda x, y: (x * y + y) - x * y - y + 3.0, np.array([1.0, 2.0]), np.array([0.5, 0.5]))
    assert form[0, 0] == 3.0
    # The constant is one instruction: its rounding is all that is left.
    assert np.abs(form[1:, 0]).max() < 1e-13


def test_equal_expressions_are_computed_once() -> None:
    tracer = Tracer(2)
    x, y = tracer.symbols()
    one = program_of(tracer, [np.sin(x * y) * np.sin(y * x)])
    assert len(one.code) == 3  # x·y, its sine, the square
    assert isinstance(2.0 * x - x, Symbol)
    assert tracer.place(2.0 * x - x) == tracer.place(x)


def test_registers_are_reused_without_harm() -> None:
    """A long chain: few registers, and the value of plain floats."""

    def chain(x: Any, y: Any) -> Any:
        total = x
        for k in range(40):
            total = (total * y + x / (1.0 + 0.1 * k)) * (1.0 / (total * total + 1.0))
        return total

    tracer = Tracer(2)
    assert program_of(tracer, [chain(*tracer.symbols())]).registers < 12
    form = enclosed(chain, np.array([0.7, 0.4]), np.zeros(2))
    assert form[0, 0] == pytest.approx(chain(0.7, 0.4), rel=1e-13)


def test_a_blend_takes_each_boxs_parameters() -> None:
    tracer = Tracer(1)
    (x,) = tracer.symbols()
    program = program_of(tracer, [tracer.blend((1, 0), (x, tracer.constant(1.0)))])
    registers = np.zeros((program.registers, rows(1), LANES))
    registers[0, 0] = 2.0
    sum_up(registers[0], 1)
    own = np.stack([np.arange(LANES), 10.0 * np.arange(LANES)])
    run_program(program.code, program.number, program.places, program.factors, registers, own, 1)
    np.testing.assert_allclose(registers[program.outputs[0], 0], 21.0 * np.arange(LANES))


@pytest.mark.parametrize("n", [3, 5])
@examples(30)
@given(st.integers(0, 2**31), st.floats(0.0, 3.0))
def test_negative_only_where_every_matrix_is(n: int, seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    d, last = 3, 1 + 3 + 6
    pairs = [(i, i) for i in range(n)] + [(i, j) for i in range(n) for j in range(i + 1, n)]
    entries = np.zeros((len(pairs), rows(d), LANES))
    base = rng.normal(size=(n, n))
    base = -(base @ base.T) - 0.2 * np.eye(n)
    entries[:, 0] = np.array([base[pair] for pair in pairs])[:, None]
    entries[:, 1:last] = 0.03 * size * rng.normal(size=(len(pairs), last - 1, 1))
    entries[:, last : last + d] = 0.02 * size * rng.uniform(size=(len(pairs), d, 1))
    proved, score = np.ones(LANES, dtype=np.bool_), np.zeros((d, LANES))
    negative(entries, d, proved, score, np.zeros((len(pairs), LANES)))
    t = rng.uniform(-1.0, 1.0, (400, d))
    t[:200] = np.sign(t[:200])
    i, j = np.triu_indices(d)
    terms = np.concatenate([np.ones((400, 1)), t, t[:, i] * t[:, j]], axis=1)
    values = terms @ entries[:, :last, 0].T
    signs = np.sign(rng.normal(size=(400, n)))  # of Rohn's patterns: what is not known at its worst
    for k, (row, column) in enumerate(pairs):
        values[:, k] += signs[:, row] * signs[:, column] * entries[k, last : last + d, 0].sum()
    matrices = np.zeros((400, n, n))
    for k, (row, column) in enumerate(pairs):
        matrices[:, row, column] = matrices[:, column, row] = values[:, k]
    largest = float(np.linalg.eigvalsh(matrices).max())
    assert not (proved[0] and largest >= 0.0)
    assert bool(proved[0]) or size > 0.0
    assert np.all(score >= 0.0)


def test_a_fast_state_does_not_spoil_the_bound_of_a_slow_one() -> None:
    """What is not known of a coupling of 1 to 100: the sums of rows, 0.5 each, would leave nothing of 0.4."""
    d, last = 1, 3
    pairs = [(i, i) for i in range(5)] + [(i, j) for i in range(5) for j in range(i + 1, 5)]
    entries = np.zeros((len(pairs), rows(d), LANES))
    entries[:5, 0] = np.array([-0.4, -100.0, -100.0, -100.0, -100.0])[:, None]
    for radius, held in ((0.5, True), (6.4, False)):  # singular at √(0.4·100) = 6.32
        entries[pairs.index((0, 1)), last] = radius
        proved = np.ones(LANES, dtype=np.bool_)
        negative(entries, d, proved, np.zeros((d, LANES)), np.zeros((len(pairs), LANES)))
        assert bool(proved[0]) == held


def test_two_limits_that_leave_no_point_in_common_empty_a_box() -> None:
    """x + y ≤ −a and x − y ≤ −a for 0 ≤ x ≤ 1, |y| ≤ 1: each leaves points, and both x ≤ −a."""
    tracer = Tracer(COORDINATES)
    x, y, *_ = tracer.symbols()
    situation = arrays(program_of(tracer, [x, x + y, x - y]))
    low, high = np.zeros((2, COORDINATES)), np.ones((2, COORDINATES))
    low[:, 1] = -1.0
    high[1] = low[1] = 0.25
    for most, empty in ((-0.1, [True, True]), (0.1, [False, True]), (0.6, [False, False])):
        found, none = np.zeros(2, dtype=np.bool_), np.zeros((0, 2), dtype=np.bool_)
        conditions, forms = np.array([[-np.inf, most]] * 2), np.zeros((2, 1, rows(FOLLOWED + 1)))
        survey(low, high, np.zeros((0, 2)), situation, conditions, np.zeros((0, 0), np.int64), found, none, forms)
        assert found.tolist() == empty


def test_machine_code_is_made_again_when_the_kernel_changes() -> None:
    """Numba looks at the file of a function alone, not at those of what it calls: write the fingerprint again."""
    assert hashlib.sha256(Path(taylor_kernel.__file__).read_bytes()).hexdigest()[:16] == KERNEL
