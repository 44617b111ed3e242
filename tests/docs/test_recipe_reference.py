"""The table of a recipe's fields in docs/how-to/windows.md against the reader: both ways, and the limits at work."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path

import pytest

from vsgdesign.errors import StudyError
from vsgdesign.estimator.recipe_fields import check_recipe
from vsgdesign.estimator.recipes import CONTINUOUS, WINDOW_RECIPES, WindowRecipe
from vsgdesign.study.parameters.estimator import RECIPES as NAMES
from vsgdesign.study.parameters.fields import Field, at, fields_of
from vsgdesign.study.parameters.ranges import Spread, one_of

FIELDS = {one.name: one for one in fields_of(WindowRecipe)}
PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "windows.md"


def page() -> dict[str, list[str]]:
    """Cells of every row of the table under "Fields", by field."""
    text = PAGE.read_text(encoding="utf-8").split("## Fields")[1].split("\n## ")[0]
    lines = [line for line in text.splitlines() if line.startswith("| `")]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert len({row[0] for row in rows}) == len(rows)
    return {row[0].strip("`"): row[1:] for row in rows}


def test_page_and_reader_name_the_same_fields() -> None:
    assert set(page()) - {"base"} == set(FIELDS) == {field.name for field in fields(WindowRecipe)}
    assert set(NAMES) == set(WINDOW_RECIPES.packaged) == set(re.findall(r"`(\w+)`", page()["base"][1]))


def kind_on_page(rule: Field) -> str:
    unit = {"1": "–"}.get(rule.unit, rule.unit)
    return {"spread": f"spread, {unit}", "number": unit}.get(rule.kind, rule.kind)


@pytest.mark.parametrize("name", FIELDS)
def test_kind_limits_and_default(name: str) -> None:
    kind, limits, default, _ = page()[name]
    rule = FIELDS[name]
    assert kind == kind_on_page(rule)
    if rule.words:
        assert tuple(re.findall(r"`(\w+)`", limits)) == rule.words
    if rule.kind in ("spread", "number", "whole number"):
        assert [float(part) for part in limits.split(" to ")] == [at(rule.low, {}), at(rule.high, {})]
    value = getattr(CONTINUOUS, name)
    if rule.zero:
        assert (value, default) == (0, "of the converter")
    elif isinstance(value, Spread):
        assert default.split() == [value.kind, *(f"{one:g}" for one in value.values)] or (
            value.kind == "one_of" and default == f"{value.values[0]:g}"
        )
    elif rule.kind != "text":
        assert default == (f"`{value}`" if rule.words else str(value).lower())


LIMITED = [name for name, rule in FIELDS.items() if rule.kind in ("spread", "number", "whole number")]


@pytest.mark.parametrize("name", LIMITED)
def test_limits_hold_at_both_ends(name: str, tmp_path: Path) -> None:
    rule = FIELDS[name]
    made = one_of if rule.kind == "spread" else int if rule.kind == "whole number" else float
    low, high = at(rule.low, {}), at(rule.high, {})
    beyond = 1 if rule.kind == "whole number" else 1e-6 * max(abs(low), abs(high))
    partner = {"after": 1} if name == "before" else {"before": 1} if name == "after" else {}
    for value in (low, high):
        check_recipe(replace(CONTINUOUS, **partner | {name: made(value)}))
    for value in (-1 if rule.zero else low - beyond, high + beyond):
        with pytest.raises(StudyError, match=f"{name} = .*: (outside|must be a whole number from) .* to "):
            check_recipe(replace(CONTINUOUS, **partner | {name: made(value)}))
    path = tmp_path / "r.toml"
    for text in ("nan", "inf", "true", '"3 furlongs"', "[1]", "{}"):
        path.write_text(f"{name} = {text}\n", encoding="utf-8")
        with pytest.raises(StudyError, match=f"{name} = "):
            WINDOW_RECIPES.load(path)
