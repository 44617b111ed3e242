"""The part "Try it" of a report, opened from the file system."""

from __future__ import annotations

import base64
import json
import re
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.explore.browser.chromium import Chromium, Page
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.report.explore.page_file import page_of_session
from vsgdesign.report.explore.page_runs import WORDS
from vsgdesign.report.explore.session import Session
from vsgdesign.report.page.blocks import Page as Report
from vsgdesign.report.page.html import print_html
from vsgdesign.report.page.live import NO_SCRIPTS, WITHOUT, StaticPage, try_it
from vsgdesign.study.parameters import study_from_text

HOSTILE = """</script><script>parent.done = 1</script><img src=x onerror='parent.done = 1'>&<b>"""
STUDY = f"""
base = "case:hoang2025_5kva"
study = {{ title = {json.dumps(HOSTILE)} }}
grid = {{ scr = 4, x_over_r = 1 }}
simulation = {{ duration = "0.3 s", P_ref = "2 kW", Q_ref = "1 kvar" }}
[[controllers]]
name = "fixed"
kind = "fixed"
"""
INSIDE = "document.querySelector('.live iframe')?.contentWindow"
OPENED = f"{INSIDE}?.page?.answers.emt && {INSIDE}.page.answers.map"
SAID = "document.querySelector('.live [role=status]').textContent"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    study = study_from_text(STUDY)
    text = page_of_session(Session(study, NOTHING), (2, 1))
    return print_html(
        Report(study.title, try_it(StaticPage(text), study.title)), tmp_path_factory.mktemp("report") / "report.html"
    )


@pytest.fixture
def opened(browser: Chromium, report: Path) -> Callable[..., Page]:
    def go(width: int = 1280, *, path: Path = report) -> Page:
        page = browser.page(width, 800)
        page.goto(path.as_uri())
        return page

    return go


def test_it_simulates_and_no_name_is_markup(opened: Callable[..., Page], report: Path) -> None:
    page = opened()
    page.wait(OPENED)
    page.evaluate(f"{INSIDE}.page.store.set({{event: {{...{INSIDE}.page.store.state.event, kind: 'sag', size: 0.3}}}})")
    page.wait(f"{INSIDE}.page.answers.emt.header.controllers[0].limited_s !== null")
    assert page.evaluate(f"{INSIDE}.document.getElementById('title').textContent") == HOSTILE
    assert page.evaluate(f"[window.done === undefined, document.images.length, {INSIDE}.document.images.length]") == [
        True, 0, 0,
    ]  # fmt: skip
    assert page.evaluate(f"{INSIDE}.document.getElementById('link').hidden")  # it has no address
    assert page.evaluate("document.querySelector('.live iframe').title") == f"Try it: {HOSTILE}"
    assert [
        url for url in page.urls if url != report.as_uri() and not url.startswith(("data:", "blob:", "about:"))
    ] == []
    assert list(page.faults) == []
    page.call("Emulation.setEmulatedMedia", media="print")
    assert page.evaluate("getComputedStyle(document.querySelector('.live')).display") == "none"
    page.close()


def test_on_a_phone_the_frame_is_as_high_as_what_it_shows(opened: Callable[..., Page]) -> None:
    """Before: it scrolled within the page, and the map took what the frame got."""
    page = opened(390)
    page.wait(OPENED)
    page.wait(f"document.querySelector('.live iframe').clientHeight >= {INSIDE}.document.body.scrollHeight - 1")
    assert page.evaluate(f"{INSIDE}.document.getElementById('map-box').clientHeight") == 300
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    page.close()


def test_where_nothing_can_be_simulated_one_sentence_says_so(opened: Callable[..., Page], report: Path) -> None:
    """A policy of the site may forbid WebAssembly."""
    path = report.with_name("forbidden.html")
    path.write_text(report.read_text(encoding="utf-8").replace(" 'wasm-unsafe-eval'", "", 1), encoding="utf-8")
    page = opened(path=path)
    page.wait(SAID)
    assert page.evaluate(SAID) == WITHOUT
    assert page.evaluate("document.querySelector('iframe')") is None
    page.close()


def test_alone_it_says_so_too(opened: Callable[..., Page], report: Path) -> None:
    packed = re.search(r"<template>([^<]*)</template>", report.read_text(encoding="utf-8"))
    assert packed is not None
    text = zlib.decompress(base64.b64decode(packed[1])).decode()
    path = report.with_name("alone.html")
    path.write_text(text.replace(" 'wasm-unsafe-eval'", "", 1), encoding="utf-8")
    page = opened(path=path)
    page.wait("document.getElementById('notice').textContent")
    assert page.evaluate("document.getElementById('notice').textContent") == WORDS["no_wasm"]
    page.wait("page.answers.map")
    page.close()


def test_where_scripts_are_off_one_sentence_says_so(browser: Chromium, report: Path) -> None:
    page = browser.page()
    page.call("Emulation.setScriptExecutionDisabled", value=True)
    page.goto(report.as_uri())
    until = time.monotonic() + 40.0  # a script that waits would be off, too
    while page.evaluate("document.readyState") != "complete":
        assert time.monotonic() < until
    assert page.evaluate("document.querySelector('.live noscript').innerText") == NO_SCRIPTS
    assert page.evaluate("document.querySelector('iframe')") is None
    page.close()
