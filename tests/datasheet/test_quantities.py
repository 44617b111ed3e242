"""Quantities as people type them: prefixes, decimal signs, ranges, and what stands behind the unit."""

from __future__ import annotations

import pytest

from vsgdesign.study.datasheet.quantities import AmountError, read_amount, read_number

RATING, VOLTAGE, CURRENT = ("VA", "W"), ("V",), ("A", "1")
INDUCTOR, CAPACITOR, RATIO = ("H", "ohm", "1"), ("F", "var", "1"), ("1",)


@pytest.mark.parametrize(
    ("text", "bases", "value", "base", "words"),
    [
        ("480 Vac", VOLTAGE, 480.0, "V", set()),
        ("480 VAC", VOLTAGE, 480.0, "V", set()),
        ("480 V L-L", VOLTAGE, 480.0, "V", {"ll"}),
        ("480 V (line-to-line, rms)", VOLTAGE, 480.0, "V", {"ll", "rms"}),
        ("0.48 kV", VOLTAGE, 480.0, "V", set()),
        ("277 V phase-to-neutral", VOLTAGE, 277.0, "V", {"ln"}),
        ("400 V ± 10 %", VOLTAGE, 400.0, "V", set()),
        ("850Vdc", VOLTAGE, 850.0, "V", set()),
        ("250 kVA", RATING, 250e3, "VA", set()),
        ("200 KW", RATING, 200e3, "W", set()),
        ("1.5 MVA", RATING, 1.5e6, "VA", set()),
        ("2,5 mH", INDUCTOR, 2.5e-3, "H", set()),
        ("190 µH", INDUCTOR, 190e-6, "H", set()),
        ("190 \u03bcH", INDUCTOR, 190e-6, "H", set()),
        ("0.1 pu", INDUCTOR, 0.1, "1", {"pu"}),
        ("10 p.u.", INDUCTOR, 10.0, "1", {"pu"}),
        ("6 %", INDUCTOR, 0.06, "1", {"pu"}),
        ("50 mΩ", ("ohm", "1"), 0.05, "ohm", set()),
        ("50 m\u2126", ("ohm", "1"), 0.05, "ohm", set()),
        ("3 x 50 uF (delta)", CAPACITOR, 50e-6, "F", {"delta"}),
        ("3×50 µF Δ", CAPACITOR, 50e-6, "F", {"delta"}),
        ("50 uF D", CAPACITOR, 50e-6, "F", {"delta"}),
        ("50 uF per phase, star", CAPACITOR, 50e-6, "F", {"star"}),
        ("12 kvar", CAPACITOR, 12e3, "var", set()),
        ("450 A rms", CURRENT, 450.0, "A", {"rms"}),
        ("450 Arms", CURRENT, 450.0, "A", {"rms"}),
        ("600 A peak", CURRENT, 600.0, "A", {"peak"}),
        ("600 Apk", CURRENT, 600.0, "A", {"peak"}),
        ("150 %", CURRENT, 1.5, "1", {"pu"}),
        ("approx. 1.5 mH", INDUCTOR, 1.5e-3, "H", set()),
        ("1.5e-3 H", INDUCTOR, 1.5e-3, "H", set()),
        ("1 250 kVA", RATING, 1.25e6, "VA", set()),
        ("1\u202f250 kVA", RATING, 1.25e6, "VA", set()),
    ],
)
def test_one_value(text: str, bases: tuple[str, ...], value: float, base: str, words: set[str]) -> None:
    amount = read_amount(text, bases)
    assert amount.value == pytest.approx(value, rel=1e-12)
    assert (amount.base, amount.words) == (base, words)


@pytest.mark.parametrize(
    ("text", "bases", "ends"),
    [
        ("1.5 to 20", RATIO, (1.5, 20.0)),
        ("1.5-20", RATIO, (1.5, 20.0)),
        ("1.5 - 20", RATIO, (1.5, 20.0)),
        ("1,5 – 20", RATIO, (1.5, 20.0)),
        ("1.5…20", RATIO, (1.5, 20.0)),
        ("1.5 .. 20", RATIO, (1.5, 20.0)),
        ("0,3 bis 20", RATIO, (0.3, 20.0)),
        ("5", RATIO, (5.0,)),
        ("[1.5, 20]", RATIO, (1.5, 20.0)),
        ("5 - 40 MVA", ("VA",), (5e6, 40e6)),
        ("500 kVA to 4 MVA", ("VA",), (5e5, 4e6)),
        ("20 mohm to 0.3 ohm", ("ohm", "1"), (0.02, 0.3)),
        ("1e-2 - 3e-1 ohm", ("ohm", "1"), (0.01, 0.3)),
        ("700-1000 Vdc", VOLTAGE, (700.0, 1000.0)),
    ],
)
def test_a_range(text: str, bases: tuple[str, ...], ends: tuple[float, ...]) -> None:
    assert read_amount(text, bases, ranged=True).values == pytest.approx(ends, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "comma", "value"),
    [
        ("12,5", False, 12.5),
        ("12.5", False, 12.5),
        ("1.250,5", False, 1250.5),
        ("1,250.5", False, 1250.5),
        ("1,250", True, 1.25),
        ("1.250", False, 1.25),
        ("0,250", False, 0.25),
        ("1.250.000", True, 1.25e6),
        ("1'250", False, 1250.0),
        ("-3", False, -3.0),
        (".5", False, 0.5),
    ],
)
def test_a_number(text: str, comma: bool, value: float) -> None:
    assert read_number(text, comma) == value


@pytest.mark.parametrize(
    ("text", "comma", "advice"),
    [("1,250", False, "1250 or 1.2500"), ("1.250", True, "1250 or 1.2500"), ("12.500", True, "12500 or 12.5000")],
)
def test_what_may_be_a_thousand_or_a_fraction_is_asked(text: str, comma: bool, advice: str) -> None:
    with pytest.raises(AmountError) as caught:
        read_number(text, comma)
    assert "thousand or a decimal fraction" in caught.value.problem
    assert advice in caught.value.advice


@pytest.mark.parametrize(
    ("text", "bases", "said"),
    [
        ("ten", RATING, "not a number"),
        ("nan", RATING, "not a number"),
        ("inf kVA", RATING, "not a number"),
        ("", RATING, "not a"),
        ("5 mH", CAPACITOR, "not a unit of this field"),
        ("5 uF", INDUCTOR, "H, mH or uH"),
        ("480 V banana", VOLTAGE, "banana"),
        ("1e999 V", VOLTAGE, "finite"),
        ("1-2-3", RATIO, "range"),
    ],
)
def test_what_is_no_quantity(text: str, bases: tuple[str, ...], said: str) -> None:
    with pytest.raises(AmountError, match=said):
        read_amount(text, bases, ranged=text == "1-2-3")
