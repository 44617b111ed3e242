"""Quantities as text: exact decimal scaling, the right unit or a clear refusal."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from vsgdesign.study.parameters.reader import UnitError, format_quantity, parse_quantity

PREFIXES = {"p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "": 0, "k": 3, "M": 6, "G": 9}
PREFIXED = [
    ("V", "V"),
    ("A", "A"),
    ("W", "W"),
    ("VA", "VA"),
    ("var", "var"),
    ("var", "VAr"),
    ("var", "VAR"),
    ("Hz", "Hz"),
    ("s", "s"),
    ("H", "H"),
    ("F", "F"),
    ("ohm", "ohm"),
    ("ohm", "Ohm"),
    ("ohm", "\u03a9"),
    ("ohm", "\u2126"),
    ("rad", "rad"),
]


@pytest.mark.parametrize("prefix", PREFIXES)
@pytest.mark.parametrize(("dimension", "unit"), PREFIXED)
def test_every_prefix_of_every_unit_is_exact(dimension: str, unit: str, prefix: str) -> None:
    """The float nearest to the decimal number: what Python makes of the digits with an exponent."""
    for digits in ("1", "11.6", "50", ".3", "2.20", "7.", "1e2", "-4.7"):
        mantissa, _, exponent = digits.partition("e")
        expected = float(f"{mantissa}e{int(exponent or 0) + PREFIXES[prefix]}")
        assert parse_quantity(f"{digits} {prefix}{unit}", dimension) == expected
        assert parse_quantity(f"  {digits}{prefix}{unit}  ", dimension) == expected


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("50 uF", "F", 5e-5),
        ("11.6 mH", "H", 0.0116),
        ("200 us", "s", 2e-4),
        ("5 kVA", "VA", 5000.0),
        ("30 deg", "rad", math.pi / 6.0),
        ("-180°", "rad", -math.pi),
        ("5 %", "1", 0.05),
        ("5 pct", "1", 0.05),
        ("1.2 pu", "1", 1.2),
        ("1.2", "1", 1.2),
        ("11.6e-3", "H", 0.0116),
        (0.0116, "H", 0.0116),
        (3, "V", 3.0),
        (0, "1", 0.0),
        (1e-15, "rad/(s²·W)", 1e-15),
        ("2 A/V", "A/V", 2.0),
    ],
)
def test_known_values(text: object, dimension: str, value: float) -> None:
    # Percent and degrees multiply by a rounded factor: 1 ulp.
    assert parse_quantity(text, dimension) == pytest.approx(value, rel=3e-16, abs=0.0)


@pytest.mark.parametrize(
    ("value", "dimension", "reason"),
    [
        ("1 mF", "H", "expected a number in H"),
        ("1 H", "F", "expected a number in F"),
        ("1 kW", "VA", "expected a number in VA"),
        ("1 VA", "V", "expected a number in V"),
        ("1 xH", "H", "expected a number in H"),
        ("1 mm", "H", "expected a number in H"),
        ("1 mdeg", "rad", "expected an angle"),
        ("1 m%", "1", "expected a ratio"),
        ("1 V", "1", "expected a ratio"),
        ("1 mA/V", "A/V", "expected a plain number in A/V"),
        ("1 mh", "H", 'such as "1.5 mH"'),
        ("1 Mhz", "Hz", 'such as "1.5 kHz"'),
        ("", "H", "not a number with a unit"),
        ("mH", "H", "not a number with a unit"),
        ("1,5 mH", "H", "expected a number in H"),
        ("1.5.2", "H", "expected a number in H"),
        ("nan", "H", "not a number"),
        ("inf", "H", "not a number"),
        ("0x10", "H", "expected a number in H"),
        (True, "H", "expected a number in H"),
        (False, "1", "expected a ratio"),
        (None, "H", "expected a number in H"),
        ([1.0], "H", "expected a number in H"),
        ({"value": 1}, "H", "expected a number in H"),
        (math.nan, "H", "finite"),
        (math.inf, "H", "finite"),
        (-math.inf, "1", "finite"),
        ("1e400", "H", "finite"),
        ("1e999999 GH", "H", "finite"),
        ("1e99999999999999999999", "H", "finite"),
        (10**400, "H", "finite"),
    ],
)
def test_refusals_say_what_is_expected(value: object, dimension: str, reason: str) -> None:
    with pytest.raises(UnitError, match=reason):
        parse_quantity(value, dimension)


@examples(80)
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_bare_number_and_its_text_are_the_same(value: float) -> None:
    assert parse_quantity(value, "V") == value
    assert parse_quantity(repr(value), "V") == value


@examples(80)
@given(st.floats(min_value=1e-13, max_value=1e12), st.sampled_from(["H", "F", "s", "VA", "ohm"]))
def test_formatted_quantities_read_back(value: float, dimension: str) -> None:
    """What a message shows can be typed into a study: six digits survive."""
    shown = format_quantity(value, dimension)
    assert parse_quantity(shown, dimension) == pytest.approx(value, rel=6e-6)
    assert 0.99 <= abs(float(shown.split()[0])) <= 1000.0 or not 1e-12 <= value < 1e12


@examples(80)
@given(st.text(max_size=20), st.sampled_from(["H", "1", "rad", "A/V", "V"]))
def test_no_text_gets_past_as_anything_but_a_finite_number(text: str, dimension: str) -> None:
    try:
        value = parse_quantity(text, dimension)
    except UnitError:
        return
    assert math.isfinite(value)
