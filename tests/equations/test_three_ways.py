"""Every equation as a float, through CasADi and as machine code: the same number three times.

The functions are found, not listed: a new one is tested as soon as it exists, and fails here until its
arguments have ranges.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import typing
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import casadi
import numpy as np
import pytest

from tests.codegen.machine import Machine
from vsgdesign import equations
from vsgdesign.equations.controller import ControllerState, Measurement, controller_step
from vsgdesign.equations.controller_data import Nothing, flat_settings, flat_state
from vsgdesign.equations.grid import sag_sequences
from vsgdesign.equations.integration import advanced, low_pass_share
from vsgdesign.equations.limiter_interface import always, no_memory
from vsgdesign.equations.limiters import CIRCULAR, LIMITERS, LimiterLaw, limiter_named
from vsgdesign.equations.limiters.balanced_power import negative_sequence_of_loop
from vsgdesign.equations.power_flow import converter_side

RANGES: dict[str, tuple[float, float]] = {
    "response_time": (1e-3, 1e-2), "settling_time": (0.1, 3.0), "damping_ratio": (0.3, 2.0), "droop_ratio": (0.0, 0.1),
    "A": (1e3, 1e5), "D": (10.0, 1e3), "C": (1e-6, 1e-4), "scr": (1.0, 20.0), "x_over_r": (0.1, 10.0),
    "Z_base": (1.0, 10.0), "offset": (-5.0, 5.0), "omega": (300.0, 320.0), "delta": (-1.0, 1.0), "theta": (-6.0, 6.0),
    "cosine": (-1.0, 1.0), "sine": (-1.0, 1.0), "limit": (1.0, 20.0), "T_s": (2e-5, 1e-4),
    "smoothing_P": (0.01, 1.0), "smoothing_Q": (0.01, 1.0), "smoothing_t": (1e-3, 0.1), "smoothing": (1e-3, 1.0),
    "e_d": (-20.0, 20.0), "e_q": (-20.0, 20.0), "cut_d": (-5.0, 5.0), "cut_q": (-5.0, 5.0),
    "limited": (0.0, 1.0), "doubt": (0.0, 0.9),
    "drop_d": (-20.0, 20.0), "drop_q": (-20.0, 20.0), "omega_C": (1e-3, 0.1), "omega_L": (0.1, 1.0),
    "i_max_pk": (5.0, 50.0), "v_max_pk": (100.0, 400.0), "advance_cos": (0.99, 1.0), "advance_sin": (0.0, 0.1),
    "omega_0": (310.0, 318.0), "omega_i": (310.0, 318.0), "V_n": (100.0, 120.0), "V": (90.0, 130.0),
    "K_pv": (0.01, 0.1), "K_iv": (5.0, 30.0), "K_pc": (5.0, 20.0), "K_ic": (1e3, 4e4), "K_ff": (0.0, 1.0),
    "R_t": (0.0, 1.0), "X_t": (-1.0, 1.0), "kappa": (0.0, 1.6), "half_cos": (0.99, 1.0), "half_sin": (0.0, 0.1),
    "pace": (0.3, 3.0), "T_over_L": (5e-3, 0.1), "Z": (0.1, 10.0), "Z_sq": (0.1, 10.0), "g": (1e2, 1e4),
    "u_d": (-200.0, 200.0), "u_q": (-200.0, 200.0), "u_alpha": (-200.0, 200.0), "u_beta": (-200.0, 200.0),
    "K_pq": (-1e-2, 1e-2), "K_qp": (-0.5, 0.5), "k_P": (0.0, 1e-3), "k_Q": (-1e-3, 1e-3), "B": (50.0, 500.0),
    "k_1": (5.0, 30.0), "d_1": (3.0, 9.0), "k_2": (2.0, 8.0), "share_P": (0.0, 1.0), "share_Q": (0.0, 1.0),
    "k_1_or_H": (2.0, 30.0), "d_1_or_zeta": (0.5, 9.0), "q": (0.0, 0.05), "H": (1.0, 10.0), "zeta": (0.4, 1.2),
    "K_ip": (1e-3, 1e-2), "D_p": (500.0, 3000.0), "K_iq": (0.05, 0.5), "D_q": (0.1, 3.0),
    "Z_v": (0.5, 3.0), "S_rated": (1e3, 1e6), "dc_voltage": (300.0, 900.0), "zero_sequence": (0.0, 1.0),
    "value": (-4e3, 4e3), "mean": (-4e3, 4e3), "ripple": (-4e3, 4e3), "damping": (0.1, 1.0), "gain": (0.01, 0.1),
    "step": (1e-4, 1e-2), "back": (0.01, 0.1), "notch_gain": (0.01, 0.1), "notch_step": (1e-4, 1e-2),
    "notch_back": (0.01, 0.1), "error_R": (0.0, 0.5), "error_X": (0.0, 0.5), "error_Z": (0.0, 0.3),
    "h_R": (0.01, 0.5), "h_X": (0.01, 0.5), "var_R": (0.0, 0.1), "var_X": (0.0, 0.1), "share": (0.0, 1.0),
    "goal_scr": (1.0, 20.0), "left_scr": (1.0, 20.0), "r_over_x": (0.05, 3.0), "goal_r_over_x": (0.05, 3.0),
    "beyond": (0.0, 1.5), "soft": (0.0, 1.0), "across": (-6e4, 6e4), "along": (-6e4, 6e4), "turn_d": (0.0, 1.0),
    "turn_q": (0.0, 1.0), "full": (0.0, 1.0), "acts": (0.0, 1.0), "u_max": (100.0, 200.0),
    "phase": (0.0, 3.0), "turn": (0.01, 0.1), "X_1": (0.05, 0.5),
    "left_r_over_x": (0.05, 3.0), "X_g": (0.1, 2.0), "G_load": (0.0, 0.5), "B_load": (-0.3, 0.3),
    "slip": (-5.0, 5.0), "K_pll": (10.0, 500.0), "K_slip": (1e3, 1e5), "by_power": (0.0, 1.0), "lead": (2e-5, 1e-4),
    "frequency": (-0.1, 0.1), "turned": (-6.0, 6.0), "slow": (-0.1, 0.1), "magnitude": (-0.1, 0.1),
    "angle": (-1.0, 1.0), "phase_noise": (-0.1, 0.1), "voltage_noise": (-0.1, 0.1), "noise": (0.0, 1.0),
    "smoothing_v": (0.01, 1.0), "smoothing_V": (0.01, 1.0), "units": (1.0, 8.0),
    "untouched": (0.0, 4e3), "least": (1e-3, 0.1), "to_inductor": (-4e3, 4e3),
    "r": (1e-6, 1e-4), "d": (-4e3, 4e3), "omega_t": (5.0, 200.0), "tau_P": (0.0, 0.02), "tau_Q": (0.0, 0.02),
}  # fmt: skip
BY_PREFIX: tuple[tuple[str, tuple[float, float]], ...] = (
    ("V_", (90.0, 130.0)),
    ("ripple_", (-4e3, 4e3)),
    ("mean_", (-4e3, 4e3)),
    ("v_", (-200.0, 200.0)),
    ("nu_", (-200.0, 200.0)),
    ("i_", (-30.0, 30.0)),
    ("I_", (5.0, 50.0)),
    ("xi_", (-20.0, 20.0)),
    ("L_", (1e-4, 1e-2)),
    ("R_", (0.01, 3.0)),
    ("P", (-4e3, 4e3)),
    ("Q", (-2e3, 2e3)),
)
ONE_LETTER = {"a": (-200.0, 200.0), "R": (0.1, 2.0), "X": (0.1, 2.0)}
FLAGS = ("zero_sequence", "by_inertia")
"""Arguments that choose between formulas and are never symbols."""


NO_EQUATIONS = (limiter_named, always, no_memory, flat_state, flat_settings, sag_sequences, converter_side)
"""Look a name up, have no numbers, put numbers side by side, or take pairs of numbers."""

CONSTANTS_OF_A_STUDY = (*(limiter.build for limiter in LIMITERS.values()), negative_sequence_of_loop, low_pass_share)
"""Python's alone: the exported C has their numbers."""

OF_ONE_LIMITER = tuple(
    function
    for limiter in LIMITERS.values()
    if limiter is not CIRCULAR
    for function in (*limiter.law, limiter.at_rest)
    if function not in CIRCULAR.law
)
"""Need the constants and the memory of their own limiter. tests/export/test_limited_steps.py compares their C with
Python, tests/simulation/test_limiters.py the compiled loop."""


BRANCHING = tuple(
    f"vsgdesign.equations.{name}"
    for name in ("field", "scheduler_data", "estimate_guards", "scheduling", "placing", "sampled_path", "dc_")
)
"""Never traced (test_field_recursions.py, test_scheduling.py, test_placing.py, test_sampled_path.py and test_dc_link.py
beside this)."""


def all_functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    modules = [
        importlib.import_module(m.name) for m in pkgutil.walk_packages(equations.__path__, f"{equations.__name__}.")
    ]
    for module in modules:
        if module.__name__.startswith(BRANCHING):
            continue
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ == module.__name__ and function not in (
                *NO_EQUATIONS,
                *CONSTANTS_OF_A_STUDY,
                *OF_ONE_LIMITER,
            ):
                yield f"{module.__name__.rpartition('.')[2]}.{name}", function


FUNCTIONS = dict(all_functions())


def draw(name: str, rng: np.random.Generator) -> float:
    if name in FLAGS:
        return bool(rng.integers(0, 2))
    found = RANGES.get(name) or ONE_LETTER.get(name)
    if found is None:
        found = next((limits for prefix, limits in BY_PREFIX if name.startswith(prefix)), None)
    if found is None:
        found = {
            "b": ONE_LETTER["a"],
            "c": ONE_LETTER["a"],
            "x": ONE_LETTER["a"],
            "y": ONE_LETTER["a"],
            "dx": ONE_LETTER["a"],
            "alpha": ONE_LETTER["a"],
            "beta": ONE_LETTER["a"],
            "x_pk": ONE_LETTER["a"],
            "x_rms": ONE_LETTER["a"],
        }[name]
    return float(rng.uniform(*found))


def arguments(function: Callable[..., Any], make: Callable[[str], Any]) -> list[Any]:
    """One argument per parameter; structures are filled field by field."""
    return [filled(kind, name, make) for name, kind in parameters(function)]


@cache
def parameters(function: Callable[..., Any]) -> list[tuple[str, Any]]:
    """The name and the type of each parameter. Tests draw hundreds of times for one function."""
    hints = typing.get_type_hints(function)
    return [(name, hints[name]) for name in inspect.signature(function).parameters]


def filled(kind: Any, name: str, make: Callable[[str], Any]) -> Any:
    """A number; of a structure every field; the limiter itself for its law."""
    if kind is LimiterLaw:
        return CIRCULAR.law
    if not hasattr(kind, "_fields"):
        return make(name)
    return kind(**{field: make(field) for field in fields_of(kind)})


@cache
def fields_of(kind: Any) -> list[str]:
    """The fields of a structure. Memory, constants and notes of the circular limiter are empty."""
    return [field for field in kind._fields if kind._field_defaults.get(field) != Nothing()]


def numbers(arguments: list[Any]) -> list[float]:
    """The same for machine code."""
    return [float(leaf) for value in arguments if not isinstance(value, LimiterLaw) for leaf in flat(value)]


def flat(value: Any) -> list[Any]:
    return [leaf for item in value for leaf in flat(item)] if isinstance(value, tuple) else [value]


@pytest.fixture(scope="module", autouse=True)
def _numpy_functions_on_symbols() -> None:
    casadi.GlobalOptions.setNumpyMode(1)


def test_they_are_all_here() -> None:
    assert len(FUNCTIONS) >= 35
    assert {"controller.controller_step", "power_flow.power_flow", "frames.clarke"} <= FUNCTIONS.keys()


@pytest.mark.parametrize("name", FUNCTIONS)
def test_float_casadi_and_machine_code_agree(name: str) -> None:
    function = FUNCTIONS[name]
    law = {"limiter": CIRCULAR.law} if "limiter" in inspect.signature(function).parameters else {}
    compiled = None if function is advanced else Machine(function, law)  # every target has its own sum
    rng = np.random.default_rng(sum(name.encode()))
    for _ in range(10):
        flags = {flag: draw(flag, rng) for flag in FLAGS}
        values: list[float] = []
        symbols: list[casadi.SX] = []

        def number(field: str, flags: dict = flags, values: list = values) -> Any:
            if field in FLAGS:
                return flags[field]
            values.append(draw(field, rng))
            return values[-1]

        def symbol(field: str, flags: dict = flags, symbols: list = symbols) -> Any:
            if field in FLAGS:
                return flags[field]
            symbols.append(casadi.SX.sym(field))
            return symbols[-1]

        plain = arguments(function, number)
        expected = np.array([float(leaf) for leaf in flat(function(*plain))])
        traced = casadi.Function("f", symbols, flat(function(*arguments(function, symbol))))
        through_casadi = np.array([float(leaf) for leaf in _sequence(traced(*values))])
        as_machine_code = expected if compiled is None else np.array(compiled(numbers(plain)))
        # Of the larger of the entry and a rounding of what it was summed from: an entry near zero is a difference.
        scale = np.maximum(np.abs(expected), 1e-3 * np.max(np.abs(expected)))
        assert np.all(np.isfinite(expected))
        np.testing.assert_array_less(np.abs(through_casadi - expected), 1e-12 * scale + 1e-300)
        np.testing.assert_array_less(np.abs(as_machine_code - expected), 1e-12 * scale + 1e-300)


def _sequence(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


def test_derivatives_are_finite_where_the_measurement_is_zero() -> None:
    """A cold converter is linearised too: the limiters must not divide by the length of nothing."""
    rng = np.random.default_rng(6)
    plain = arguments(controller_step, lambda field: draw(field, rng))
    state = casadi.SX.sym("state", len(ControllerState._fields) - 1)
    measured = casadi.SX.sym("measured", len(Measurement._fields))
    following, output = controller_step(
        ControllerState(*casadi.vertsplit(state)), Measurement(*casadi.vertsplit(measured)), *plain[2:]
    )
    x = casadi.vertcat(state, measured)
    jacobian = casadi.Function("J", [x], [casadi.jacobian(casadi.vertcat(*flat((following, output))), x)])
    assert np.all(np.isfinite(np.array(jacobian(np.zeros(x.shape[0])))))
