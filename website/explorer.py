"""Puts the page that simulates a study into pages of the web site."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from website.still import draw_still

if TYPE_CHECKING:
    from vsgdesign.study.parameters import Study

MARK = re.compile(r"^<!-- explorer: (\S+)(?: (\{.*\}))?(?: ([^{].*))? -->$", re.MULTILINE)
"""In a page: a study file relative to the page, the state with which its explorer begins, as in the part of a link
behind #, and words above it. Of a study with more controllers than this state names, the explorer has these alone."""
HOW = "Drag the ring on the map to another grid, or choose another event: your browser simulates."
WIDE = "---\nhide:\n  - navigation\n  - toc\n---\n"
"""The explorer needs 1000 px for its three columns. The tabs on top still lead everywhere."""

Make = Callable[[Path, Path, Mapping[str, Any]], str]


def embed_explorers(folder: Path, make: Make) -> list[Path]:
    """Puts a frame in the place of every mark under ``folder``; returns the explorers that the frames show.

    ``make(study, page, state)`` writes the explorer of a study file, and beside it as PNG what it opens with; it
    returns this in words. The picture is shown in print and where scripts are off. Raises ValueError where there is no
    such study, and for a page whose address is not that of its folder.
    """
    made: dict[Path, tuple[Path, Mapping[str, Any]]] = {}
    said: dict[Path, str] = {}
    for page in sorted(folder.rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        if not MARK.search(text):
            continue
        if page.name != "README.md":
            raise ValueError(f"{page.relative_to(folder)}: only a README.md can show an explorer")

        def frame(match: re.Match[str], page: Path = page) -> str:
            study = page.parent / match[1]
            if not study.is_file():
                raise ValueError(f"{page.relative_to(folder)}: there is no study {match[1]}")
            explorer, asked = study.with_name("explorer.html"), (study, json.loads(match[2] or "{}"))
            if made.setdefault(explorer, asked) != asked:
                raise ValueError(f"{page.relative_to(folder)}: {match[1]} has an explorer with another state")
            if explorer not in said:
                said[explorer] = make(study, explorer, asked[1])
            address = explorer.relative_to(page.parent).as_posix()
            return frame_of(address, explorer.stat().st_size, said[explorer], match[3] or "")

        page.write_text(WIDE + MARK.sub(frame, text), encoding="utf-8")
    return list(made)


def frame_of(address: str, size: int, still: str, words: str = "") -> str:
    """The frame with words above it, a link to the explorer on a page of its own, and the still figure that may stand
    in its place, with its words."""
    picture = f"{address.removesuffix('.html')}.png"
    return (
        f'<span class="how">**Live.**</span> {f"{words} " if words else ""}<span class="how">{HOW}</span>\n\n'
        f'<div class="explorer"><iframe src="{address}" title="Explorer" loading="lazy"></iframe>\n'
        f'<p><a href="{address}">Open it on a page of its own</a> '
        f"({size / 1e6:.1f} MB, one file without server).</p>\n"
        f'<figure class="still"><img src="{picture}" alt="What the explorer opens with">'
        f"<figcaption>{escape(still)}</figcaption></figure></div>\n"
    )


def shown_of(study: Path, state: Mapping[str, Any]) -> tuple[Study, dict[str, Any]]:
    """A study with the controllers of a state alone, and the state with which its explorer begins."""
    from vsgdesign.report.explore.state import defaults
    from vsgdesign.study.parameters import load_study

    found = load_study(study)
    names = state.get("controllers", [spec.name for spec in found.controllers])
    shown = replace(found, controllers=tuple(spec for spec in found.controllers if spec.name in names))
    return shown, defaults(shown) | dict(state)


def write_explorer(study: Path, page: Path, state: Mapping[str, Any]) -> str:
    """Writes the explorer of a study whose shown controllers need no gain table, and its still figure. Returns what
    this shows."""
    from vsgdesign.artifacts.ready import NOTHING
    from vsgdesign.report.explore.page_file import write_page
    from vsgdesign.report.explore.session import Session

    shown, start = shown_of(study, state)
    session = Session(shown, NOTHING, start=start)
    write_page(session, page, lattice=(24, 16))
    return draw_still(session, page.with_suffix(".png"))
