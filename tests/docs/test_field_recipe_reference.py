"""The table of the field recipe's fields in docs/how-to/estimator.md against the reader: both ways."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path

import pytest

from vsgdesign.errors import StudyError
from vsgdesign.estimator.recipe_fields import check_recipe
from vsgdesign.estimator.recipes import FIELD, FIELD_RECIPES, FieldRecipe
from vsgdesign.study.parameters.estimator import FIELD_RECIPES as NAMES
from vsgdesign.study.parameters.fields import at, fields_of
from vsgdesign.study.parameters.ranges import Spread, one_of

FIELD_FIELDS = {one.name: one for one in fields_of(FieldRecipe)}
PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "estimator.md"


def page() -> dict[str, list[str]]:
    """Cells of every row of the table, by field."""
    text = PAGE.read_text(encoding="utf-8").split("## A network behind the field estimator")[1].split("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| `")
    ]
    return {row[0].strip("`"): row[1:] for row in rows}


def test_page_and_reader_name_the_same_fields() -> None:
    assert list(page()) == list(FIELD_FIELDS)
    assert set(FIELD_FIELDS) == {field.name for field in fields(FieldRecipe)}
    assert set(NAMES) == set(FIELD_RECIPES.packaged)


@pytest.mark.parametrize("name", FIELD_FIELDS)
def test_kind_limits_and_default(name: str) -> None:
    kind, limits, default, _ = page()[name]
    rule, value = FIELD_FIELDS[name], getattr(FIELD, name)
    unit = {"1": "–"}.get(rule.unit, rule.unit)
    assert kind == {"spread": f"spread, {unit}", "number": unit}.get(rule.kind, rule.kind)
    if rule.words:
        assert tuple(re.findall(r"`(\w+)`", limits)) == rule.words
    elif rule.kind in ("spread", "number", "whole number"):
        assert [float(part) for part in limits.split(" to ")] == [at(rule.low, {}), at(rule.high, {})]
    if isinstance(value, Spread):
        assert default.split() == [value.kind, *(f"{one:g}" for one in value.values)]
    elif rule.kind in ("number", "whole number"):
        assert float(default) == value
    elif rule.words:
        assert default == f"`{value}`"


LIMITED = [name for name, rule in FIELD_FIELDS.items() if rule.kind in ("spread", "number", "whole number")]


@pytest.mark.parametrize("name", LIMITED)
def test_what_is_beyond_a_limit_is_refused(name: str) -> None:
    rule = FIELD_FIELDS[name]
    made = one_of if rule.kind == "spread" else int if rule.kind == "whole number" else float
    low, high = at(rule.low, {}), at(rule.high, {})
    beyond = 1 if rule.kind == "whole number" else 1e-6 * max(abs(low), abs(high))
    for value in (low - beyond, high + beyond):
        with pytest.raises(StudyError, match=f"{name} = .*: (outside|must be a whole number from) .* to "):
            check_recipe(replace(FIELD, **{name: made(value)}))
