"""One browser and one explorer for all tests of the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.explore.browser.chromium import Chromium, Page, chromium, program
from tests.explore.browser.explorer import Explorer, ExplorerPage, explorer_of

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def browser() -> Iterator[Chromium]:
    if program() is None:
        pytest.skip("Chromium is not installed (Debian: apt-get install chromium)")
    with chromium() as running:
        yield running


@pytest.fixture(scope="session")
def explorer() -> Iterator[Explorer]:
    """Three controllers of the published converter, none of which needs a table."""
    with explorer_of(ROOT / "studies" / "structures" / "study.toml") as running:
        yield running


@pytest.fixture
def new_page(browser: Chromium) -> Iterator[Callable[..., Page]]:
    """Makes empty pages. At the end none of them has complained, or has asked for anything beyond this machine."""
    made: list[Page] = []

    def make(width: int = 1280, height: int = 800, *, dark: bool = False) -> Page:
        made.append(browser.page(width, height, dark=dark))
        return made[-1]

    yield make
    for page in made:
        page.close()
    for page in made:
        content(page)


@pytest.fixture(scope="session")
def kept(browser: Chromium, explorer: Explorer) -> ExplorerPage:
    return ExplorerPage(browser.page(), explorer.address)


@pytest.fixture
def opened(kept: ExplorerPage, explorer: Explorer) -> Iterator[ExplorerPage]:
    """The page as it opens with the study's own state, in a tab that all tests share: a new one takes half a second."""
    kept.open(explorer.address)
    yield kept
    content(kept.page)


def content(page: Page) -> None:
    """The page has not complained, and has asked nobody but this machine."""
    faults, urls = [*page.faults], [*page.urls]
    page.faults.clear()
    page.urls.clear()
    assert not faults, faults
    assert not beyond_this_machine(urls)


def beyond_this_machine(urls: list[str]) -> list[str]:
    """The addresses that lead to another machine."""
    inside = ("127.0.0.1", "localhost")
    split = [(url, urlsplit(url)) for url in urls]
    return [url for url, at in split if at.scheme not in ("data", "blob", "about") and at.hostname not in inside]
