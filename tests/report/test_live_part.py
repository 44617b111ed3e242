"""The part of a report that simulates: packed in the file, so that nothing in it is markup of the report."""

from __future__ import annotations

import base64
import html
import re
import zlib

from tests.report.test_page import checked_text
from vsgdesign.report.page.blocks import Live, Page
from vsgdesign.report.page.html import POLICY, print_html
from vsgdesign.report.page.live import StaticPage, try_it, way_to_it
from vsgdesign.report.page.terminal import print_terminal

HOSTILE = """</template></script><script>window.done = 1</script>" onload='x' <!-- {} é"""


def test_a_hostile_page_and_title_are_no_markup(tmp_path) -> None:
    path = tmp_path / "report.html"
    print_html(Page("A report", try_it(StaticPage(HOSTILE), HOSTILE)), path)
    text = path.read_text(encoding="utf-8")
    found = checked_text(text)
    assert found.faults == []
    assert found.open == []
    assert text.count("<script") == 1
    assert "window.done" not in text.replace("&lt;script&gt;window.done", "")
    packed = re.search(r"<template>([\w+/=]*)</template>", text)
    assert packed is not None
    assert zlib.decompress(base64.b64decode(packed[1])).decode() == HOSTILE
    title = re.search(r'data-title="([^"]*)"', text)
    assert title is not None
    assert html.unescape(title[1]) == f"Try it: {HOSTILE}"


def test_the_same_bytes_when_made_twice(tmp_path) -> None:
    for name in ("a", "b"):
        print_html(Page("A report", try_it(StaticPage("x" * 1000), "t")), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_report_asks_nobody() -> None:
    assert "'wasm-unsafe-eval'" in POLICY
    assert " 'unsafe-eval'" not in POLICY
    assert "http" not in POLICY


def test_why_there_is_none_is_said_and_who_wants_none_gets_nothing() -> None:
    (said,) = try_it(StaticPage(None, "P must be smaller."), "t")
    assert "P must be smaller." in str(said)
    assert not way_to_it(StaticPage(None, "P must be smaller."))
    assert not try_it(None, "t")
    assert not way_to_it(None)


def test_other_printers_print_the_figures_beside_it(capsys) -> None:
    blocks = [block for block in try_it(StaticPage("page"), "t") if isinstance(block, Live)]
    assert len(blocks) == 1
    print_terminal(blocks)
    assert capsys.readouterr().out == ""
