"""A list of operations for lanes side by side, against Python's own numbers."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from vsgdesign.codegen.operation_list import LANES, OPERATIONS, OperationList

NUMBERS = (0.0, -0.0, 1.0, -1.0, 0.5, -0.75, 2.5, -3.0, 1e-3, 700.0, 1e-300, math.inf, -math.inf, math.nan)


def _or_nan(of: Callable[..., float]) -> Callable[..., float]:
    """C's functions return NaN or infinity where Python raises an error."""

    def found(*numbers: float) -> float:
        try:
            return float(of(*numbers))
        except (ValueError, OverflowError, ZeroDivisionError):
            return math.nan

    return found


TWO: dict[str, Callable[[float, float], float]] = {
    "mul": operator.mul,
    "add": operator.add,
    "sub": operator.sub,
    "div": operator.truediv,
    "fmin": lambda x, y: y if math.isnan(x) else x if math.isnan(y) else min(x, y),
    "fmax": lambda x, y: y if math.isnan(x) else x if math.isnan(y) else max(x, y),
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": lambda x, y: float(x != 0.0 and y != 0.0),
    "or": lambda x, y: float(x != 0.0 or y != 0.0),
    "if_else_zero": lambda x, y: y if x != 0.0 else 0.0,
    "atan2": math.atan2,
    "pow": math.pow,
    "fmod": math.fmod,
    "hypot": math.hypot,
    "copysign": math.copysign,
}
ONE: dict[str, Callable[[float], float]] = {
    "neg": operator.neg,
    "sqrt": math.sqrt,
    "fabs": abs,
    "floor": lambda x: float(np.floor(x)),
    "ceil": lambda x: float(np.ceil(x)),
    "not": lambda x: float(x == 0.0),
    "sign": lambda x: -1.0 if x < 0.0 else 1.0 if x > 0.0 else x,
    "asin": math.asin,
    **{
        name: getattr(math, name)
        for name in [
            "sin",
            "cos",
            "tan",
            "acos",
            "atan",
            "sinh",
            "cosh",
            "tanh",
            "asinh",
            "acosh",
            "atanh",
            "exp",
            "expm1",
            "log",
            "log1p",
            "erf",
        ]
    },
}


def test_every_operation_is_compared() -> None:
    assert set(OPERATIONS) == {*ONE, *TWO}


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_has_the_bits_of_python(name: str) -> None:
    """Where Python raises an error, C has infinity or no number."""
    of: Callable[..., float] = _or_nan(ONE[name] if name in ONE else TWO[name])
    pairs = [(x, y) for x in NUMBERS for y in NUMBERS] if name in TWO else [(x, x) for x in NUMBERS]
    listed = OperationList(2, (), [name], [(0, 1)], [2])
    for begin in range(0, len(pairs), LANES):
        part = pairs[begin : begin + LANES]
        inputs = np.full((2, LANES), 0.5)
        inputs[:, : len(part)] = np.transpose(part)
        found = listed.run(inputs)[0, : len(part)]
        for (x, y), value in zip(part, found.tolist(), strict=True):
            expected = of(x, y) if name in TWO else of(x)
            if math.isnan(expected):
                assert math.isnan(value) or math.isinf(value), (name, x, y, value)
            else:
                assert value == expected, (name, x, y, value, expected)


def test_many_operations_have_the_bits_of_numpy_in_every_lane() -> None:
    """Of a random list: its order, the places that are used again, an operation that nobody asks for, an input and a
    constant as outputs."""
    rng = np.random.default_rng(5)
    inputs, constants, count = 7, (1.5, -0.25, 0.0), 4000
    names, operands = [], []
    for number in range(inputs + len(constants), inputs + len(constants) + count):
        names.append(("mul", "add", "sub", "fmax", "neg", "sin")[rng.integers(0, 6)])
        low = max(0, number - 60) if rng.random() < 0.7 else 0
        operands.append((int(rng.integers(low, number)), int(rng.integers(low, number))))
    last = inputs + len(constants) + count - 1
    outputs = [3, inputs + 1, *range(last - 300, last + 1, 7), last]
    listed = OperationList(inputs, constants, names, operands, outputs)
    for _ in range(2):  # nothing of a run is left for the next one
        given = rng.normal(size=(inputs, LANES))
        found = listed.run(given)
        for lane in range(LANES):
            values = [*given[:, lane].tolist(), *constants]
            for name, (x, y) in zip(names, operands, strict=True):
                of = ONE.get(name)
                values.append(of(values[x]) if of else TWO[name](values[x], values[y]))
            np.testing.assert_array_equal(found[:, lane], [values[number] for number in outputs])


def test_what_cannot_be_done_is_refused() -> None:
    with pytest.raises(ValueError, match="no operation bessel; it has mul,"):
        OperationList(1, (), ["bessel"], [(0, 0)], [1])
    for operands in ([(0, 1)], [(-1, 0)], [(0, 0), (0, 0)]):
        with pytest.raises(ValueError, match="not there before it"):
            OperationList(1, (), ["add"], operands, [0])


def test_a_list_without_operations_gives_what_it_was_given() -> None:
    listed = OperationList(2, (4.0,), (), (), [1, 2])
    found = listed.run(np.repeat([[1.0], [2.0]], LANES, axis=1))
    np.testing.assert_array_equal(found, [[2.0] * LANES, [4.0] * LANES])


def test_threads_do_not_disturb_each_other() -> None:
    """A list is kept for the process, and a call from Python lets other threads run."""
    count = 20_000
    listed = OperationList(1, (1.0,), ["add"] * count, [(max(1, k), 0) for k in range(1, count + 1)], [count + 1])
    expected = {x: listed.run(np.full((1, LANES), x))[0, 0] for x in range(8)}
    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(lambda k: (k % 8, listed.run(np.full((1, LANES), k % 8.0))[0].tolist()), range(400)))
    assert all(values == [expected[x]] * LANES for x, values in found)


@pytest.mark.parametrize("count", [0, 1, LANES, 2 * LANES + 3])
def test_points_are_done_lanes_at_a_time(count: int) -> None:
    listed = OperationList(2, (4.0,), ("mul", "add"), [(0, 1), (3, 2)], [4, 0])
    points = np.random.default_rng(1).normal(size=(count, 2))
    expected = np.column_stack([points[:, 0] * points[:, 1] + 4.0, points[:, 0]])
    np.testing.assert_array_equal(listed.of_points(points), expected)
