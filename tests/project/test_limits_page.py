"""docs/limits.md against the code, and against refusals that are really said."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.cli.small_studies import SMALL, failure
from vsgdesign.errors import StudyError
from vsgdesign.verbs.pipeline.opening import check_study
from website.limits import PAGE, UNKNOWN, Block, known_at, rendered

ROWS = re.findall(r"^\| (.*) \| (.+) \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.M)


def listed(field: str, problem: str, advice: str) -> bool:
    """Whether a row of the page says this, with "…" for anything."""

    def says(cell: str, text: str) -> bool:
        plain = re.sub(r"\\(.)", r"\1", cell.strip()).replace("&lt;", "<").replace("&amp;", "&")
        return re.fullmatch(re.escape(plain).replace(UNKNOWN, ".*"), text.rstrip("."), re.DOTALL) is not None

    said = ((fields.split(", "), *words) for fields, *words in ROWS)  # one row for several fields in the same words
    return any(
        any(says(one, field) for one in fields) and says(what, problem) and says(do, advice)
        for fields, what, do in said
    )


def test_the_page_is_that_of_the_code() -> None:
    assert PAGE.read_text(encoding="utf-8") == rendered(), "write it again: python -m website.limits"


FAULTY = (
    "[filter]\nL_2 = '1 mH'",
    "[[controllers]]\nname = 'a/b'\nkind = 'scheduled'\nschedule = 'table'",
    "[inner_loops]\ncurrent_prediction = 1",
    "[network]\nload = { series = {} }",
    "[power_loops]\nsettling_time = '1e6 s'",
    "[specification]\nsettling_time = '2 s'\nerror = 0.1\nerror_R = 0.1\nerror_X = 0.1\nscr = [9]",
)


@pytest.mark.parametrize("text", FAULTY)
def test_what_is_said_of_a_study_is_listed(text: str, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(f"{SMALL}\n{text}\n", encoding="utf-8")
    with pytest.raises(StudyError) as caught:
        check_study(tmp_path / "study.toml")
    for fault in caught.value.faults:
        names = (fault.field, fault.field.rpartition(".")[2], "")
        assert any(listed(name, fault.problem, fault.advice) for name in names), fault


def test_what_a_verb_says_is_listed(tmp_path: Path) -> None:
    (tmp_path / "notes.json").write_text("[1]", encoding="utf-8")
    for call in (("cite", tmp_path / "notes.json"), ("table", "show", tmp_path / "no.json")):
        problem, _, advice = failure(2, *call).removeprefix("error: ").strip().partition(". ")
        assert listed("", problem, advice), (problem, advice)


def test_a_field_that_the_code_goes_through_is_named() -> None:
    assert listed("L_2", "an LC filter has none", 'Set kind = "LCL" or remove it')
    for name in ("frequency", "voltage"):
        wanders = f"the {name} wanders ({name}_wander), but its rms value in the long run is zero"
        assert [row[0] for row in ROWS if re.sub(r"\\(.)", r"\1", row[1]) == wanders] == [f"{name}\\_deviation"]


def test_a_word_that_classes_give_is_named() -> None:
    """Kinds are looked up by one method, whose class says of each registry what is in it."""
    rows = [row[0].split(", ") for row in ROWS if row[1] == "must be one of …"]
    assert any({"structure", "kind of event", "kind of inverter"} <= set(fields) for fields in rows)


def test_only_what_may_still_be_meant_is_combined() -> None:
    early, late = (ast.parse(f"{chr(10) * line}x = 1").body[0].value for line in (1, 5))  # type: ignore[attr-defined]
    whole, branch = Block(0, 0, 99), Block(5, 5, 7)
    said = [(whole, early), (branch, late)]
    assert known_at(4, said) == said[:1]
    assert known_at(7, said) == said[1:]
    assert known_at(9, said) == said
