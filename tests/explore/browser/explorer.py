"""The explorer's page in a browser and what a user does there, for tests, benchmarks and screenshots."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

from tests.explore.browser.chromium import Page
from vsgdesign.explore.server import ExplorerServer, Opening
from vsgdesign.explore.session import Session

KINDS = ("linear", "emt", "map")


@dataclass(frozen=True)
class Explorer:
    """A running explorer of one study, in this process."""

    address: str
    session: Session
    complaints: list[str]
    """Tracebacks of answers that failed."""

    def link(self, changes: Mapping[str, Any]) -> str:
        """The address of the page with a state: the keys that differ from those of the study."""
        return self.address + ("#" + quote(json.dumps(dict(changes))) if changes else "")


@contextmanager
def explorer_of(path: Path) -> Iterator[Explorer]:
    """An explorer of a study file whose controllers need no gain table."""
    from vsgdesign.artifacts.ready import Ready
    from vsgdesign.parameters import load_study

    opening, complaints = Opening(), []
    server = ExplorerServer(opening, complain=complaints.append)
    server.begin()
    try:
        session = Session(load_study(path), Ready())
        opening.open(session)
        yield Explorer(server.gate.address, session, complaints)
    finally:
        server.end()


class ExplorerPage:
    """A page of the explorer, open."""

    def __init__(self, page: Page, address: str) -> None:
        self.page = page
        # Drawings are counted by the page's own event, from before its scripts begin.
        page.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTER)
        page.goto(address)
        page.wait("document.documentElement.dataset.state === 'ready'", 20.0)
        self.settle()

    def settle(self, timeout_s: float = 15.0) -> None:
        """Wait until everything is drawn once and nothing is drawn any more."""
        self.page.wait(f"window.drawings && {json.dumps(KINDS)}.every((kind) => drawings[kind].length)", timeout_s)
        self.page.wait("performance.now() - drawings.last > 150", timeout_s)

    def drawn(self, kind: str) -> int:
        """How often a kind of answer has been drawn."""
        return self.page.evaluate(f"drawings.{kind}.length")

    def changes(self) -> dict[str, Any]:
        """The state in the link: what differs from the study."""
        return json.loads(unquote(self.page.evaluate("location.hash")[1:]) or "{}")


COUNTER = """
window.drawings = {linear: [], emt: [], map: [], last: 0};
document.addEventListener("drawn", ({detail}) => {
  (drawings[detail.kind] ||= []).push({...detail, at: performance.now()});
  drawings.last = performance.now();
});
"""
