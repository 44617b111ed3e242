"""What a page shows of numbers and symbols: a minus, ∞ and subscripts, whoever wrote the text."""

from __future__ import annotations

import io
import math

import pytest
from rich.console import Console

from vsgdesign.linear.stability.verdict import _margin
from vsgdesign.report.drawing.quantities import merged, typeset
from vsgdesign.report.drawing.sketch import filled, svg
from vsgdesign.report.drawing.spark import key
from vsgdesign.report.page.blocks import Table, Where
from vsgdesign.report.page.html import environment, with_subscripts
from vsgdesign.report.page.terminal import print_terminal


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("P -2 kW, Q (-0.5) kvar", "P −2 kW, Q (−0.5) kvar"),
        ("decay inf 1/s, -inf dB", "decay ∞ 1/s, −∞ dB"),
        ("-0.01", "−0.01"),
        ("map_a-1.csv, 2026-11-22, 1e-05, 2-3, UTF-8, K-4", "map_a-1.csv, 2026-11-22, 1e-05, 2-3, UTF-8, K-4"),
        ("information, inf.csv, closed-form", "information, inf.csv, closed-form"),
    ],
)
def test_minus_and_infinity(text: str, shown: str) -> None:
    assert typeset(text) == shown
    page = environment().from_string("{{ text }}").render(text=text)
    assert page == with_subscripts(text) == shown


def test_states_of_the_transient_impedance_are_set_like_the_others() -> None:
    assert with_subscripts("i_f_d (4 %), i_g_q") == "<i>i</i><sub>f,d</sub> (4 %), <i>i</i><sub>g,q</sub>"


def test_a_margin_without_a_limit_is_said_in_words() -> None:
    assert [_margin(value, "dB", 6.0, False) for value in (math.inf, math.nan, 6.02)] == [
        "no limit",
        "unstable",
        "6.02 dB",
    ]
    assert _margin(5.9991, "dB", 6.0, True) == "5.999 dB"


def test_texts_that_differ_in_numbers_are_one() -> None:
    """A map has one reason for each cell: a page said the same sentence once for every bridge voltage."""
    said = "the steady state needs a bridge voltage of {} V peak, but the bridge makes at most 461.9 V."
    reasons = [said.format(492.6), said.format(462), "no gains", said.format(483), "P = -3 kW", "P = 2 kW"]
    assert merged(reasons) == {said.format("462 to 492.6"): 3, "no gains": 1, "P = -3 to 2 kW": 2}
    assert merged([said.format(483)] * 2) == {said.format(483): 2}
    assert merged([]) == {}


@pytest.mark.parametrize(
    ("value", "shown"),
    [("<b> & \"'", "&lt;b&gt; &amp; &#34;&#39;"), (filled("<b>"), "<b>"), (3, "3"), (key(0), svg(key(0), sized=True))],
)
def test_a_filled_form_escapes_what_is_no_html(value: object, shown: str) -> None:
    found = filled('<p class="{}">{}</p>\n', value, "a<b")
    assert found == f'<p class="{shown}">a&lt;b</p>\n'
    assert filled("{}", found) == found


@pytest.mark.parametrize("values", [(), (1,), (1, 2, 3)])
def test_a_form_has_a_value_for_each_place(values: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"shorter|longer"):
        filled("{} {}", *values)


@pytest.mark.parametrize(("width", "whole"), [(120, True), (52, True), (40, False)])
def test_a_word_is_broken_only_where_the_words_have_no_room(width: int, whole: bool) -> None:
    head = ("Structure", *4 * ("kept on all of the grids",))
    table = Table("", head, (("angle-damped", *"1234"),), flagged=frozenset({0}), on=Where.TERMINAL)
    out = io.StringIO()
    print_terminal([table], Console(file=out, width=width))
    lines = out.getvalue().splitlines()
    assert all(len(line) <= width for line in lines)
    assert any("angle-damped" in line for line in lines) is whole
