"""Puts the explorer of a study into a page of the web site, in place of its picture."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

MARK = re.compile(r"^<!-- explorer: (\S+) -->\n(\S.*)$", re.MULTILINE)
"""In a page: a study file relative to the page, and under it the picture that stands for its explorer elsewhere."""
WIDE = "---\nhide:\n  - navigation\n  - toc\n---\n"
"""The explorer needs 1000 px for its three columns. The tabs on top still lead everywhere."""


def embed_explorers(folder: Path, make: Callable[[Path, Path], object]) -> list[Path]:
    """Replaces every marked picture under ``folder`` by a frame; returns the explorers that the frames show.

    ``make(study, page)`` writes the explorer of a study file. Raises ValueError where there is no such study, and for a
    page whose address is not that of its folder.
    """
    made: list[Path] = []
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
            made.append(study.with_name("explorer.html"))
            make(study, made[-1])
            return frame_of(made[-1].relative_to(page.parent).as_posix(), made[-1].stat().st_size)

        page.write_text(WIDE + MARK.sub(frame, text), encoding="utf-8")
    return made


def frame_of(address: str, size: int) -> str:
    """The frame, and a link to the explorer on a page of its own."""
    return (
        f'<div class="explorer"><iframe src="{address}" title="Explorer" loading="lazy"></iframe>\n'
        f'<p><a href="{address}">Open it on a page of its own</a> '
        f"({size / 1e6:.1f} MB, one file without server).</p></div>"
    )


def write_explorer(study: Path, page: Path) -> None:
    """Writes the explorer of a study that needs no gain table."""
    from vsgdesign.artifacts.ready import NOTHING
    from vsgdesign.report.explore.session import Session
    from vsgdesign.report.explore.static import LATTICES, write_static
    from vsgdesign.study.parameters import load_study

    write_static(Session(load_study(study), NOTHING), page, lattices=LATTICES[2:])
