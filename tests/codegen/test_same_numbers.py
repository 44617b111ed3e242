"""Every function of ``equations`` and ``frames`` as C: Python's bits in double, 1e-6 of scale in single precision."""

from __future__ import annotations

import ctypes
import ctypes.util
import types
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from tests.codegen.compiled import Compiled
from tests.compilers import GCC_AND_CLANG, require_compiler
from tests.equations.test_three_ways import FLAGS, FUNCTIONS, arguments, draw, flat
from vsgdesign.codegen import CText, UntranslatableError, c_functions
from vsgdesign.equations.limiters import CIRCULAR, LimiterLaw

REFUSED = {"integration.advanced": "every target has its own"}
TRANSLATED = [name for name in FUNCTIONS if name not in REFUSED]
ROWS = 2000


def test_what_is_refused_has_a_reason() -> None:
    for name, reason in REFUSED.items():
        with pytest.raises(UntranslatableError, match=reason):
            c_functions([FUNCTIONS[name]])


@pytest.fixture(scope="module")
def text() -> CText:
    return c_functions([FUNCTIONS[name] for name in TRANSLATED], fixed={"limiter": CIRCULAR.law})


@pytest.fixture(scope="module", params=GCC_AND_CLANG)
def compiler(request: pytest.FixtureRequest) -> str:
    if request.param == "gcc":
        require_compiler()
    return request.param


@pytest.fixture(scope="module")
def double(text: CText, compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Compiled:
    return Compiled(text, tmp_path_factory.mktemp("double"), compiler, double=True)


@pytest.fixture(scope="module")
def single(text: CText, compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Compiled:
    return Compiled(text, tmp_path_factory.mktemp("single"), compiler, double=False, optimised=False)


_SAMPLES: dict[str, tuple[np.ndarray, np.ndarray]] = {}


class Limits:
    """Takes the place of a generator of numbers, to be told between which limits they would be."""

    found: tuple[float, float] = (0.0, 0.0)

    def uniform(self, low: float, high: float) -> float:
        self.found = low, high
        return low

    def integers(self, low: int, high: int) -> int:
        self.found = float(low), float(high)
        return low


def samples(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Inputs as single precision holds them, and Python's answers."""
    if name not in _SAMPLES:
        rng, columns = np.random.default_rng(sum(name.encode())), []

        def column(field: str) -> float:
            limits = Limits()
            draw(field, limits)  # type: ignore[arg-type]
            values = rng.integers(0, 2, ROWS) if field in FLAGS else rng.uniform(*limits.found, ROWS)
            columns.append(values.astype(np.float32).astype(float))
            return 0.0

        shape = arguments(FUNCTIONS[name], column)
        function, inputs = with_libm(FUNCTIONS[name]), np.column_stack(columns)
        with np.errstate(invalid="ignore"):  # a power flow may have no root: NaN in both
            answers = [flat(function(*filled(shape, iter(row)))) for row in inputs.tolist()]
        _SAMPLES[name] = inputs, np.array(answers, dtype=float).reshape(ROWS, -1)
    return _SAMPLES[name]


def filled(shape: Any, numbers: Iterator[float]) -> Any:
    """The same arguments with other numbers."""
    if isinstance(shape, LimiterLaw):
        return shape
    if isinstance(shape, list | tuple):
        made = [filled(item, numbers) for item in shape]
        return made if isinstance(shape, list) else type(shape)(*made)
    return next(numbers)


@pytest.mark.parametrize("name", TRANSLATED)
def test_double_precision_has_the_bits_of_python(name: str, double: Compiled) -> None:
    inputs, expected = samples(name)
    np.testing.assert_array_equal(double(name.split(".")[1], inputs), expected)


CANCELLING = {
    "controller.controller_sample": "ω − ω_0 times the droop",
    "controller.controller_step": "ω − ω_0 times the droop",
    "controller.power_stage": "ω − ω_0 times the droop",
    "power_loops.power_loops": "ω − ω_0 times the droop",
}
"""Differences of large terms: their scale is what the last digit of every input is worth there."""

IN_DOUBLE_ALONE = {"power_loops.power_loops_about_rest", "power_flow.yielding_columns"}
"""Run in the certificate alone: no exported C has them. The first divides by 1 − k_P D_p, which random gains bring near
zero; the second multiplies powers by admittances that the random draws have in units of no converter."""

POLES = {
    "power_flow.largest_scale": "infinite where there is no limit",
    "structures.effective_inertia": "infinite where the coupling takes all inertia away",
}
"""Compared by their reciprocals, which are finite."""


@pytest.mark.parametrize("name", [name for name in TRANSLATED if name not in IN_DOUBLE_ALONE])
def test_single_precision_is_near(name: str, double: Compiled, single: Compiled) -> None:
    """1e-6 of the largest value of a result over all samples, or some times what rounding the inputs changes."""
    inputs, expected = samples(name)
    short = name.split(".")[1]
    allowed = np.broadcast_to(1e-6 * np.nanmax(np.abs(expected), axis=0), expected.shape)
    if name in CANCELLING:
        allowed = 1e-6 * np.median(np.abs(expected), axis=0) + 8.0 * rounding(inputs, lambda rows: double(short, rows))
    found = single(short, inputs)
    if name in POLES:
        found, expected = 1.0 / found, 1.0 / expected
        allowed = 1e-6 * np.max(np.abs(expected))
    error = np.abs(found - expected)
    assert np.all((error <= allowed) | np.isnan(expected))


def rounding(inputs: np.ndarray, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """What half a unit in the last place of each input in single precision changes, all changes together."""
    here, total = function(inputs), 0.0
    for column in range(inputs.shape[1]):
        moved = inputs.copy()
        moved[:, column] *= 1.0 + 2.0**-24
        total = total + np.abs(function(moved) - here)
    return np.asarray(total)


_LIBM = ctypes.CDLL(ctypes.util.find_library("m"))
_FROM_LIBM = {"cos": 1, "sin": 1, "exp": 1, "hypot": 2, "arctan2": 2}


def _libm(name: str, count: int) -> Callable[..., float]:
    function = _LIBM[name.replace("arctan2", "atan2")]
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double] * count
    return function


def with_libm(function: Any, done: dict[Any, Any] | None = None) -> Any:
    """The same function with C's cos, sin, exp, hypot and atan2 in place of NumPy's, whose last bit may differ."""
    done = {} if done is None else done
    if function not in done:
        functions = {name: _libm(name, count) for name, count in _FROM_LIBM.items()}
        scope = dict(function.__globals__)
        scope["np"] = types.SimpleNamespace(**{**vars(np), **functions})
        done[function] = copy = types.FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
        for name, value in function.__globals__.items():
            if isinstance(value, types.FunctionType) and value.__module__.startswith("vsgdesign"):
                scope[name] = with_libm(value, done)
        return copy
    return done[function]


@pytest.mark.parametrize("name", _FROM_LIBM)
def test_numpys_functions_are_c_s_to_the_last_bit_but_one(name: str) -> None:
    rng = np.random.default_rng(3)
    values = rng.uniform(-6.0, 6.0, (20_000, _FROM_LIBM[name]))
    ours = getattr(np, name)(*values.T)
    theirs = np.array([_libm(name, _FROM_LIBM[name])(*row) for row in values])
    assert np.all(np.abs(ours - theirs) <= np.spacing(np.abs(theirs)))
