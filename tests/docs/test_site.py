"""The web site: its navigation leads to every page, once, and its equations can be found."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from latex2mathml.converter import convert

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.report.explore.session import Session
from website.explorer import HOW, MARK, embed_explorers, shown_of
from website.staging import API, EQUATION, FILES, FOLDERS, NOTE, ROOT, equation, exists, parted

GALLERY = (ROOT / "studies" / "README.md").read_text(encoding="utf-8")
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


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        (r"a = b, \qquad c = d", [["a = b,", "c = d"]]),
        (r"a \quad\text{if }\quad b", [["a", r"\text{if }", "b"]]),
        (r"\begin{align*} a &= b \qquad c \\ d \end{align*}", [[r"\begin{align*} a &= b \qquad c \\ d \end{align*}"]]),
        (r"\left(a \quad b\right) \quad \{ c \quad d \}", [[r"\left(a \quad b\right)", r"\{ c", r"d \}"]]),
        (r"\begin{cases} a \\ b \end{cases} \qquad c", [[r"\begin{cases} a \\ b \end{cases}", "c"]]),
        (r"\begin{gathered} a \quad b \\ c \end{gathered}", [["a", "b"], ["c"]]),
    ],
)
def test_an_equation_is_parted_at_its_rows_and_wide_spaces(text: str, rows: list[list[str]]) -> None:
    """Before: the rows of {gathered} were one line, and 58 equations were cut off at 1280 px."""
    assert parted(text) == rows


def test_every_equation_is_rendered_whole() -> None:
    """Before: latex2mathml left \\arg as it is, and the site could not be built."""
    for page in [*(ROOT / "docs").rglob("*.md"), *(ROOT / "studies").rglob("*.md")]:
        for body in EQUATION.findall(page.read_text(encoding="utf-8")):
            assert "<math" in equation(body, lambda text: convert(text, display="block"))


def test_links_lead_to_pages_and_files_of_the_site() -> None:
    """Before: links to source files, which the site does not have, kept it from being built."""
    pages = [ROOT / name for name in FILES if name.endswith(".md")]
    pages += [page for folder in FOLDERS for page in (ROOT / folder).rglob("*.md")]
    inside = [ROOT / name for name in FOLDERS]
    lost = []
    for page in pages:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)#\s]+)", text):
            at = (page.parent / target).resolve()
            if "://" not in target and at not in [ROOT / name for name in FILES]:
                lost += [] if any(folder in at.parents for folder in inside) else [f"{page.name}: {target}"]
    assert lost == []


def test_an_explorer_takes_the_place_of_its_mark(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "study.toml").write_text("", encoding="utf-8")
    pages, asked = [tmp_path / "README.md", tmp_path / "one" / "README.md"], []
    mark = '<!-- explorer: {}study.toml {{"scr": 8.0}}{} -->\n\n[![P](p.png)](how.md)\n\nB\n'
    pages[0].write_text("# A\n\n" + mark.format("one/", " Words."), encoding="utf-8")
    pages[1].write_text(mark.format("", ""), encoding="utf-8")

    def make(study: Path, page: Path, state: Mapping[str, Any]) -> str:
        asked.append((study, state))
        page.write_bytes(b"x" * 10**6)
        return "P < Q"

    assert embed_explorers(tmp_path, make) == [tmp_path / "one" / "explorer.html"]
    assert asked == [(tmp_path / "one" / "study.toml", {"scr": 8.0})]  # one for both pages
    text = pages[0].read_text(encoding="utf-8")
    assert text.startswith("---\nhide:")
    assert f'**Live.**</span> Words. <span class="how">{HOW}</span>' in text
    assert '<iframe src="one/explorer.html"' in text
    assert "(1.0 MB" in text
    assert '<img src="one/explorer.png"' in text
    assert "<figcaption>P &lt; Q</figcaption>" in text
    assert text.endswith("</div>\n\n\n[![P](p.png)](how.md)\n\nB\n")  # the picture stays for who cannot simulate
    assert f'**Live.**</span> <span class="how">{HOW}</span>' in pages[1].read_text(encoding="utf-8")
    pages[1].write_text(mark.format("", "").replace("8.0", "9.0"), encoding="utf-8")
    pages[0].write_text(mark.format("one/", ""), encoding="utf-8")
    with pytest.raises(ValueError, match="another state"):
        embed_explorers(tmp_path, make)


@pytest.mark.parametrize(
    ("name", "study", "said"), [("how.md", "s.toml", "only a"), ("README.md", "t.toml", "no study")]
)
def test_an_explorer_that_cannot_be_shown_is_named(name: str, study: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text("", encoding="utf-8")
    (tmp_path / name).write_text(f"<!-- explorer: {study} -->\nP\n", encoding="utf-8")
    with pytest.raises(ValueError, match=said):
        embed_explorers(tmp_path, lambda *_: "")


def test_the_gallery_marks_the_studies_that_are_live() -> None:
    """One picture, one study, one command each; and what is called live has an explorer on its page."""
    rows = re.findall(r"^\| \[!\[.*\((\w+)/README\.md\) \| .*<br>(.*) \|$", GALLERY, re.MULTILINE)
    assert len(rows) == GALLERY.count("\n| [!")
    assert all(re.match(r"`(vsgdesign|python) [^`]+` · [\w ]+", command) for _, command in rows)
    live = {name for name, command in rows if command.endswith("· **live**")}
    pages = {
        page.parent.name: MARK.search(page.read_text(encoding="utf-8")) for page in (ROOT / "studies").glob("*/*.md")
    }
    assert live == {name for name, found in pages.items() if found}
    assert "published" in live


@pytest.mark.parametrize("page", [ROOT / "README.md", *(ROOT / "studies").glob("*/README.md")])
def test_the_state_of_every_explorer_is_one_of_its_study(page: Path) -> None:
    for match in MARK.finditer(page.read_text(encoding="utf-8")):
        shown, state = shown_of(page.parent / match[1], json.loads(match[2] or "{}"))
        session = Session(shown, NOTHING, start=state)
        assert session.start.controllers == tuple(spec.name for spec in shown.controllers)
        assert all(spec.schedule != "table" for spec in shown.controllers)  # nobody designs it while the site is made


def test_every_equation_of_the_theory_would_be_found() -> None:
    for page in sorted((ROOT / "docs" / "theory").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        assert len(EQUATION.findall(text)) == text.count("\n$$\n") / 2, page.name


def test_notes_of_the_tests_do_not_reach_a_reader() -> None:
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    assert NOTE.search(page)
    assert "<!--" not in MARK.sub("", NOTE.sub("", page))


def test_public_modules_are_there() -> None:
    """A misspelt one would be left out of the site in silence."""
    assert [name for _, names in API.values() for name in names if not exists(name)] == []


def test_nothing_is_fetched_when_a_page_is_read() -> None:
    settings = (ROOT / "website" / "mkdocs.yml").read_text(encoding="utf-8")
    assert "font: false" in settings
    assert not re.search(r"https?://", settings)
    assert "polyfills: [iframe-worker.js]" in settings  # or the theme takes one from the internet
    assert not re.search(r"https?://|@import", (Path(ROOT) / "website" / "site.css").read_text(encoding="utf-8"))
