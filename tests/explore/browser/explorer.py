"""The explorer's page in a browser and what a user does there, for tests, benchmarks and screenshots."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, unquote

import numpy as np

from tests.explore.browser.chromium import Page
from vsgdesign.artifacts.ready import Ready
from vsgdesign.report.explore.server import ExplorerServer, Opening
from vsgdesign.report.explore.session import Session, never
from vsgdesign.report.explore.wire import Answer
from vsgdesign.study.parameters import load_study

KINDS = ("linear", "emt", "map")
COUNTER = """
window.moved = 0;
window.drawings = {linear: [], modes: [], emt: [], map: [], last: 0};
document.addEventListener("pointermove", (event) => { window.moved = event.timeStamp; }, true);
document.addEventListener("drawn", ({detail}) => {
  drawings.last = performance.now();
  drawings[detail.kind].push({...detail, at: drawings.last, after: Math.max(detail.ms, drawings.last - window.moved)});
});
"""
"""Before the page's own scripts: counts the drawings, and times them from the browser's own time of the last move, or
from the page's wish where that is earlier: an answer may be drawn after the next move."""
SETTLED = """(() => {
  const {transport, answers} = window.page;
  const last = (kind) => (drawings[kind].length ? drawings[kind].at(-1).seq : 0);
  return !answers.emt?.header.again &&
    Object.entries(transport.kinds).every(([kind, one]) => !one.busy && !one.wish && last(kind) >= one.shown);
})()"""
TABLE = """(() => {
  const words = (cell) => [...cell.childNodes].map((node) => node.textContent.trim()).filter(Boolean).join(" ");
  const [first, second] = document.querySelectorAll("#table thead tr");
  const [names, rest] = [[], [...second.children]];
  for (const head of [...first.children].slice(1)) {
    if (head.rowSpan === 2) names.push(words(head));
    else for (let k = 0; k < head.colSpan; k++) names.push(`${words(head)}: ${words(rest.shift())}`);
  }
  return Object.fromEntries([...document.querySelectorAll("#table tbody")].map(({rows: [numbers, said]}) => {
    const [name, ...cells] = numbers.children;
    const figures = Object.fromEntries(cells.map((cell, k) => [names[k], words(cell)]));
    return [words(name), {Status: said.textContent.trim(), ...figures}];
  }));
})()"""

SAID = """Object.fromEntries([...document.querySelectorAll("#table tbody")].map(({rows: [numbers, said]}) =>
  [numbers.children[0].textContent.trim(), said.textContent.trim()]))"""


def drag_about(page: Page, moves: int, pause_s: float, *, empty: str = "drawings.linear, drawings.emt") -> None:
    """Takes the dot of the map to so many random places, the same ones in every call, and holds it at the last. Of five
    moves before these the times are forgotten: the page's lists in ``empty`` lose what they have."""
    box, rng = page.box("#map"), np.random.default_rng(11)
    page.mouse("mouseMoved", *box.at())
    page.mouse("mousePressed", *box.at(), 1)
    for k in range(-5, moves):
        if k == 0:
            page.evaluate(f"[{empty}].forEach((list) => {{ list.length = 0; }})")
        page.mouse("mouseMoved", *box.at(float(rng.uniform(0.15, 0.95)), float(rng.uniform(0.08, 0.8))), 1)
        time.sleep(pause_s)


def columns_of(row: Mapping[str, str], group: str) -> dict[str, str]:
    """The columns of one group of the table."""
    return {name: text for name, text in row.items() if name.startswith(f"{group}: ")}


@dataclass(frozen=True)
class Explorer:
    """A running explorer of one study, in this process."""

    address: str
    session: Session
    complaints: list[str]
    """Tracebacks of answers that failed."""
    server: ExplorerServer

    def link(self, **changes: Any) -> str:
        """The address of the page with a state: the keys that differ from those of the study."""
        return self.address + ("#" + quote(json.dumps(changes)) if changes else "")

    def state(self, **changes: Any) -> dict[str, Any]:
        """The whole state with some keys changed."""
        return {**self.session.info()["defaults"], **changes}

    def header(self, kind: str, state: Mapping[str, Any]) -> dict[str, Any]:
        """The figures and words of an answer."""
        answer = self.session.answer(kind, state, lambda: False)
        if answer is None:
            raise RuntimeError(f"no {kind} answer")
        return dict(answer.header)


class KeptAnswers(Session):
    """A session that answers a question which it was asked before from memory: most tests begin with one state, and
    compare what the page shows with the same answers."""

    def answer(self, kind: str, document: Any, stale: Callable[[], bool] = never) -> Answer | None:
        key = json.dumps([kind, document], sort_keys=True)
        kept = self.__dict__.setdefault("kept", {})
        if key not in kept:
            found = super().answer(kind, document, stale)
            if found is None:
                return None
            kept[key] = found
        return kept[key]


@contextmanager
def explorer_of(path: Path) -> Iterator[Explorer]:
    """An explorer of a study file whose controllers need no gain table."""
    opening, complaints = Opening(), []
    server = ExplorerServer(opening, complain=complaints.append)
    server.begin()
    try:
        session = KeptAnswers(load_study(path), Ready())
        opening.open(session)
        yield Explorer(server.gate.address, session, complaints, server)
    finally:
        server.end()


class Place(NamedTuple):
    """A point of the window and the grid that the map has there."""

    point: tuple[float, float]
    scr: float
    x_over_r: float


class ExplorerPage:
    """A page of the explorer, with everything drawn."""

    MARGINS = (44.0, 10.0, 6.0, 36.0)
    """Of the map's axes in its canvas: left, right, top, bottom (page/map.js)."""

    def __init__(self, page: Page, address: str, timeout_s: float = 40.0) -> None:
        self.page = page
        page.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTER)
        self.open(address, timeout_s)

    def open(self, address: str, timeout_s: float = 40.0) -> None:
        """Go to an address, and wait until everything is drawn."""
        page = self.page
        if page.evaluate("location.href").split("#")[0] == address.split("#")[0]:
            page.goto("about:blank")  # or the page would stay, and take the address as a link that was pasted
        page.goto(address)
        page.wait("document.documentElement.dataset.state === 'ready'", timeout_s)
        page.wait(f"{json.dumps(KINDS)}.every((kind) => drawings[kind].length)", timeout_s)
        self.settle()
        self.axes = page.evaluate("fetch('study').then((reply) => reply.json()).then((info) => info.map)")

    def settle(self) -> None:
        """Wait until no question is under way, and the last answer of every kind is on the screen."""
        self.page.wait(SETTLED)

    def counts(self) -> dict[str, int]:
        """How often each kind of answer has been drawn."""
        return {kind: self.page.evaluate(f"drawings.{kind}.length") for kind in KINDS}

    def redrawn(self, before: Mapping[str, int], *kinds: str) -> None:
        """Wait until kinds of answers have been drawn once more."""
        for kind in kinds:
            self.page.wait(f"drawings.{kind}.length > {before[kind]}")
        self.settle()

    def changes(self) -> dict[str, Any]:
        """The state in the address: what differs from the study."""
        return json.loads(unquote(self.page.evaluate("location.hash")[1:]) or "{}")

    def text(self, selector: str) -> str:
        """The text of an element, without the spaces around it."""
        return self.page.evaluate(f"document.querySelector({json.dumps(selector)}).innerText.trim()")

    def place(self, across: float, up: float) -> Place:
        """A point of the map, from 0 at its left or lower end to 1, and the grid that its logarithmic axes give it."""
        left, right, top, bottom = self.MARGINS
        box = self.page.still("#map")
        width, height = box.width - left - right, box.height - top - bottom
        scr, ratio = (
            math.exp((1.0 - share) * math.log(self.axes[name][0]) + share * math.log(self.axes[name][1]))
            for name, share in (("scr", across), ("x_over_r", up))
        )
        return Place((box.x + left + across * width, box.y + top + (1.0 - up) * height), scr, ratio)

    def table(self) -> dict[str, dict[str, str]]:
        """The table of controllers: by name the text of every column, which is named by its group, title and unit."""
        return self.page.evaluate(TABLE)

    def said(self) -> dict[str, str]:
        """What the table says in words of each controller."""
        return self.page.evaluate(SAID)

    def gains(self) -> dict[str, dict[str, str]]:
        """The gains in force as the table shows them, by controller."""
        return {name: columns_of(row, "Gains in force") for name, row in self.table().items()}

    def field(self, path: str) -> str:
        """The selector of a field."""
        return f"[data-path='{path}']"
