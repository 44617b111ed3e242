"""Docstrings, theory pages and links agree: a cited equation exists, an equation is cited, a link leads somewhere."""

from __future__ import annotations

import functools
import re
import tomllib
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
THEORY = sorted((ROOT / "docs" / "theory").glob("*.md"))
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "studies").rglob("*.md"))]
PAGES += [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "bench/README.md")]
INDEX = ROOT / "docs" / "README.md"

CITATION = re.compile(r":eq:`([^`]+)`")
ANCHOR = re.compile(r'<a id="([^"]+)"></a>')
EQUATION = re.compile(r'^<a id="eq-([a-z0-9-]+)"></a>\n\n?\$\$\n(.*?)\n\$\$$', re.MULTILINE | re.DOTALL)
DISPLAY = re.compile(r"^\$\$\n(.*?)\n\$\$$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(?<!!)\[(?:[^\[\]]|\[[^\[\]]*\])*\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


@functools.cache
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@functools.cache
def _cited() -> dict[str, list[str]]:
    cited: dict[str, list[str]] = {}
    for path in sorted((ROOT / "vsgdesign").rglob("*.py")):
        for label in CITATION.findall(_text(path)):
            cited.setdefault(label, []).append(str(path.relative_to(ROOT)))
    return cited


@functools.cache
def _defined() -> dict[str, Path]:
    return {label: path for path in THEORY for label, _ in EQUATION.findall(_text(path))}


def _prose(path: Path) -> str:
    """A page's text without code: a link in an example is no link."""
    return re.sub(r"`[^`\n]*`", "", FENCE.sub("", _text(path)))


def _slug(heading: str) -> str:
    """The anchor that GitHub gives a heading."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")


@functools.cache
def _anchors(path: Path) -> set[str]:
    text = FENCE.sub("", _text(path))
    slugs: Counter[str] = Counter()
    found = set(ANCHOR.findall(text))
    for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE):
        slug = _slug(heading)
        found.add(f"{slug}-{slugs[slug]}" if slugs[slug] else slug)
        slugs[slug] += 1
    return found


def test_every_cited_equation_exists() -> None:
    missing = {label: where for label, where in _cited().items() if label not in _defined()}
    assert not missing, f"cited in docstrings, not in docs/theory: {missing}"


def test_every_label_is_defined_once_and_is_its_own_tag() -> None:
    anchors: Counter[str] = Counter()
    wrong: list[str] = []
    for path in THEORY:
        text = _text(path)
        here = [anchor for anchor in ANCHOR.findall(text) if anchor.startswith("eq-")]
        anchors.update(here)
        equations = dict(EQUATION.findall(text))
        wrong += [f"{path.name}: {a} is not directly above a $$ block" for a in here if a[3:] not in equations]
        for label, body in equations.items():
            if re.findall(r"\\tag\{([^}]*)\}", body) != [label]:
                wrong.append(f"{path.name}: the block of eq-{label} must carry \\tag{{{label}}} and no other tag")
    wrong += [f"{anchor} is defined {count} times" for anchor, count in anchors.items() if count > 1]
    assert not wrong, wrong


def test_every_equation_is_cited() -> None:
    """By a docstring or by another page. The index lists all of them and does not count."""
    cited = set(_cited())
    uncited = []
    for label, home in _defined().items():
        others = (page for page in PAGES if page not in (home, INDEX) and page.exists())
        if label not in cited and not any(f"#eq-{label})" in _text(page) for page in others):
            uncited.append(label)
    assert not uncited, f"in docs/theory, cited by no docstring and no other page: {uncited}"


def test_index_lists_every_equation() -> None:
    index = _text(INDEX)
    listed = Counter(re.findall(r"^\| \[([a-z0-9-]+)\]\(theory/\S+#eq-\1\) \|", index, re.MULTILINE))
    assert listed == Counter(_defined().keys())


def test_display_equations_survive_markdown() -> None:
    """A line of a $$ block that begins like a list, heading, quote or rule would end the block on GitHub."""
    broken = [
        f"{path.name}: {line}"
        for path in THEORY
        for body in DISPLAY.findall(_text(path))
        for line in body.splitlines()
        if not line.strip() or re.match(r"\s*([-+*#>=]|\d+[.)] )", line)
    ]
    assert not broken, broken


@pytest.mark.parametrize("page", [p for p in PAGES if p.exists()], ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    dead = []
    for target in LINK.findall(_prose(page)):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        path = (page.parent / file).resolve() if file else page
        if not path.is_relative_to(ROOT) or not path.exists():
            dead.append(f"{target}: no such file")
        elif anchor and path.suffix == ".md" and anchor not in _anchors(path):
            dead.append(f"{target}: no such anchor")
    assert not dead, dead


def test_rooms_of_the_guide_are_those_of_the_contract() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    guide = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert "\n```\n" + "\n".join(layers) + "\n```\n" in guide
