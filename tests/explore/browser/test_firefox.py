"""A report with its part, and the page that simulates alone, in a second browser, from the file system."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.explore.browser.chromium import Chromium
from tests.explore.browser.conftest import beyond_this_machine
from tests.explore.browser.firefox import Firefox, firefox, program
from tests.explore.browser.test_live_part import HOSTILE, INSIDE, OPENED, report

__all__ = ["report"]  # the fixture

SAG = f"{INSIDE}.page.store.set({{event: {{...{INSIDE}.page.store.state.event, kind: 'sag', size: 0.3}}}})"
PEAK = f"{INSIDE}.page.answers.emt.header.controllers[0].peak_pu"


@pytest.fixture(scope="module")
def second() -> Iterator[Firefox]:
    if program() is None:
        pytest.skip("Firefox is not installed (Debian: apt-get install firefox-esr)")
    with firefox() as running:
        yield running


def test_it_opens_simulates_and_asks_nobody(second: Firefox, browser: Chromium, report: Path) -> None:
    """With the figures of Chromium: both have IEEE 754, and only the sine of the source is their own."""
    page = browser.page()
    peaks = []
    for one in (second, page):
        one.goto(report.as_uri())
        one.wait(OPENED)
        before = one.evaluate(PEAK)
        one.evaluate(SAG)
        one.wait(f"{PEAK} !== {before!r}")
        peaks.append(one.evaluate(PEAK))
        assert one.evaluate(f"{INSIDE}.document.getElementById('title').textContent") == HOSTILE
        assert one.evaluate("[window.done === undefined, document.images.length]") == [True, 0]
    assert peaks[0] == pytest.approx(peaks[1], rel=1e-9)
    assert second.faults == []
    assert [url for url in beyond_this_machine(second.urls) if url != report.as_uri()] == []
    page.close()


def test_where_nothing_can_be_simulated_it_says_so_there_too(second: Firefox, report: Path) -> None:
    path = report.with_name("forbidden.html")
    path.write_text(report.read_text(encoding="utf-8").replace(" 'wasm-unsafe-eval'", "", 1), encoding="utf-8")
    second.goto(path.as_uri())
    second.wait("document.querySelector('.live [role=status]').textContent.includes('WebAssembly')")
    assert second.evaluate("document.querySelector('iframe')") is None
    second.faults.clear()  # the browser names the policy that forbids it
