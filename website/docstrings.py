"""What the API pages do with a docstring: ``:eq:`label``` becomes a link to the equation, other roles become code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import griffe

THEORY = Path(__file__).resolve().parents[1] / "docs" / "theory"
LINK = re.compile(r"\]\((?=#|[\w/-]+\.md)(?P<page>[\w/-]+\.md)?")
"""A link of a field's docstring: from docs/study-file.md, whose tables have it."""
ROLE = re.compile(r":(eq|func|class|mod|meth|attr|data|doc|exc|const|py:\w+):`~?([^`]+)`")


def equation_pages() -> dict[str, str]:
    """The page of every labelled equation."""
    pages = {}
    for path in sorted(THEORY.glob("*.md")):
        for label in re.findall(r'<a id="eq-([a-z0-9-]+)"></a>', path.read_text(encoding="utf-8")):
            pages[label] = path.name
    return pages


def as_markdown(text: str, pages: dict[str, str]) -> str:
    """A docstring in the project's style as Markdown of a page in ``api/``."""

    def replaced(match: re.Match[str]) -> str:
        kind, name = match.groups()
        if kind == "eq" and name in pages:
            return f"[{name}](../docs/theory/{pages[name]}#eq-{name})"
        return f"`{name.removeprefix('vsgdesign.')}`"

    text = LINK.sub(lambda match: f"](../docs/{match['page'] or 'study-file.md'}", text)
    return ROLE.sub(replaced, text).replace("``", "`")


class Roles(griffe.Extension):
    """Turns the roles of every docstring into Markdown."""

    def __init__(self) -> None:
        self.pages = equation_pages()

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called by griffe for every module, class, function and attribute."""
        if obj.docstring is not None:
            obj.docstring.value = as_markdown(obj.docstring.value, self.pages)
