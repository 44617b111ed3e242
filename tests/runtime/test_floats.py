"""Equations on plain floats have the bits of the equations themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.equations.test_three_ways import FUNCTIONS, arguments, draw, flat
from vsgdesign.equations.grid import scr_impedance
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.runtime.schedule import on_floats

SHIPPED = [
    name for name in FUNCTIONS if name.split(".")[0] in ("following", "grid", "power_flow", "power_loops", "structures")
]


@pytest.mark.parametrize("name", SHIPPED)
def test_the_same_bits(name: str) -> None:
    rng, function = np.random.default_rng(sum(name.encode())), FUNCTIONS[name]
    drawn = [arguments(function, lambda field: draw(field, rng)) for _ in range(300)]
    with np.errstate(invalid="ignore"):
        expected = [flat(function(*given)) for given in drawn]
    np.testing.assert_array_equal([flat(on_floats(function)(*given)) for given in drawn], expected)


def test_they_are_floats_and_made_once() -> None:
    assert type(on_floats(scr_impedance)(1.0, 3e-3, 7.0, 314.0)) is float
    assert all(type(entry) is float for entry in on_floats(scheduled_jacobian)(2e3, 500.0, 112.0, 1.3, 1.4))
    gains = STRUCTURES["angle_damped"].gains
    assert on_floats(gains) is on_floats(gains)


def test_not_a_number_stays_one() -> None:
    assert all(map(math.isnan, on_floats(scheduled_jacobian)(math.nan, 500.0, 112.0, 1.3, 1.4)))
    assert math.isnan(on_floats(FUNCTIONS["power_flow.operating_point"])(1e9, 0.0, 112.0, 1.3, 1.4)[0])
