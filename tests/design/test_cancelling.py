"""What is traced for the certificate: the same numbers as floats, and no trace of what the gains undo."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vsgdesign.certificate.cancelling import Algebra, Value
from vsgdesign.certificate.taylor_kernel import LANES, rows, run_program, sum_up
from vsgdesign.certificate.tracing import Tracer, program_of
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains

NAMES = ("A", "B", "C", "D", "k_1", "d_1", "k_2", "share", "D_p", "D_q")
AT = (8348.0, 91.9, -4840.0, 68.7, 15.8, 6.6, 4.0, 0.7, 318.0, 90.9)


def loops(structure: str, by_inertia: bool, share: Any, v: dict[str, Any]) -> list[Any]:
    """The nine entries of (δ, ω_i, V)'s matrix where the Jacobian is what the gains are made of."""
    first = (2.0, 0.7) if by_inertia else (v["k_1"], v["d_1"])
    kind = STRUCTURES[structure]
    D_p, D_q = v["D_p"] if kind.P_droop else 0.0 * v["D_p"], v["D_q"] if kind.Q_droop else 0.0 * v["D_q"]
    normalised = NormalisedGains(*first, v["k_2"], 0.0 if kind.Q_droop else 0.01, share, share)
    gains = kind.gains(v["A"], v["B"], v["C"], v["D"], normalised, D_p, D_q, 5e3, 314.0, by_inertia)
    gains = PowerLoopGains(*gains)
    none = References(0.0, 0.0, 0.0, 0.0)
    columns = [
        power_loops(0.0, 0.0, v["A"], v["C"], none, gains),
        power_loops(1.0, 0.0, 0.0, 0.0, none, gains),
        power_loops(0.0, 1.0, v["B"], v["D"], none, gains),
    ]
    return [columns[j][i] for i in range(3) for j in range(3)]


def traced(make: Callable[[dict[str, Any]], list[Any]]) -> tuple[list[Value], list[float]]:
    """Values of a formula of NAMES, and what the program that comes of them says at AT."""
    tracer = Tracer(len(NAMES))
    algebra = Algebra(tracer)
    found = [algebra.value(x) for x in make(dict(zip(NAMES, map(algebra.value, tracer.symbols()), strict=True)))]
    program = program_of(tracer, [algebra.symbol(x) for x in found])
    registers = np.zeros((program.registers, rows(len(AT)), LANES))
    for k, value in enumerate(AT):
        registers[k, 0] = value
        sum_up(registers[k], len(AT))
    arrays = program.code, program.number, program.places, program.factors
    run_program(*arrays, registers, np.zeros((0, LANES)), len(AT))
    return found, registers[program.outputs, 0, 0].tolist()


@pytest.mark.parametrize("by_inertia", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0, "share"])
@pytest.mark.parametrize("structure", list(STRUCTURES))
def test_the_loops_are_those_of_floats(structure: str, share: Any, by_inertia: bool) -> None:
    def make(v: dict[str, Any]) -> list[Any]:
        return loops(structure, by_inertia, v["share"] if share == "share" else share, v)

    expected = make(dict(zip(NAMES, AT, strict=True)))
    _, found = traced(make)
    assert found == pytest.approx([float(x) for x in expected], rel=1e-10, abs=1e-12)


def test_what_the_gains_undo_leaves_no_trace() -> None:
    """With all coupling taken out δ and V do not see each other: poles alone are left, whatever the Jacobian."""
    values, _ = traced(lambda v: loops("decoupled", False, 1.0, v))
    k_1, d_1, k_2 = (NAMES.index(name) for name in ("k_1", "d_1", "k_2"))
    assert [value.terms for value in values[3:6]] == [{((k_1, 1),): -1.0}, {((d_1, 1),): -1.0}, {}]
    assert values[2].terms == {}
    assert values[8].terms == {((k_2, 1),): -1.0}
    values, _ = traced(lambda v: loops("angle_damped", False, 1.0, v))
    assert values[2].terms == values[5].terms == {}
    assert values[8].terms == {((k_2, 1),): -1.0}


FORMULAS: list[Callable[..., Any]] = [
    lambda x, y, z: (x + y) * z / (x * z + y * z),
    lambda x, y, z: (x * y + z) / (x * y - z) - (x * y) / (x * y - z),
    lambda x, y, z: 1.0 / (y - x * z) * (y - x * z) - 1.0,
    lambda x, y, z: (x - y - z) * (x - y) / (2.0 * x - 2.0 * y) - np.sqrt(x * y * y) / y,
    lambda x, y, z: (x / y) * (y / x) * z - z * (1.0 + x) + z * x,
    lambda x, y, z: 3.0 - (x + y) * (x + y) / z + 0.0 * x,
]


@pytest.mark.parametrize("formula", FORMULAS)
def test_formulas_keep_their_value(formula: Callable[..., Any]) -> None:
    _, found = traced(lambda v: [formula(v["k_1"], v["D_q"], v["k_2"])])
    assert found[0] == pytest.approx(formula(15.8, 90.9, 4.0), rel=1e-12, abs=1e-12)


def test_a_division_by_nothing_is_refused() -> None:
    with pytest.raises(ZeroDivisionError, match="zero everywhere"):
        traced(lambda v: [v["A"] / (v["B"] - v["B"])])


def test_a_choice_is_traced_on_the_piece_that_is_named_and_on_no_other() -> None:
    tracer = Tracer(2)
    x: Any
    y: Any
    x, y = tracer.symbols()
    with tracer.choosing((True, False)) as choices:
        larger, smaller = np.maximum(x, y), np.minimum(x, y)
    assert (larger, smaller) == (x, y)
    assert [choice.terms for choice in choices] == [{0: -1.0, 1: 1.0}] * 2  # y − x is negative
    with pytest.raises(ValueError, match="chooses between two values"):
        np.maximum(x, 1.0)
    with pytest.raises(ValueError, match="fewer choices"), tracer.choosing((True,)):
        pass
