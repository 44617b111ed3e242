"""Every module, function and class that a page names in code exists, found in the source without importing it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "vsgdesign"
ROOMS = [*sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py") if path.parent.name != "study"), "errors"]
ROOMS += ["study.parameters", "study.datasheet"]  # a study is a variable of most examples, too
NAMED = re.compile(rf"`(?:vsgdesign\.)?((?:{'|'.join(ROOMS)})(?:\.\w+)+)(?:\(\))?`")
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "bench/README.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "studies").glob("*/README.md")),
]
MOVED = re.compile(r"(?m)^\| old \| new \|\n(?:\|.*\n)*")
"""A table of what has moved. Its first column is gone."""
FILES = {"report.html", "report.pdf", "explore.py", "estimator.weights.json", "simulation.reference_limit_pu"}
"""Names of files and of fields of a study, which look like names of code."""
VARIABLES = {"model.A", "model.faults"}
"""Variables of an example."""


def names_of(page: Path) -> set[str]:
    text = page.read_text(encoding="utf-8")
    if page.name == "CHANGELOG.md":
        text = text.partition("\n## [0.2.0]")[0]  # what is older may name what is gone
        text = MOVED.sub(lambda table: re.sub(r"(?m)^\|[^|]*\|", "|", table[0]), text)
    found = set(NAMED.findall(re.sub(r"```.*?```", "", text, flags=re.DOTALL)))
    return {name for name in found - FILES - VARIABLES if not re.search(r"\.(py|toml|npz|html)$", name)}


def exists(name: str) -> bool:
    """Whether the source has a module of this name, or one that defines its last parts."""
    place, parts = PACKAGE, name.split(".")
    while parts and (place / parts[0]).is_dir():
        place /= parts.pop(0)
    if parts and (place / f"{parts[0]}.py").exists():
        place /= f"{parts.pop(0)}.py"
    source = (place / "__init__.py" if place.is_dir() else place).read_text(encoding="utf-8")
    words = r"^\s*(?:async )?(?:def|class) {0}\b|^\s*{0}\s*[:=]|^\s*{0},$|\bimport .*\b{0}\b|\"{0}\""
    return all(re.search(words.format(re.escape(part)), source, re.MULTILINE) for part in parts)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_exists(page: Path) -> None:
    """Before: a page named a function that had been renamed."""
    assert {name for name in names_of(page) if not exists(name)} == set()


def test_a_name_that_is_gone_is_found() -> None:
    assert exists("equations.controller.controller_step")
    assert not exists("equations.controller.voltage_stage")
    assert sum(len(names_of(page)) for page in PAGES) > 150
