"""What is outside the restricted language is refused with file, line and what to write instead, once."""

from __future__ import annotations

import inspect
import re
from typing import Any

import pytest

from tests.codegen import language, other, refused
from vsgdesign.codegen import UntranslatableError, c_functions
from vsgdesign.equations.frames import linear_modulation_limit
from vsgdesign.equations.power_flow import power_flow

EXPECTED = {
    "uses_while": (1, "while. Write a step without a loop"),
    "uses_for": (1, "for. Write out its turns"),
    "uses_try": (1, "try. Write np.where"),
    "uses_remainder": (1, "%. Write np.floor"),
    "uses_floor_division": (1, "//. Write np.floor"),
    "uses_power": (1, "**. Write the product x * x"),
    "uses_list": (1, "a list. Write a tuple"),
    "uses_comprehension": (1, "sum is no name of this project. Call functions of this project"),
    "uses_lambda": (1, "lambda. Write a function"),
    "uses_assert": (1, "assert. Check inputs where they come in"),
    "uses_raise": (2, "raise. Check inputs where they come in"),
    "uses_builtin": (1, "max is no name of this project. Write np.maximum."),
    "uses_math": (1, "a call of math.sqrt. Write np.sqrt."),
    "uses_text": (1, "'1' is '1'. Write a number there."),
    "uses_walrus": (1, ":=. Write an assignment of its own"),
    "uses_membership": (1, "in. Compare with each"),
    "binds_in_one_branch": (3, "limit is bound in one branch only (line {1}). Bind it in both."),
    "binds_late": (1, "PHASES is not bound here. Bind it before."),
    "stores_in_a_field": (1, "refs.P_ref =. Bind plain names."),
    "without_names": (0, "result 1 of 2 has no name. Write in its docstring: Returns (a, b)"),
    "without_a_return": (0, "no return. Return its results."),
    "starred": (0, "*args or **kwargs. Name every argument."),
    "of_a_text": (
        0,
        "argument name of type str. Write Any, bool, a count, numbers or a NamedTuple, or give",
    ),
    "count_below_zero": (1, "later - one may be below zero. Write (a - b) & WHOLE, which wraps."),
    "quotient_of_counts": (1, "a / b of counts. Multiply one by 1.0 first."),
    "bits_of_numbers": (1, "x & y. Write `and` and `or`, or give two counts."),
    "place_that_is_no_count": (1, "row[x]. Give a count as its place."),
    "searches_otherwise": (1, "np.searchsorted(row, x, side='left'). Write len(row) or np.searchsorted("),
    "gives_a_number_for_a_count": (1, "argument ticks is no count. Give one."),
    "calls_itself": (0, "calls itself. Write out the turns."),
    "changes_no_field": (1, "the fields of References. Give P_ref, Q_ref, omega_0, V_n."),
    "changes_by_place": (1, "refs._replace(0.0). Give the new fields by name."),
    "advances_what_is_new": (1, "an integrator that is not as it came in."),
    "advances_twice": (2, "P_ref is advanced twice. Advance it once."),
    "advances_in_one_branch": (2, "an integrator that moves in one branch only."),
    "generates": (1, "yield. Return a tuple."),
    "unpacks_too_few": (1, "3 values for 2 names. Name each value."),
    "casts": (1, "float is no name of this project. Write the number itself."),
}


def test_every_kind_is_here() -> None:
    """A function in the file that nobody expects anything of would be forgotten."""
    written = {name for name, f in vars(refused).items() if inspect.isfunction(f) and f.__module__ == refused.__name__}
    assert written == EXPECTED.keys()


@pytest.mark.parametrize("name", EXPECTED)
def test_refused_with_its_place(name: str) -> None:
    function = getattr(refused, name)
    offset, said = EXPECTED[name]
    first = inspect.getsourcelines(function)[1]
    with pytest.raises(UntranslatableError) as caught:
        c_functions([function])
    message = str(caught.value)
    said = re.sub(r"\{(\d)\}", lambda m: str(first + int(m[1])), said)
    assert message.startswith(f"tests/codegen/refused.py:{first + offset}: {name}: {said}"), message
    assert "\n" not in message


def test_what_is_no_plain_function() -> None:
    with pytest.raises(UntranslatableError, match="has no Python source"):
        c_functions([len])
    with pytest.raises(UntranslatableError, match=r"test_refusals\.py:\d+: <lambda>: is not a plain function"):
        c_functions([lambda x: x])


def test_two_records_of_one_name() -> None:
    with pytest.raises(
        UntranslatableError, match=r"other\.Pair and tests\.codegen\.language\.Pair: are both called pair"
    ):
        c_functions([language.inside, other.joined])
    structs = c_functions([language.inside, other.joined], names={other.Pair: "ends"}).structs
    assert list(structs) == ["vsg_pair_t", "vsg_ends_t"]


def test_what_is_fixed_must_be_an_argument() -> None:
    with pytest.raises(ValueError, match=r"\['zero'\]: no function given has such an argument"):
        c_functions([power_flow], fixed={"zero": 0.0})


def test_known_arguments_fold_branches_away() -> None:
    sine = c_functions([linear_modulation_limit], fixed={"zero_sequence": False}).functions
    injected = c_functions([linear_modulation_limit], fixed={"zero_sequence": True}).functions
    assert "return dc_voltage / VSG_C(2.0);" in sine
    assert "return dc_voltage / VSG_SQRT_3;" in injected
    assert "zero_sequence" not in re.sub(r"/\*.*?\*/", "", sine + injected, flags=re.DOTALL)


def test_the_text_is_the_same_every_time() -> None:
    """And nothing in it depends on the machine: no path, no address."""
    made: list[Any] = [c_functions([power_flow, linear_modulation_limit]).text for _ in range(2)]
    assert made[0] == made[1]
    assert made[0].isascii()
    assert "0x" not in made[0]
