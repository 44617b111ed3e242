"""Everything that the restricted language has, compiled and compared with Python to the bit."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.codegen import language
from tests.codegen.compiled import Compiled
from tests.codegen.language import Nest, Pair
from tests.compilers import require_compiler
from tests.equations.test_three_ways import flat
from vsgdesign.codegen import UntranslatableError, c_functions

PLAIN = ("branches", "early", "keywords", "tuples", "choices")
FUNCTIONS = [
    getattr(language, name) for name in (*PLAIN, "flags", "records", "unfolded", "integrates", "picked", "changed")
]


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Compiled:
    require_compiler()
    text = c_functions(FUNCTIONS, fixed={"rule": "twice"})
    return Compiled(text, tmp_path_factory.mktemp("language"), "gcc", double=True)


INPUTS = np.vstack([np.random.default_rng(1).uniform(-4.0, 4.0, (500, 5)), np.ones((1, 5)), np.zeros((1, 5))])
INPUTS[::7, 1] = INPUTS[::7, 0]


def same(compiled: Compiled, name: str, rows: np.ndarray, call: Any) -> None:
    expected = np.array([flat(call(*row)) for row in rows.tolist()], dtype=float).reshape(len(rows), -1)
    np.testing.assert_array_equal(compiled(name, rows), expected)


@pytest.mark.parametrize("name", PLAIN)
def test_plain_functions(name: str, compiled: Compiled) -> None:
    same(compiled, name, INPUTS[:, :2], getattr(language, name))


def test_flags(compiled: Compiled) -> None:
    same(compiled, "flags", INPUTS[:, :3], lambda x, y, up: language.flags(x, y, up > 0.0))


def test_records(compiled: Compiled) -> None:
    same(compiled, "records", INPUTS, lambda x, y, a, b, c: language.records(x, y, Nest(Pair(a, b), c)))
    same(compiled, "picked", INPUTS[:, :4], lambda x, a, b, c: language.picked(x, Nest(Pair(a, b), c)))
    same(compiled, "changed", INPUTS[:, :4], lambda x, a, b, c: language.changed(x, Nest(Pair(a, b), c)))
    same(compiled, "integrates", INPUTS[:, :4], lambda a, b, c, x: language.integrates(Nest(Pair(a, b), c), x))


def test_what_is_known_is_folded_with_its_comments(compiled: Compiled) -> None:
    same(compiled, "unfolded", INPUTS[:, :1], lambda x: language.unfolded(x, "twice"))
    text = c_functions([language.unfolded], fixed={"rule": "twice"}).functions
    assert "Only of this branch." in text
    assert "Only of the other." not in text


def test_functions_of_one_name_are_two() -> None:
    text = c_functions([language.early]).functions
    assert "vsg_half(" in text
    assert "vsg_other_half(" in text


def test_two_values_of_one_constant_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vsgdesign.equations.frames.PHASES", 4.0)
    from vsgdesign.equations.frames import rated_current_rms
    from vsgdesign.equations.power_flow import power_flow

    with pytest.raises(UntranslatableError, match=r"constant PHASES: has two values, 3\.0 and 4\.0"):
        c_functions([power_flow, rated_current_rms])


def test_constants_that_are_no_numbers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(language, "GAIN", float("inf"))
    with pytest.raises(UntranslatableError, match="constant GAIN: is not finite"):
        c_functions([language.choices])


def test_the_text_does_not_depend_on_the_order_of_sets() -> None:
    """Python's hashes of texts are another in every process."""
    program = (
        "from vsgdesign.codegen import c_functions\n"
        "from tests.codegen import language as l\n"
        "print(c_functions([l.branches, l.records, l.integrates]).text)"
    )
    made = {
        subprocess.run(
            [sys.executable, "-c", program], env=os.environ | {"PYTHONHASHSEED": seed}, check=True, capture_output=True
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(made) == 1


def test_outputs_may_be_the_places_of_inputs() -> None:
    """Everything is read before anything is written: the state's new values go where the old ones are."""
    from tests.export.golden.__main__ import text

    for body in text().split("static inline ")[1:]:
        lines = [line.strip() for line in body.splitlines() if line.strip()]
        first = next((k for k, line in enumerate(lines) if line.startswith("following->")), len(lines))
        # A field that stays what it was is its own place.
        written = [line for line in lines[first:] if not re.fullmatch(r"following->(\w+) = state->\1;", line)]
        assert not any("state->" in line or "steps->" in line for line in written), body


def test_what_stays_as_it_was_is_copied_in_one_piece(tmp_path: Path) -> None:
    """Whole records, in either place; what changes its place, or could be another output's place, is read first."""
    text = c_functions([language.kept, language.swapped])
    assert "nest_out->inner = nest->inner;" in text.functions
    assert "made->inner = other;" in text.functions
    program = (
        text.text
        + """
#include <stdio.h>
int main(void)
{
    vsg_nest_t a = {{1, 2}, 3};
    vsg_twice_t made;
    vsg_pair_t one = {4, 5}, other = {6, 7};
    vsg_kept(&a, 10, &a, &made);
    vsg_swapped(&one, &other, &one, &other);
    printf("%g %g %g %g %g %g %g", (double)a.inner.first, (double)a.last, (double)made.inner.first, (double)one.first,
           (double)one.second, (double)other.first, (double)other.second);
    return 0;
}
"""
    )
    source, made = tmp_path / "kept.c", tmp_path / "kept"
    source.write_text(program, encoding="ascii")
    subprocess.run(["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-o", made, source, "-lm"], check=True)
    said = subprocess.run([made], check=True, capture_output=True, text=True).stdout
    assert said == "1 13 20 6 7 4 5"


def test_records_are_chosen_whole() -> None:
    """One choice, not one for each field; one "and" for all that it joins."""
    text = c_functions([language.picked]).functions
    assert "const vsg_pair_t inner = ((x > VSG_C(0.0)) && (nest->last < VSG_C(2.0)) && (x < VSG_C(3.0))) ?" in text
    assert text.count("?") == 2


def test_two_headers_of_one_folder_have_no_name_in_common() -> None:
    text = c_functions([language.picked, language.choices], prefix="other_")
    assert list(text.structs) == ["vsg_other_pair_t", "vsg_other_nest_t"]
    assert "#define VSG_OTHER_GAIN " in text.constants
