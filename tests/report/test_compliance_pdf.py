"""The clause matrix on paper: made without a browser, with every test, on numbered pages with the table's head."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compliance_documents import document, traces_of
from vsgdesign.report.compliance.arranged import Arranged, arrange
from vsgdesign.report.compliance.page import draw
from vsgdesign.report.compliance.pdf import write_pdf
from vsgdesign.report.drawing import paper
from vsgdesign.report.drawing.paper import HEIGHT, MARGIN, WIDTH, Sheet, text_width, wrapped
from vsgdesign.report.drawing.sketch import END, MIDDLE, Words
from vsgdesign.report.quantities import typeset


@functools.cache
def made() -> dict[str, Any]:
    return document()


@functools.cache
def arranged() -> Arranged:
    return arrange(made())


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> list[Sheet]:
    found: list[Sheet] = []
    keep = pytest.MonkeyPatch()

    def save(sheets: list[Sheet], path: Path, title: str) -> Path:  # noqa: ARG001
        found.extend(sheets)
        return path

    with keep.context() as patch:
        patch.setattr("vsgdesign.report.compliance.pdf.save", save)
        write_pdf(tmp_path_factory.mktemp("pdf") / "r.pdf", made(), arranged(), draw(arranged(), made(), traces()))
    return found


@functools.cache
def traces() -> Any:
    return traces_of(made(), 200)


def words_of(sheet: Sheet) -> list[Words]:
    return [part for part in sheet.parts if isinstance(part, Words)]


def test_no_word_leaves_its_page_and_no_two_lines_of_a_table_overlap(sheets: list[Sheet]) -> None:
    for number, sheet in enumerate(sheets, start=1):
        for one in words_of(sheet):
            if one.upright:
                continue
            width = text_width(one.text, one.size, one.bold)
            left = one.x - {MIDDLE: 0.5 * width, END: width}.get(one.anchor, 0.0)
            assert left >= MARGIN - 1.0, (number, one)
            assert left + width <= WIDTH - MARGIN + 1.0, (number, one)
            assert MARGIN - 8.0 <= one.y <= HEIGHT - MARGIN + 11.0, (number, one)
        places = [(round(one.x, 1), round(one.y, 1)) for one in words_of(sheet)]
        assert len(set(places)) == len(places), number


def test_every_page_has_its_number_and_every_page_of_the_matrix_its_head(sheets: list[Sheet]) -> None:
    for number, sheet in enumerate(sheets, start=1):
        texts = [one.text for one in words_of(sheet)]
        assert f"page {number} of {len(sheets)}" in texts
        if any(test.network in texts for test in arranged().tests()) and number > 1:
            assert "Asked" in texts or "✗" in " ".join(texts) or "t [s]" in texts, number


def test_every_test_and_every_reason_is_there(sheets: list[Sheet]) -> None:
    texts = [one.text for sheet in sheets for one in words_of(sheet)]
    whole = " ".join(texts)
    for test in arranged().tests():
        assert typeset(test.test) in whole
    for word in (
        "⊘ impossible, ",
        "– not applicable, ",
        "1.28 pu of current",
        "Limits of validity",
        "Z_base",
        "Survival maps",
    ):
        assert word in whole, word


def test_the_file_is_a_pdf_with_these_pages_and_the_same_bytes_each_time(tmp_path: Path) -> None:
    few = [Sheet(), Sheet()]
    few[0].text(40.0, 60.0, "✗ Δθ ≥ 60° ⊘ “so”")
    few[1].line((40.0, 60.0), (100.0, 80.0))
    first, second = (paper.save(few, tmp_path / name, "T").read_bytes() for name in ("a.pdf", "b.pdf"))
    assert first == second
    assert first.startswith(b"%PDF")
    assert b"/Count 2" in first
    assert b"Date" not in first


def test_text_is_broken_between_words_and_cut_where_there_is_no_room() -> None:
    text = "one two three four five six seven eight nine ten"
    lines = wrapped(text, 8.0, 60.0)
    assert " ".join(lines) == text
    assert all(text_width(line, 8.0) <= 60.0 for line in lines)
    cut = wrapped(text, 8.0, 60.0, most=2)
    assert len(cut) == 2
    assert cut[-1].endswith(" …")
    assert all(text_width(line, 8.0) <= 60.0 for line in wrapped("x" * 300, 8.0, 60.0))


def test_a_width_is_that_of_matplotlib() -> None:
    from matplotlib.textpath import TextPath

    for text in ("Settling time ≤ 2 s", "not applicable, |H|", "HiillHHH"):
        ink = np.asarray(TextPath((0, 0), text, size=100.0, prop=paper._font(100.0, False)).vertices)[:, 0].max()
        # The advance ends behind the ink of the last letter; kerning, which it leaves out, only makes a text shorter.
        assert 0.0 <= text_width(text, 100.0) - float(ink) <= 15.0
