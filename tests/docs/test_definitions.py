"""docs/definitions.md against the definitions of the package: names, words, units, meanings and functions."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from vsgdesign.artifacts.definitions import DEFINITIONS, Definition, damping_of, in_words

PAGE = Path(__file__).resolve().parents[2] / "docs" / "definitions.md"
HEADER = "| name | words | unit | meaning | function |"
SECTIONS = {"Disk margin": "disk_margin_", "Damping ratio": "damping_"}
"""Sections with such a table, and how the names in it begin."""


def row_of(name: str, one: Definition) -> str:
    unit = "–" if one.unit == "1" else one.unit
    function = one.function.removeprefix("vsgdesign.")
    return f"| `{name}` | {one.title} | {unit} | {one.meaning} | `{function}` |"


def written(page: str) -> str:
    """The page with the tables as the definitions have them."""
    lines: list[str] = []
    section, skipping = "", False
    for line in page.splitlines():
        section = line.removeprefix("## ") if line.startswith("## ") else section
        skipping = skipping and line.startswith("|")
        if skipping:
            continue
        lines.append(line)
        if line == HEADER and section in SECTIONS:
            rows = [row_of(name, one) for name, one in DEFINITIONS.items() if name.startswith(SECTIONS[section])]
            lines += ["| --- | --- | --- | --- | --- |", *rows]
            skipping = True
    return "\n".join(lines) + "\n"


def test_the_tables_are_those_of_the_definitions() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == written(page), "write them anew: python -m tests.docs.test_definitions"
    assert all(f"| `{name}` |" in page for name in DEFINITIONS)


@pytest.mark.parametrize("name", DEFINITIONS)
def test_the_function_of_a_definition_exists(name: str) -> None:
    module, _, function = DEFINITIONS[name].function.rpartition(".")
    assert callable(getattr(importlib.import_module(module), function))


def test_one_title_means_one_figure() -> None:
    titles = [one.title for one in DEFINITIONS.values()]
    assert len(set(titles)) == len(titles)


def test_fields_of_a_specification_are_told_in_words() -> None:
    """The page of a table had "settling_time" and "disk_margin → 0.9" as the constraints of its cells."""
    assert (
        in_words("settling_time → 1.35; disk_margin → 0.9") == "settling time → 1.35; disk margin at the output → 0.9"
    )
    assert in_words("between nodes: damping_ratio → 0.4") == "between nodes: damping ratio of the power loops → 0.4"
    assert in_words("H_min, H and Hz") == "least inertia constant, inertia constant and Hz"
    assert in_words("disk margin (1)") == "disk margin (1)"
    assert damping_of("reduced") != damping_of("full_order")


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
