"""The bytes of a PDF: pages of text and paths, with the letters that they use embedded.

A page is a content stream of the format's own operators (ISO 32000-1, 8.5 and 9.4). matplotlib's backend sets out each
letter of a text anew and takes 0.6 ms for it; here a text takes some microseconds.
"""

from __future__ import annotations

import functools
import hashlib
import io
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fontTools.ttLib import TTFont

REGULAR, BOLD = "DejaVuSans", "DejaVuSans-Bold"
"""Fonts that come with matplotlib: they have the signs of this field, and every machine has the same."""

FONTS = {REGULAR: "F1", BOLD: "F2"}
"""Names of the fonts in a page's content."""


@dataclass(frozen=True)
class Letters:
    """A font's letters: glyph of each character, and widths of the glyphs in thousandths of the size."""

    glyphs: Mapping[int, int]
    widths: Sequence[float]

    def glyph(self, letter: str) -> int:
        """The glyph of a character; 0, an empty box, where the font does not have it."""
        return self.glyphs.get(ord(letter), 0)


@functools.cache
def letters_of(name: str) -> Letters:
    """The letters of a font."""
    with _opened(name) as font:
        order = font.getReverseGlyphMap()
        scale = 1000.0 / font["head"].unitsPerEm  # type: ignore[attr-defined]
        metrics = font["hmtx"].metrics  # type: ignore[attr-defined]
        widths = [scale * metrics[glyph][0] for glyph in font.getGlyphOrder()]
        return Letters({code: order[glyph] for code, glyph in (font.getBestCmap() or {}).items()}, widths)


def encoded(text: str, name: str) -> bytes:
    """A text as the operand of the operator that shows it: two bytes for each glyph, in hexadecimal digits."""
    letters = letters_of(name)
    return b"<" + "".join(f"{letters.glyph(letter):04x}" for letter in text).encode() + b">"


@dataclass(frozen=True)
class Mark:
    """An entry of the list of contents: its words, its page from 0, and its height above the lower edge."""

    text: str
    page: int
    y: float


def pdf_bytes(
    pages: Sequence[bytes],
    size: tuple[float, float],
    title: str,
    used: Mapping[str, Iterable[str]],
    marks: Sequence[Mark] = (),
) -> bytes:
    """A file of pages with these contents. ``used``: the characters of each font. Equal pages give equal bytes."""
    writer = _Writer()
    fonts = {FONTS[name]: _font(writer, name, sorted(set(letters))) for name, letters in used.items()}
    tree = writer.reserved()
    resources = b"<< /Font << %s >> >>" % b" ".join(b"/%s %d 0 R" % (k.encode(), v) for k, v in fonts.items())
    numbers = []
    for content in pages:
        body = writer.stream(content)
        box = b"[0 0 %.1f %.1f]" % size
        page = b"<< /Type /Page /Parent %d 0 R /MediaBox %s /Resources %s /Contents %d 0 R >>"
        numbers.append(writer.add(page % (tree, box, resources, body)))
    kids = b" ".join(b"%d 0 R" % number for number in numbers)
    writer.put(tree, b"<< /Type /Pages /Count %d /Kids [%s] >>" % (len(pages), kids))
    outline = _outline(writer, marks, numbers)
    catalog = b"<< /Type /Catalog /Pages %d 0 R%s >>" % (
        tree,
        b" /Outlines %d 0 R /PageMode /UseOutlines" % outline if outline else b"",
    )
    about = b"<< /Title %s /Producer (vsgdesign) >>" % _string(title)
    return writer.finished(writer.add(catalog), writer.add(about))


class _Writer:
    """Objects of a file, by their numbers."""

    def __init__(self) -> None:
        self._objects: list[bytes] = []

    def reserved(self) -> int:
        """The number of an object that comes later."""
        self._objects.append(b"")
        return len(self._objects)

    def put(self, number: int, content: bytes) -> None:
        """Give a reserved object its content."""
        self._objects[number - 1] = content

    def add(self, content: bytes) -> int:
        """A new object; returns its number."""
        number = self.reserved()
        self.put(number, content)
        return number

    def stream(self, content: bytes, more: bytes = b"") -> int:
        """A compressed stream."""
        packed = zlib.compress(content, 6)
        head = b"<< /Length %d /Filter /FlateDecode%s >>" % (len(packed), more)
        return self.add(head + b"\nstream\n" + packed + b"\nendstream")

    def finished(self, catalog: int, about: int) -> bytes:
        """The whole file with its table of places."""
        out = io.BytesIO()
        out.write(b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n")
        places = []
        for number, content in enumerate(self._objects, start=1):
            places.append(out.tell())
            out.write(b"%d 0 obj\n%s\nendobj\n" % (number, content))
        begin = out.tell()
        out.write(b"xref\n0 %d\n0000000000 65535 f \n" % (len(places) + 1))
        out.write(b"".join(b"%010d 00000 n \n" % place for place in places))
        name = hashlib.sha256(out.getvalue()).hexdigest()[:32].encode()
        trailer = b"<< /Size %d /Root %d 0 R /Info %d 0 R /ID [<%s> <%s>] >>"
        out.write(b"trailer\n" + trailer % (len(places) + 1, catalog, about, name, name))
        out.write(b"\nstartxref\n%d\n%%%%EOF\n" % begin)
        return out.getvalue()


def _outline(writer: _Writer, marks: Sequence[Mark], pages: Sequence[int]) -> int:
    """The list of contents; 0 for none."""
    if not marks:
        return 0
    root = writer.reserved()
    items = [writer.reserved() for _ in marks]
    for k, (mark, item) in enumerate(zip(marks, items, strict=True)):
        around = b""
        if k > 0:
            around += b" /Prev %d 0 R" % items[k - 1]
        if k + 1 < len(items):
            around += b" /Next %d 0 R" % items[k + 1]
        place = b"[%d 0 R /XYZ 0 %.1f null]" % (pages[mark.page], mark.y)
        writer.put(item, b"<< /Title %s /Parent %d 0 R /Dest %s%s >>" % (_string(mark.text), root, place, around))
    ends = items[0], items[-1], len(items)
    writer.put(root, b"<< /Type /Outlines /First %d 0 R /Last %d 0 R /Count %d >>" % ends)
    return root


def _string(text: str) -> bytes:
    """A text outside of pages."""
    return b"<FEFF" + text.encode("utf-16-be").hex().encode() + b">"


def _font(writer: _Writer, name: str, used: Sequence[str]) -> int:
    """A font with the glyphs of some characters; its codes are the numbers of the glyphs."""
    letters = letters_of(name)
    glyphs = {letters.glyph(letter): letter for letter in used}
    with _opened(name) as font:
        head: Any = font["head"]
        scale = 1000.0 / head.unitsPerEm
        box = [scale * value for value in (head.xMin, head.yMin, head.xMax, head.yMax)]
        ascent, descent = (scale * getattr(font["hhea"], key) for key in ("ascent", "descent"))
        program = _subset(font, glyphs)
    file = writer.stream(program, b" /Length1 %d" % len(program))
    tagged = b"VSGDSN+" + name.encode()
    descriptor = writer.add(
        b"<< /Type /FontDescriptor /FontName /%s /Flags 4 /FontBBox [%d %d %d %d] /ItalicAngle 0 /Ascent %d "
        b"/Descent %d /CapHeight %d /StemV 80 /FontFile2 %d 0 R >>" % (tagged, *box, ascent, descent, ascent, file)
    )
    widths = b" ".join(b"%d [%.1f]" % (glyph, letters.widths[glyph]) for glyph in sorted(glyphs))
    system = b"<< /Registry (Adobe) /Ordering (Identity) /Supplement 0 >>"
    inner = writer.add(
        b"<< /Type /Font /Subtype /CIDFontType2 /BaseFont /%s /CIDSystemInfo %s /FontDescriptor %d 0 R /DW 600 "
        b"/W [%s] /CIDToGIDMap /Identity >>" % (tagged, system, descriptor, widths)
    )
    unicode = writer.stream(_to_unicode(glyphs))
    return writer.add(
        b"<< /Type /Font /Subtype /Type0 /BaseFont /%s /Encoding /Identity-H /DescendantFonts [%d 0 R] "
        b"/ToUnicode %d 0 R >>" % (tagged, inner, unicode)
    )


def _to_unicode(glyphs: Mapping[int, str]) -> bytes:
    """Which text the glyphs stand for, so that the words of a page can be searched and copied."""
    lines = [
        b"<%04x> <%s>" % (glyph, letter.encode("utf-16-be").hex().encode())
        for glyph, letter in sorted(glyphs.items())
        if glyph
    ]
    blocks = [lines[k : k + 100] for k in range(0, len(lines), 100)]
    return b"\n".join(
        [
            b"/CIDInit /ProcSet findresource begin 12 dict begin begincmap",
            b"/CIDSystemInfo << /Registry (Adobe) /Ordering (UCS) /Supplement 0 >> def",
            b"/CMapName /Adobe-Identity-UCS def /CMapType 2 def",
            b"1 begincodespacerange <0000> <FFFF> endcodespacerange",
            *(b"%d beginbfchar\n%s\nendbfchar" % (len(block), b"\n".join(block)) for block in blocks),
            b"endcmap CMapName currentdict /CMap defineresource pop end end",
        ]
    )


def _subset(font: TTFont, glyphs: Iterable[int]) -> bytes:
    """The font's program with these glyphs alone, at their own numbers."""
    from fontTools.subset import Options, Subsetter

    kept = ("head", "hhea", "hmtx", "maxp", "loca", "glyf", "cvt ", "fpgm", "prep")
    for table in [name for name in font.keys() if name not in kept]:  # noqa: SIM118 - a font is no mapping
        if table != "GlyphOrder":
            del font[table]
    options = Options(retain_gids=True, hinting=False, notdef_outline=True, recalc_timestamp=False)
    subsetter = Subsetter(options)
    subsetter.populate(gids=[0, *glyphs])
    subsetter.subset(font)
    out = io.BytesIO()
    font.save(out)
    return out.getvalue()


def _opened(name: str) -> TTFont:
    import logging

    import matplotlib
    from fontTools.ttLib import TTFont

    logging.getLogger("fontTools").setLevel(logging.WARNING)
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{name}.ttf"
    return TTFont(path, recalcTimestamp=False, lazy=True)
