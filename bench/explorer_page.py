"""The explorer in a real browser: from a move of the mouse to the redrawn frame, and from the command to the page."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bench.timing import Figure, Row, figure
from tests.explore.browser.chromium import Chromium, chromium, program
from tests.explore.browser.explorer import ExplorerPage, drag_about

STUDY = Path(__file__).resolve().parents[1] / "studies" / "structures" / "study.toml"
"""Three controllers, none of which needs a gain table."""
MOVES = 100
PAUSE_S = 0.09
"""Between two moves of the mouse, so that each is drawn before the next one."""
STARTS = 3


def drags() -> list[Row]:
    """From a move of the mouse on the map to the frame that shows its answer, with the command itself as server."""
    with chromium() as browser, command() as (_, address):
        found = drag(browser, address)
    of_it = "of it on the server"
    return [
        *both("drag to redrawn modes, Bode, margins, linear step", found["linear"], 40.0, 60.0),
        *both(f"{of_it}, linear answer", found["linear, server"], None, None),
        *both("drag to redrawn EMT of 2 s, three controllers", found["emt"], 60.0, 110.0),
        *both(f"{of_it}, EMT", found["emt, server"], None, None),
    ]


def drag(browser: Chromium, address: str) -> dict[str, list[float]]:
    """Milliseconds from each move to what was drawn of it, by kind of answer, and how long the server computed it."""
    opened = ExplorerPage(browser.page(), address)
    page = opened.page
    drag_about(page, MOVES, PAUSE_S)
    opened.settle()
    kinds = ("linear", "emt")
    found = {kind: page.evaluate(f"drawings.{kind}.map((one) => one.after)") for kind in kinds}
    found |= {f"{kind}, server": page.evaluate(f"drawings.{kind}.map((one) => one.server)") for kind in kinds}
    page.mouse("mouseReleased", *page.box("#map").at())
    page.close()
    return found


def starts() -> list[Row]:
    """From the command to the first painted frame and to everything drawn. The browser runs already."""
    painted, drawn = [], []
    with chromium() as browser:
        for _ in range(STARTS + 1):
            with command() as (begin, address):
                page = browser.page()
                ExplorerPage(page, address)
                origin, first, last = page.evaluate(
                    "[performance.timeOrigin, performance.getEntriesByName('first-contentful-paint')[0].startTime,"
                    "Math.max(...['linear', 'emt', 'map'].map((kind) => drawings[kind][0].at))]"
                )
                page.close()
            painted.append((origin + first) / 1e3 - begin)
            drawn.append((origin + last) / 1e3 - begin)
    return [
        Row("explorer_page", "command to first paint, warm caches", figure(painted[1:]), "s", target=0.8),
        Row("explorer_page", "command to everything drawn, warm caches", figure(drawn[1:]), "s", target=2.5),
    ]


@contextmanager
def command() -> Iterator[tuple[float, str]]:
    """A running ``vsgdesign explore``: when it was started (s since the epoch), and the address of its page."""
    arguments = [sys.executable, "-m", "vsgdesign.verbs.cli.program", "explore", str(STUDY), "--no-browser"]
    begin = time.time()
    process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        line = process.stdout.readline() if process.stdout is not None else ""
        yield begin, line.removeprefix("explorer: ").strip()
    finally:
        process.terminate()
        process.wait()


def both(what: str, milliseconds: list[float], median: float | None, p95: float | None) -> list[Row]:
    """Two rows: the median and the 95th percentile."""
    high = float(np.quantile(milliseconds, 0.95))
    tail = Figure(high, min(milliseconds), max(milliseconds), len(milliseconds))
    return [
        Row("explorer_page", f"{what}: median", figure(milliseconds), "ms", target=median),
        Row("explorer_page", f"{what}: 95 %", tail, "ms", target=p95),
    ]


def page() -> list[Row]:
    """Everything of the page."""
    if program() is None:
        print("explorer_page: Chromium is not installed, so that nothing is measured", file=sys.stderr)
        return []
    return [*drags(), *starts()]


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {"explorer_page": page}
