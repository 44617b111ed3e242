"""The clause matrix on paper: made without a browser, with every test, on numbered pages with the table's head."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

from tests.compliance_documents import document, traces_of
from tests.report.pdf_texts import maps_of, objects_of, texts_of
from vsgdesign.report.compliance.arranged import Arranged, arrange
from vsgdesign.report.compliance.figures import draw
from vsgdesign.report.compliance.page import compliance_page
from vsgdesign.report.drawing import paper
from vsgdesign.report.drawing.paper import HEIGHT, MARGIN, WIDTH, Sheet, text_width, wrapped
from vsgdesign.report.drawing.quantities import typeset
from vsgdesign.report.drawing.sketch import END, MIDDLE, Words
from vsgdesign.report.page.blocks import Page, Table
from vsgdesign.report.page.pdf import print_pdf


@functools.cache
def made() -> dict[str, Any]:
    return document()


@functools.cache
def arranged() -> Arranged:
    return arrange(made())


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> list[Sheet]:
    page = compliance_page(made(), arranged(), draw(arranged(), made(), traces()))
    return sheets_of(page, tmp_path_factory.mktemp("pdf") / "r.pdf", wide=True)


def sheets_of(page: Page, path: Path, wide: bool) -> list[Sheet]:
    """The sheets that a page is printed on, in place of a file."""
    found: list[Sheet] = []

    def save(sheets: list[Sheet], path: Path, title: str) -> Path:  # noqa: ARG001
        found.extend(sheets)
        return path

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vsgdesign.report.page.pdf.save", save)
        print_pdf(page, path, wide=wide)
    return found


@functools.cache
def traces() -> Any:
    return traces_of(made(), 200)


def words_of(sheet: Sheet) -> list[Words]:
    return [part for part in sheet.parts if isinstance(part, Words)]


def edges_of(one: Words) -> tuple[float, float]:
    """Where words begin and end, pt."""
    width = text_width(one.text, one.size, one.bold)
    left = one.x - {MIDDLE: 0.5 * width, END: width}.get(one.anchor, 0.0)
    return left, left + width


def test_no_word_leaves_its_page_and_no_two_lines_of_a_table_overlap(sheets: list[Sheet]) -> None:
    for number, sheet in enumerate(sheets, start=1):
        for one in words_of(sheet):
            if one.upright:
                continue
            left, right = edges_of(one)
            assert left >= MARGIN - 1.0, (number, one)
            assert right <= WIDTH - MARGIN + 1.0, (number, one)
            assert MARGIN - 8.0 <= one.y <= HEIGHT - MARGIN + 11.0, (number, one)
        places = [(round(one.x, 1), round(one.y, 1)) for one in words_of(sheet)]
        assert len(set(places)) == len(places), number


def test_long_words_above_the_columns_of_a_table_push_none_of_them_off_the_page(tmp_path: Path) -> None:
    """Fourteen columns fill the page, and the words above pairs of them need more room than there is."""
    head, rows = tuple(f"Column {k}" for k in range(14)), tuple(("SCR 1.8 in it",) * 14 for _ in range(3))
    groups = tuple((f"Disk margin at the output, guaranteed {k}", 2) for k in range(7))
    (sheet,) = sheets_of(Page("Title", [Table("Wide", head, rows, groups=groups)]), tmp_path / "r.pdf", wide=False)
    words = words_of(sheet)
    assert max(edges_of(one)[1] for one in words) <= HEIGHT - MARGIN + 1.0
    above = [one for one in words if one.y < min(one.y for one in words if "Column" in one.text)]
    assert sum("Disk" in one.text for one in above) == sum("guaranteed" in one.text for one in above) == 7


def test_every_page_has_its_number_and_every_page_of_the_matrix_its_head(sheets: list[Sheet]) -> None:
    for number, sheet in enumerate(sheets, start=1):
        texts = [one.text for one in words_of(sheet)]
        assert f"page {number} of {len(sheets)}" in texts
        if any(test.network in texts for test in arranged().tests()) and number > 1:
            assert "Asked" in texts or "✗" in " ".join(texts) or "t [s]" in texts, number


def test_the_name_of_a_group_and_a_reason_stay_with_their_test(sheets: list[Sheet]) -> None:
    groups = {group.name for group in arranged().groups()}
    for number, sheet in enumerate(sheets, start=1):
        words = [one for one in words_of(sheet) if one.size == 6.6 and one.x < MARGIN + 1.0]
        if not any(one.text == "Asked" for one in words_of(sheet)):
            continue
        last = max(words, key=lambda one: one.y)
        assert last.text not in groups, number
        first = min((one for one in words_of(sheet) if one.size == 6.6), key=lambda one: one.y)
        below = min(one.y for one in words_of(sheet) if one.size == 6.6 and one.y > first.y + 1.0)
        assert any(one.y == below and one.x < MARGIN + 1.0 for one in words_of(sheet)), number


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


def test_the_file_holds_the_texts_of_its_pages_and_the_same_bytes_each_time(tmp_path: Path) -> None:
    few = [Sheet(marks=[("Matrix ✗", 50.0)]), Sheet()]
    few[0].text(40.0, 60.0, "✗ Δθ ≥ 60° ⊘ “so”")
    few[1].text(40.0, 60.0, "bold 漢", bold=True)
    few[1].line((40.0, 60.0), (100.0, 80.0))
    first, second = (paper.save(few, tmp_path / name, "T").read_bytes() for name in ("a.pdf", "b.pdf"))
    assert first == second
    assert texts_of(first) == ["✗ Δθ ≥ 60° ⊘ “so”", "bold □"]
    objects = objects_of(first)
    assert sum(body.endswith(b"/Type /Page\n>>") for body in objects.values()) == 2
    assert any(b"/Count 2\n/Kids" in body for body in objects.values())
    assert any(("Matrix ✗".encode("utf-16-be").hex().encode()) in body.lower() for body in objects.values())
    assert len(first) < 60_000  # the letters that are used, not the whole fonts of 1.4 MB


def test_an_embedded_font_draws_the_letters_of_the_font(tmp_path: Path) -> None:
    import io

    from fontTools.pens.recordingPen import DecomposingRecordingPen
    from fontTools.ttLib import TTFont

    sheet = Sheet()
    sheet.text(40.0, 60.0, "ä✗g")
    content = paper.save([sheet], tmp_path / "a.pdf", "T").read_bytes()
    objects = objects_of(content)
    program = next(body for body in objects.values() if b"/Length1" in body).split(b">>\n", 1)[1]
    codes = {letter: code for code, letter in maps_of(objects)[b"F1"].items()}
    font_of = next(body for body in objects.values() if b"/CIDToGIDMap" in body)
    places = objects[int(re.search(rb"/CIDToGIDMap (\d+)", font_of).group(1))].split(b">>\n", 1)[1]  # type: ignore[union-attr]
    embedded = TTFont(io.BytesIO(program))
    whole: Any = TTFont(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")
    for letter in "ä✗g":
        name = whole.getBestCmap()[ord(letter)]
        place = int.from_bytes(places[2 * codes[letter] : 2 * codes[letter] + 2])
        drawn = []
        for font, glyph in ((whole, name), (embedded, embedded.getGlyphName(place))):
            glyphs = font.getGlyphSet()
            pen = DecomposingRecordingPen(glyphs)
            glyphs[glyph].draw(pen)
            drawn.append((pen.value, glyphs[glyph].width))
        assert drawn[0] == drawn[1]
        assert drawn[0][0]


def test_an_empty_set_of_pages_of_words_is_a_file(tmp_path: Path) -> None:
    assert texts_of(paper.save([Sheet()], tmp_path / "a.pdf", "T").read_bytes()) == []


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
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    for text in ("Settling time ≤ 2 s", "not applicable, |H|", "HiillHHH"):
        ink = np.asarray(TextPath((0, 0), text, size=100.0, prop=FontProperties("DejaVu Sans")).vertices)[:, 0].max()
        # The advance ends behind the ink of the last letter; kerning, which it leaves out, only makes a text shorter.
        assert 0.0 <= text_width(text, 100.0) - float(ink) <= 15.0
