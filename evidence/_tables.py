"""What every measurement leaves: tables in Markdown, printed and kept beside the figures as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table."""
    return [line(cells) for cells in (head, ["---"] * len(head), *rows)]


def line(cells: Sequence[str]) -> str:
    """One row of a table."""
    return f"| {' | '.join(cells)} |"


def leave(folder: Path, name: str, document: Any, lines: Sequence[str] = ()) -> None:
    """Writes the figures to NAME.json, and prints the lines and writes them to NAME.md."""
    (folder / f"{name}.json").write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if lines:
        text = "\n".join(lines) + "\n"
        (folder / f"{name}.md").write_text(text, encoding="utf-8")
        print(text)
