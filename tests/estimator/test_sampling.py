"""Windows on any converter: whole cycles of whole control periods, what a recipe gives, and what cannot be."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from vsgdesign.errors import StudyError
from vsgdesign.estimator.recipes import (
    CONTINUOUS,
    MOST_CYCLES,
    NEAR,
    PUBLISHED,
    describe_sampling,
    missed_cycles,
    turn_per_window,
    with_sampling,
)
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.ranges import one_of

BASE = study_from_text(
    'base = "case:hoang2025_5kva"\nsimulation = { duration = "1 s", P_ref = 0, Q_ref = 0 }\n'
    'controllers = [{ name = "a", kind = "scheduled" }]'
).converter


def converter(f_n: float, f_sw: float, per_carrier: int = 1) -> Converter:
    return replace(BASE, omega_n=2.0 * math.pi * f_n, f_sw=f_sw, samples_per_carrier=per_carrier)


@pytest.mark.parametrize(
    ("f_n", "f_sw", "per_carrier", "expected"),
    [
        (50.0, 10e3, 2, (100, 200e-6, 1)),
        (60.0, 3e3, 2, (100, 1 / 6000, 1)),
        (60.0, 5e3, 1, (250, 200e-6, 3)),
        (60.0, 8e3, 1, (200, 250e-6, 3)),
        (60.0, 10e3, 1, (250, 200e-6, 3)),
        (60.0, 4e3, 1, (200, 250e-6, 3)),
        (60.0, 6e3, 1, (100, 1 / 6000, 1)),
        (50.0, 4e3, 1, (80, 250e-6, 1)),
        (50.0, 10e3, 1, (100, 200e-6, 1)),
        (50.0, 20e3, 2, (100, 200e-6, 1)),
        (60.0, 20e3, 1, (250, 200e-6, 3)),
        (50.0, 2e3, 1, (40, 500e-6, 1)),
        (50.0, 1e3, 1, (20, 1e-3, 1)),
    ],
)
def test_known_converters(f_n: float, f_sw: float, per_carrier: int, expected: tuple[int, float, int]) -> None:
    one = converter(f_n, f_sw, per_carrier)
    found = with_sampling(PUBLISHED, one)
    assert (found.samples, found.cycles) == (expected[0], expected[2])
    assert found.sample_interval == pytest.approx(expected[1], rel=1e-12)
    assert turn_per_window(found, one) == 0.0
    assert with_sampling(found, one) == found


def test_the_published_window_is_to_the_last_bit() -> None:
    found = with_sampling(PUBLISHED, BASE)
    assert (found.sample_interval, found.samples) == (200e-6, 100)
    assert describe_sampling(found, BASE) == "100 samples every 200 µs, 20 ms: 1 cycle of 50 Hz"


@pytest.mark.parametrize("seed", range(60))
def test_any_converter_has_a_window(seed: int) -> None:
    """Whole control periods always; whole cycles wherever exact arithmetic finds a whole number of them."""
    rng = np.random.default_rng(seed)
    f_n, rate = int(rng.choice([50, 60])), int(rng.integers(1000, 60000))
    one = converter(f_n, float(rate))
    found = with_sampling(CONTINUOUS, one)
    steps = found.sample_interval * rate
    assert steps == pytest.approx(round(steps), abs=1e-9)
    assert 1 <= found.cycles <= MOST_CYCLES
    assert 8 <= found.samples <= 200 * MOST_CYCLES
    missed = Fraction(found.samples * round(steps) * f_n, rate) - found.cycles
    assert missed_cycles(found, one) == pytest.approx(float(missed), abs=1e-6)
    # Whole cycles exist where the control periods of so many are whole, and divide into 40 to 200 a cycle.
    exact = [
        cycles
        for cycles in range(1, MOST_CYCLES + 1)
        if (whole := Fraction(cycles * rate, f_n)).denominator == 1
        and any(whole % step == 0 and 40 <= Fraction(rate, f_n) / step <= 200 for step in range(1, 60))
    ]
    if exact:
        assert (missed, found.cycles) == (0, exact[0])
    elif rate / f_n > 100:
        assert abs(missed) <= NEAR


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"cycles": 2}, (100, 400e-6, 2)),
        ({"samples": 50}, (50, 400e-6, 1)),
        ({"sample_interval": 100e-6}, (200, 100e-6, 1)),
        ({"samples": 200, "sample_interval": 100e-6}, (200, 100e-6, 1)),
        ({"samples": 30, "sample_interval": 100e-6}, (30, 100e-6, 1)),
        ({"samples": 400, "cycles": 4}, (400, 200e-6, 4)),
    ],
)
def test_what_a_recipe_gives_is_kept(given: dict[str, Any], expected: tuple[int, float, int]) -> None:
    found = with_sampling(replace(PUBLISHED, **given), BASE)
    assert found.sample_interval == pytest.approx(expected[1]) or "cycles" in given
    assert all(getattr(found, name) == value for name, value in given.items())
    if given != {"cycles": 2}:
        assert (found.samples, found.cycles) == (expected[0], expected[2])
    else:
        assert (found.samples, found.sample_interval) == (200, 200e-6)


@pytest.mark.parametrize(
    ("given", "one", "problem"),
    [
        ({"sample_interval": 170e-6}, BASE, r"sample_interval = 170 µs: no whole number .* 50 µs.* 150 µs or 200 µs"),
        ({"sample_interval": 10e-6}, BASE, r"sample_interval = 10 µs: no whole number .* give 50 µs\."),
        ({"samples": 100, "sample_interval": 200e-6, "cycles": 2}, BASE, r"cycles = 2: 100 samples .* miss 2 nominal"),
        (
            {"sample_interval": 0.05},
            BASE,
            r"sample_interval = 0.05 s: leaves fewer than 4 samples in 6 .* at most 0.03 s",
        ),
        ({}, converter(60.0, 100.0), r"converter.f_sw = 100 Hz: 1.67 control periods .* too few .* Raise f_sw"),
    ],
)
def test_what_does_not_fit_is_named(given: dict[str, Any], one: Converter, problem: str) -> None:
    with pytest.raises(StudyError, match=problem):
        with_sampling(replace(PUBLISHED, **given), one)


def test_a_window_beside_whole_cycles_is_turned_back() -> None:
    one = converter(50.0, 4321.0)
    found = with_sampling(PUBLISHED, one)
    assert (found.samples, found.cycles) == (86, 1)
    # 86 of 86.42 control periods.
    assert turn_per_window(found, one) == pytest.approx(2.0 * math.pi * (86 / 86.42 - 1.0), rel=1e-9)
    assert "1 cycle of 50 Hz less 0.0049 of one" in describe_sampling(found, one)
    assert not replace(found, phase=one_of(1.0)).synchronised
