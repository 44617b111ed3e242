"""The part "Try it" of a report: a page that simulates, packed in the same file and opened in a frame of its own."""

from __future__ import annotations

import base64
import zlib
from typing import NamedTuple

from markupsafe import Markup

from vsgdesign.report.drawing.sketch import filled
from vsgdesign.report.page.blocks import Block, Heading, Live, Span, words
from vsgdesign.report.page.html import text_file

OPENING = "This part opens in a moment."
WITHOUT = (
    "Nothing is simulated here, because this browser does not run WebAssembly or forbids it. The figures of this page "
    "are complete without it."
)
NO_SCRIPTS = "Nothing is simulated here while scripts are off. The figures of this page are complete without it."
ANCHOR = "try-it"
HOW = (
    "Drag the ring on the map to another grid, or choose another event and its size. This page then simulates the "
    "controllers by itself, in your browser: the complete EMT model, sample by sample. It sends nothing and fetches "
    "nothing."
)
LIMITS = (
    "The bridge is averaged, the grid is calm, and the sensors are ideal. A controller that estimates its grid is told "
    "the grid instead. Powers and all other fields stay as they are; vsgdesign explore changes them. vsgdesign "
    "simulate runs the study that “Save as study” writes."
)


class StaticPage(NamedTuple):
    """A page that simulates as text, or why there is none."""

    text: str | None
    why: str = ""
    cases: tuple[str, ...] = ()
    """What the cases of the report are called that it shows. It opens with the first."""


CASES = (
    "It opens with the first case of this report, as it was: with its own grid, instant, estimate and delay, and with "
    "the figures of the report. Choose another case, here or in the table of cases, or move anything to leave it. "
)


def linked_to_case(text: str, page: StaticPage | None, case: str) -> str:
    """A text that leads to a case on the page; the text as it is where the page does not show this case."""
    if page is None or page.text is None or case not in page.cases:
        return text
    return Span(text, link=f"#{ANCHOR}-{page.cases.index(case) + 1}")


def way_to_it(page: StaticPage | None) -> list[Block]:
    """The line near the top of a report that leads to its part."""
    if page is None or page.text is None:
        return []
    return [words((Span("Try it yourself", link=f"#{ANCHOR}", bold=True), ": drag the grid, and see what changes."))]


def try_it(page: StaticPage | None, title: str) -> list[Block]:
    """The part: how to use it, the live page, and what this page cannot do. None: the reader did not want one."""
    if page is None:
        return []
    if page.text is None:
        return [words(f"Nothing can be tried on this page. {page.why}")]
    return [
        Heading("Try it", anchor=ANCHOR),
        _packed(page.text, f"Try it: {title}", (CASES if page.cases else "") + HOW, LIMITS, len(page.cases)),
    ]


def _packed(text: str, title: str, how: str, limits: str, cases: int) -> Live:
    """A whole page as a part of another one. What it shows beside figures is in no other printer.

    The frame keeps ids, styles and scripts apart, and needs no second file. ``title`` is read by screen readers,
    ``how`` and ``limits`` stand above and below the frame, and none of these is on paper. Each of the ``cases`` has an
    anchor, ``try-it-1`` and so on.
    """
    packed = base64.b64encode(zlib.compress(text.encode("utf-8"), 9)).decode("ascii")
    html = (
        '<div class="live" data-title="{}" data-without="{}" data-opening="{}">\n{}<p>{}</p>\n'
        '<noscript><p class="note">{}</p></noscript>\n'
        '<p class="note" role="status" hidden></p>\n<div></div>\n<p class="note">{}</p>\n<template>{}</template>\n'
        "<script>{}</script>\n</div>"
    )
    script = Markup(text_file("live.js"))
    anchors = Markup("").join(filled('<span id="{}-{}"></span>', ANCHOR, k + 1) for k in range(cases))
    return Live(lambda: filled(html, title, WITHOUT, OPENING, anchors, how, NO_SCRIPTS, limits, packed, script))
