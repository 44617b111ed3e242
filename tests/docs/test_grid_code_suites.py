"""docs/grid-code-suites.md against the packaged suites: the page is written from their files."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vsgdesign.campaigns.compliance.reading import SUITES, packaged_document, suite_named
from website.grid_code_suites import suite_markdown

PAGE = Path(__file__).resolve().parents[2] / "docs" / "grid-code-suites.md"


def section(name: str) -> str:
    return suite_markdown(suite_named(name), packaged_document(name))


def order() -> list[str]:
    """This project's own suite at the end."""
    return sorted(SUITES, key=lambda name: (name == "own", name))


@pytest.mark.parametrize("name", SUITES)
def test_the_page_says_what_the_suite_holds(name: str) -> None:
    advice = "the page is not of these suites: python -m tests.docs.test_grid_code_suites writes it anew"
    assert section(name) in PAGE.read_text(encoding="utf-8"), advice


def test_the_page_has_no_other_suites() -> None:
    headings = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("## ")]
    assert headings == [f"## {suite_named(name).title}" for name in order()]


def test_other_pages_know_how_many_tests_there_are() -> None:
    counts = [
        int(found) for found in re.findall(r"^`--suite \w+`, (\d+) tests", PAGE.read_text(encoding="utf-8"), re.M)
    ]
    assert len(counts) == len(SUITES)
    for page in ("README.md", "CHANGELOG.md"):
        assert re.search(rf"\b{sum(counts)}\b[\w ]* tests", (PAGE.parents[1] / page).read_text(encoding="utf-8")), page


if __name__ == "__main__":
    intro = PAGE.read_text(encoding="utf-8").partition("\n## ")[0]
    PAGE.write_text("\n".join([f"{intro.rstrip()}\n", *map(section, order())]), encoding="utf-8")
