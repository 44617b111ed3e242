"""The plain sine and the like against NumPy's, in Python and as machine code."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from tests.codegen.twins import twin
from vsgdesign.codegen.language import FUNCTIONS
from vsgdesign.codegen.llvm import LoopSpec, compiled_loop, empty_rows, flat_block
from vsgdesign.codegen.llvm_loop import loop_text
from vsgdesign.codegen.vector_math import PLAIN
from vsgdesign.equations.inner_loops import limit_length

RNG = np.random.default_rng(5)
COUNT = 480
TURNS = RNG.uniform(-40.0, 40.0, COUNT)
SIZES = np.exp(RNG.uniform(-700.0, 700.0, COUNT)) * RNG.choice([-1.0, 1.0], COUNT)
NEAR_QUARTERS = np.round(TURNS) * (0.5 * np.pi) + RNG.normal(0.0, 1e-9, COUNT)
SMALL = RNG.normal(0.0, 3.0, (2, COUNT))


def sines(x: Any) -> Any:
    return np.sin(x)


def cosines(x: Any) -> Any:
    return np.cos(x)


def tangents(x: Any) -> Any:
    return np.tan(x)


def angles(x: Any, y: Any) -> Any:
    return np.arctan2(x, y)


def lengths(x: Any, y: Any) -> Any:
    return np.hypot(x, y)


def powers(x: Any) -> Any:
    return np.exp(x)


def logarithms(x: Any) -> Any:
    return np.log(x)


def hyperbolic(x: Any) -> Any:
    return np.tanh(x)


Inputs = list[tuple[np.ndarray, ...]]
WIDE = (1e5 * RNG.uniform(-1.0, 1.0, COUNT),)
AXES = tuple(np.array([[0.0, 1.0, 0.0, -1.0, 0.0], [1.0, 0.0, -1.0, 0.0, 0.0]]))
CASES: dict[str, tuple[Any, Inputs, float]] = {
    "sin": (sines, [(TURNS,), (NEAR_QUARTERS,), WIDE, (np.array([0.0, 1e-300]),)], 3e-16),
    "cos": (cosines, [(TURNS,), (NEAR_QUARTERS,), WIDE, (np.array([0.0, 1e-9]),)], 3e-16),
    "tan": (tangents, [(TURNS,), (NEAR_QUARTERS,)], 7e-16),
    "atan2": (angles, [tuple(SMALL), (np.abs(SIZES) ** 0.3, SIZES), AXES], 5e-16),
    "hypot": (lengths, [tuple(SMALL), tuple(1e100 * SMALL)], 5e-16),
    "exp": (powers, [(17.5 * TURNS,), (0.01 * TURNS,), (np.array([0.0, -700.0, 700.0]),)], 4e-16),
    "log": (logarithms, [(np.abs(SIZES),), (1.0 + 0.01 * TURNS,), (1.0 + 1e-9 * TURNS,), (AXES[0] + 2.0,)], 4e-16),
    "tanh": (hyperbolic, [(0.1 * TURNS,), (TURNS,), (1e-9 * TURNS,)], 4e-16),
}
"""By operation: a function, what it is given, and the largest error relative to the value."""


def test_every_function_of_the_language_has_a_plain_one() -> None:
    assert set(PLAIN) == set(FUNCTIONS.values()) - {"sqrt", "abs", "floor", "max", "min"} == set(CASES)


@pytest.mark.parametrize("name", PLAIN)
def test_right_to_the_last_digits(name: str) -> None:
    function, inputs, allowed = CASES[name]
    plain = twin(function)
    for given in inputs:
        expected = function(*given)
        found = np.array([plain(*row) for row in np.transpose(given).tolist()])
        error = np.abs(found - expected)
        assert np.all(error <= allowed * np.abs(expected)), given[0][np.argmax(error - allowed * np.abs(expected))]
        np.testing.assert_array_equal(compiled_values(function, given, strict=True), found)
        loose = compiled_values(function, given, strict=False)
        assert np.all(np.abs(loose - expected) <= 1e-15 * np.abs(expected))


@pytest.mark.parametrize("name", PLAIN)
def test_nan_stays(name: str) -> None:
    function, inputs, _ = CASES[name]
    nothing = tuple(np.full(8, np.nan) for _ in inputs[0])
    assert np.isnan(compiled_values(function, nothing, strict=False)).all()
    assert math.isnan(twin(function)(*(math.nan for _ in nothing)))


def test_a_root_that_divides_is_right_to_the_last_digits() -> None:
    """A loop of eight lanes has its own 1/√x where x is the larger of two and one of them a square."""
    block = flat_block(limit_length)
    spec = LoopSpec((block,), (("x", "short_x"), ("y", "short_y")), uniform=("limit",), lanes=8)
    assert "lshr" in loop_text(spec)
    assert "lshr" not in loop_text(dataclasses.replace(spec, strict=True))
    rows = empty_rows(spec, COUNT // 8)
    for limit in (1e-140, 1e-3, 1.0, 7.3, 1e140):
        x, y = limit * np.exp(RNG.uniform(-5.0, 5.0, (2, COUNT // 8, 8))) * RNG.choice([-1.0, 1.0], (2, COUNT // 8, 8))
        rows[:] = np.stack([x, y], axis=1)
        compiled_loop(spec)(0, 1, rows, np.array([limit]))
        for found, expected in zip(np.swapaxes(rows, 0, 1), limit_length(x, y, limit), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-15, atol=0.0)
    rows[:] = np.nan
    compiled_loop(spec)(0, 1, rows, np.array([1.0]))
    assert np.isnan(rows).all()


def compiled_values(function: Any, given: tuple[np.ndarray, ...], strict: bool) -> np.ndarray:
    """The function in a loop of eight lanes."""
    block = flat_block(function)
    spec = LoopSpec((block,), ((block.inputs[0], function.__name__),), block.inputs[1:], lanes=8, strict=strict)
    rows = empty_rows(spec, -(-len(given[0]) // 8))
    flat = np.zeros((len(given), rows.shape[0] * 8))
    flat[:, : len(given[0])] = given
    rows[:] = np.swapaxes(flat.reshape(len(given), -1, 8), 0, 1)
    compiled_loop(spec)(0, 1, rows, np.zeros(0))
    return rows[:, 0].reshape(-1)[: len(given[0])].copy()
