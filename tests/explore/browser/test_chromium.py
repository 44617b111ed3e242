"""The browser does what the tests of the page rely on: real events, and no way out of this machine."""

from __future__ import annotations

from tests.explore.browser.chromium import Chromium
from tests.explore.browser.conftest import beyond_this_machine

PAGE = """data:text/html,<input id=a><button onclick='trusted = event.isTrusted; console.error(7)'>b</button>
<img src=https://example.org/x.png>"""


def test_events_are_those_of_a_user_and_requests_stay_here(browser: Chromium) -> None:
    page = browser.page()
    page.goto(PAGE)
    page.wait("document.querySelector('#a')")
    page.type("#a", "0.05 s")
    page.key("Tab")
    page.key("Enter")
    assert page.evaluate("[document.querySelector('#a').value, trusted]") == ["0.05 s", True]
    page.wait("performance.getEntriesByType('resource').length || document.images[0].complete")
    assert beyond_this_machine(page.urls) == ["https://example.org/x.png"]
    assert sorted(fault[:30] for fault in page.faults) == ["7", "Failed to load resource: net::"]
    page.close()
