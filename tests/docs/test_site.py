"""The web site: its navigation leads to every page, once, and its equations can be found."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from website.staging import API, EQUATION, NOTE, ROOT, equation, exists

NAVIGATION = (ROOT / "website" / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]


def test_the_navigation_has_every_page_once() -> None:
    listed = Counter(re.findall(r"[\w/.-]+\.md", NAVIGATION))
    pages = [*(ROOT / "docs").rglob("*.md"), *(ROOT / "studies").rglob("*.md")]
    pages += [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "bench/README.md")]
    assert listed == Counter(str(page.relative_to(ROOT)) for page in pages)


def test_an_equation_keeps_its_label_and_loses_its_tag() -> None:
    asked = []

    def render(text: str) -> str:
        asked.append(text)
        return "<math/>"

    shown = equation("\\begin{aligned}\na &= b \\\\\nc &= d\n\\end{aligned}\n\\tag{some-label}", render)
    assert asked == ["\\begin{align*} a &= b \\\\ c &= d \\end{align*}"]
    assert shown == '<div class="equation"><div><math/></div><span class="label">(some-label)</span></div>'


def test_every_equation_of_the_theory_would_be_rendered() -> None:
    for page in sorted((ROOT / "docs" / "theory").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        assert len(EQUATION.findall(text)) == text.count("\n$$\n") / 2, page.name


def test_notes_of_the_tests_do_not_reach_a_reader() -> None:
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "<!--" in page
    assert "<!--" not in NOTE.sub("", page)


def test_public_modules_are_there() -> None:
    """A misspelt one would be left out of the site in silence."""
    assert [name for _, names in API.values() for name in names if not exists(name)] == []


def test_nothing_is_fetched_when_a_page_is_read() -> None:
    settings = (ROOT / "website" / "mkdocs.yml").read_text(encoding="utf-8")
    assert "font: false" in settings
    assert not re.search(r"https?://", settings)
    assert not re.search(r"https?://|@import", (Path(ROOT) / "website" / "site.css").read_text(encoding="utf-8"))
