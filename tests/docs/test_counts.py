"""What pages say of how many there are, and which: studies, cases, measures, names of the package, benchmarks."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import vsgdesign
from vsgdesign.campaigns.compliance.measures import MEASURES
from vsgdesign.study.parameters.loading import case_names

ROOT = Path(__file__).resolve().parents[2]
WORDS = dict(enumerate(("nine", "ten", "eleven", "twelve", "thirteen", "fourteen", "fifteen"), 9)) | dict(
    enumerate(("sixteen", "seventeen", "eighteen", "nineteen", "twenty"), 16)
)


def text(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def test_the_index_knows_how_many_studies_there_are() -> None:
    studies = {file.parent.name for file in (ROOT / "studies").glob("*/study.toml")}
    shown = set(re.findall(r"^\| .*\[(\w+)\]\(\w+/README\.md\) \| \*\*", text("studies/README.md"), re.M))
    assert studies | {"walk_through"} == shown  # this one draws figures only
    assert f"{WORDS[len(studies)].capitalize()} worked studies" in text("docs/README.md")


def test_the_readme_knows_how_many_cases_there_are() -> None:
    assert f"{WORDS[len(case_names())]} cases" in text("README.md")
    assert all(f"`case:{name}`" in text("docs/converters.md") for name in case_names())


def test_the_changelog_knows_how_many_measures_there_are() -> None:
    assert f"- {len(MEASURES)} [measures]" in text("CHANGELOG.md")


def test_every_public_name_is_on_the_page_on_python() -> None:
    page = text("docs/how-to/python.md")
    names = set(vsgdesign.__all__) - {"__version__"}
    assert {name for name in names if not re.search(rf"`vd\.{name}\b", page)} == set()


def test_functions_named_beside_verbs_exist() -> None:
    rows = re.findall(r"^\| (`vd\.[^|]*) \|", text("docs/how-to/python.md"), re.M)
    names = {name for row in rows for name in re.findall(r"vd\.(\w+)", row)}
    assert {"verify", "grid", "load"} <= names
    assert names - set(vsgdesign.__all__) == set()


def test_every_benchmark_is_listed() -> None:
    with_rows = {
        file.name for file in (ROOT / "bench").glob("*.py") if re.search(r"^BENCHMARKS\b", file.read_text(), re.M)
    }
    assert set(re.findall(r"^\| `(\w+\.py)` \|", text("bench/README.md"), re.M)) == with_rows


def test_the_list_of_studies_has_the_figures_of_the_studies() -> None:
    """Before: 297 and 244 tests in the list, where the study itself says 292 and 243."""
    figures = re.findall(r"\b\d+ of 55\d\b", text("studies/gridcode/README.md"))
    assert figures
    assert set(re.findall(r"\b\d+ of 55\d\b", text("studies/README.md"))) <= set(figures)


def test_every_page_is_found_from_the_index() -> None:
    """By a question or a title, not by an equation alone. Before: the how-to of the field estimator was not."""
    index = text("docs/README.md").partition("\n## Equations")[0]
    linked = {target.partition("#")[0] for target in re.findall(r"\]\(([^)]+)\)", index)}
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert pages - linked == {"README.md"}


def test_the_signature_of_an_event_names_every_field() -> None:
    section = text("docs/study-file.md").partition("\n## `[[events]]`")[2].partition("\n###")[0]
    fields = set(re.findall(r"^\| `(\w+)` \|", section, re.M))
    assert fields
    assert fields == set(inspect.signature(vsgdesign.event).parameters)


def test_pages_have_the_sums_of_the_survival_table() -> None:
    """What a new measurement changes in the table has to change in every sentence that sums it."""
    page = text("docs/survival.md")
    table = page.partition("\n## What was measured\n")[2].partition("\nIn all, ")[0]
    rows = [line.split("|") for line in table.splitlines() if re.match(r"\| [\d.]+ [kM]VA, ", line)]
    assert len(rows) == 6
    late, never = (
        " of ".join(f"{sum(counts):,}" for counts in zip(*(pair(row[column]) for row in rows), strict=True))
        for column in (2, 3)
    )
    assert f"In all, {late} disturbances" in page
    assert never in page
    for other in ("README.md", "studies/survival/README.md"):
        assert late in text(other).replace("\n", " "), other


def pair(cell: str) -> tuple[int, int]:
    """2,026 of 2,027 as numbers."""
    survived, judged = re.findall(r"[\d,]+", cell)[:2]
    return int(survived.replace(",", "")), int(judged.replace(",", ""))
