"""Blocks as HTML: a page of one skeleton with its figures inlined, or a fragment for a notebook. Nothing is fetched."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from vsgdesign import __version__
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.quantities import typeset
from vsgdesign.report.drawing.sketch import filled, svg
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    NUMBERS,
    SOURCE,
    Answer,
    Block,
    Box,
    Cell,
    Contents,
    Figure,
    Heading,
    Line,
    Live,
    Note,
    Page,
    Side,
    Sketches,
    Span,
    Table,
    Where,
    Words,
    numbered,
    printed,
)

if TYPE_CHECKING:
    import jinja2

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; worker-src blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:; base-uri 'none'"
)
"""The content security policy of a page that is a file: it asks nobody for anything. It may compile WebAssembly and
start a worker from a text of its own, and never evaluates a text as a script."""
BESIDE = "; frame-src 'self' file:"
"""A report may show a page beside it in a frame."""

MANY = 6
"""An answer of more columns than these is set closer, so that it fits into its page."""

_FEW_ROWS, _FEW_LETTERS, _FEW_TEXTS = 14, 28, 6
"""A table of so many rows stays on one sheet of paper; a text of so many letters stays on one line, where so many
columns have texts."""


def print_html(page: Page, out_path: Path) -> Path:
    """Write a page: one file, which fetches nothing. Figures are inlined as their SVG lies on disk."""
    blocks = numbered(page.blocks)
    text = (
        environment()
        .get_template("skeleton.html.j2")
        .render(
            title=page.title,
            policy=Markup(POLICY + BESIDE),
            style=Markup(text_file("style.css") + page.style),
            main=_set(blocks, blocks),
            origin=_line(page.origin),
            script=Markup(page.script),
            version=__version__,
        )
    )
    out_path.write_text(text, encoding="utf-8", newline="\n")
    return out_path


def print_fragment(blocks: Sequence[Block]) -> str:
    """Blocks as a part of a page that has its own skeleton and style: the cell of a notebook."""
    return str(_set(blocks, blocks))


def _set(blocks: Sequence[Block], of_page: Sequence[Block]) -> Markup:
    return Markup("\n").join(_block(block, of_page) for block in printed(blocks, Where.PAGE))


def _block(block: Block, of_page: Sequence[Block]) -> Markup:
    if isinstance(block, Box):
        anchor = filled(' id="{}"', block.anchor) if block.anchor else ""
        head = filled('<section class="verdict{}"{}>\n', " warning" if block.warning else "", anchor)
        return head + _set(block.blocks, of_page) + Markup("\n</section>")
    if isinstance(block, Side):
        return filled('<div class="side">\n{}\n</div>', _set(block.blocks, of_page))
    if isinstance(block, Contents):
        return _contents(of_page)
    return _PRINTERS[type(block)](block)


def _heading(block: Heading) -> Markup:
    anchor = filled(' id="{}"', block.anchor) if block.anchor else ""
    return filled("<h{}{}>{}</h{}>", block.level, anchor, with_subscripts(block.text), block.level)


def _contents(of_page: Sequence[Block]) -> Markup:
    parts = [block for block in of_page if isinstance(block, Heading) and block.numbered]
    entry = '<li><a href="#{}">{}</a></li>'
    items = Markup("\n").join(filled(entry, part.anchor, part.text.partition(". ")[2]) for part in parts)
    return filled('<nav aria-label="Parts">\n<ol>\n{}\n</ol>\n</nav>', items)


def _words(block: Words) -> Markup:
    lines = [_line(line) for line in block.lines]
    if block.style in (BULLETS, NUMBERS):
        tag = "ul" if block.style == BULLETS else "ol"
        items = Markup("\n").join(filled("<li>{}</li>", line) for line in lines)
        return filled("<{}>\n{}\n</{}>", tag, items, tag) if lines else Markup("")
    kind = filled(' class="{}"', block.style) if block.style in (HEADLINE, SOURCE) else ""
    return Markup("\n").join(filled("<p{}>{}</p>", kind, line) for line in lines)


def _note(block: Note) -> Markup:
    return filled('<p class="note">{}</p>', _line(block.line))


def _notes(notes: Iterable[str]) -> Markup:
    return Markup("").join(_note(Note(note)) + Markup("\n") for note in notes)


def _line(line: Line) -> Markup:
    if isinstance(line, Span):
        return _span(line)
    return with_subscripts(line) if isinstance(line, str) else Markup("").join(map(_line, line))


def _span(span: Span) -> Markup:
    found = filled("<code>{}</code>", str(span)) if span.code else with_subscripts(span)
    for tag, on in (("b", span.bold), ("i", span.italic)):
        found = filled("<{}>{}</{}>", tag, found, tag) if on else found
    return filled('<a href="{}">{}</a>', span.link, found) if span.link else found


def _table(table: Table) -> Markup:
    kinds = "table" + (" small" if table.small else "") + (" short" if len(table.rows) <= _FEW_ROWS else "")
    anchor = filled(' id="{}"', table.anchor) if table.anchor else ""
    head = Markup("").join(
        filled("<th{}>{}</th>", Markup(' class="text"') if k < table.texts else "", with_subscripts(cell))
        for k, cell in enumerate(table.head)
    )
    groups = Markup("").join(
        filled('<th colspan="{}"{}>{}</th>', span, Markup(' class="named"') if label else "", label)
        for label, span in table.groups
    )
    groups = filled('<tr class="groups">{}</tr>\n', groups) if table.groups else ""
    rows = Markup("\n").join(_row(table, k) for k in range(len(table.rows)))
    caption = filled("<caption>{}</caption>\n", typeset(table.title)) if table.title else ""
    return filled(
        '<figure class="{}">\n<table{}>\n{}<thead>\n{}<tr>{}</tr>\n</thead>\n<tbody>\n{}\n</tbody>\n</table>\n'
        "{}</figure>",
        kinds,
        anchor,
        caption,
        groups,
        head,
        rows,
        _notes(table.notes),
    )


def _row(table: Table, k: int) -> Markup:
    kinds = " ".join(kind for kind, rows in (("flagged", table.flagged), ("marked", table.marked)) if k in rows)
    cells = []
    for n, cell in enumerate(table.rows[k]):
        brief = " brief" if len(cell) <= _FEW_LETTERS and table.texts <= _FEW_TEXTS else ""
        look = filled(' class="text{}"', brief) if n < table.texts else ""
        link = table.links[k] if table.links and n == 0 else ""
        shown = filled('<a href="{}">{}</a>', link, _line(cell)) if link else _line(cell)
        cells.append(filled("<td{}>{}</td>", look, shown))
    look = filled(' class="{}"', kinds) if kinds else Markup("")
    if table.row_anchor:
        look += filled(' id="{}-{}"', table.row_anchor, k + 1)
    return filled("<tr{}>{}</tr>", look, Markup("").join(cells))


def _answer(answer: Answer) -> Markup:
    head = Markup("").join(
        filled('<th class="text">{}</th>', with_subscripts(cell)) for cell in (answer.subject, *answer.head)
    )
    rows = [
        filled(
            '<tr><th class="text" scope="row">{}{}</th>\n{}\n</tr>',
            filled("{} ", row.key) if row.key is not None else "",
            typeset(row.name),
            Markup("\n").join(map(_cell, row.cells)),
        )
        for row in answer.rows
    ]
    return filled(
        '<figure class="table answer{}">\n<table>\n<caption>{}</caption>\n<thead>\n<tr>{}</tr>\n</thead>\n<tbody>\n{}\n'
        "</tbody>\n</table>\n{}</figure>",
        " pictures" if answer.pictures else " many" if len(answer.head) > MANY else "",
        typeset(answer.title),
        head,
        Markup("\n").join(rows),
        _notes(answer.notes),
    )


def _cell(cell: Cell) -> Markup:
    sign = filled('<span aria-hidden="true">{}</span>&nbsp;', cell.sign) if cell.sign else ""
    detail = filled(" <small>{}</small>", with_subscripts(tight(cell.detail))) if cell.detail else ""
    return filled(
        '<td class="text">{}<span class="{}">{}{}</span>{}</td>',
        "" if cell.picture is None else cell.picture,
        cell.mark,
        sign,
        with_subscripts(cell.words),
        detail,
    )


def _figure(block: Figure) -> Markup:
    drawn = block.drawn
    number = f"Figure {block.number}. " if block.number else ""
    return filled(
        '<figure class="drawing" id="figure-{}">\n<div class="canvas">\n{}\n</div>\n'
        "<figcaption><b>{}{}.</b> {}</figcaption>\n</figure>",
        drawn.name,
        inline_svg(_svg_of(block), drawn.name, drawn.title, alone=not block.number),
        number,
        with_subscripts(drawn.title),
        with_subscripts(drawn.caption),
    )


def _svg_of(block: Figure) -> str:
    if isinstance(block.drawn, NamedFigure):
        from vsgdesign.report.drawing.figures import svg_text

        return svg_text(block.drawn.figure)
    return block.drawn.svg.read_text(encoding="utf-8")


def _sketches(block: Sketches) -> Markup:
    drawn = [svg(one, block.kind) for one in block.sketches]
    if block.least:
        scrolled = '<div class="scroll" style="flex-basis:{}px">{}</div>'
        drawn = [
            filled(scrolled, f"{block.least * one.width:.0f}", made)
            for one, made in zip(block.sketches, drawn, strict=True)
        ]
    title = filled("<b>{}.</b> ", block.title) if block.title else ""
    caption = filled("<figcaption>{}{}</figcaption>", title, with_subscripts(tight(block.caption)))
    row = filled('<div class="row">{}</div>', Markup("\n").join(drawn))
    parts = (caption, row) if block.least else (row, caption)
    return filled('<figure class="{}">{}{}</figure>', "maps" if block.least else "plots", *parts)


_PRINTERS: dict[type[Block], Callable[[Any], Markup]] = {
    Heading: _heading,
    Words: _words,
    Note: _note,
    Table: _table,
    Answer: _answer,
    Figure: _figure,
    Sketches: _sketches,
    Live: lambda block: block.html(),
}


def text_file(name: str) -> str:
    """A file of the room ``templates``."""
    return (resources.files("vsgdesign.report") / "templates" / name).read_text(encoding="utf-8")


def environment() -> jinja2.Environment:
    """The skeleton's templates; every text is escaped and typeset, a missing one is an error."""
    import jinja2

    return jinja2.Environment(
        loader=jinja2.FunctionLoader(text_file),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        finalize=lambda value: typeset(value) if type(value) is str else value,
    )


_BREAKABLE = re.compile(r"(?<=[≤≥\d]) (?=[\d%°a-zA-Z])|(?<=asked) (?=[≤≥])|(?<=limit) (?=\d)")


def tight(text: str) -> str:
    """The same text with no line break between a sign, its number and its unit."""
    return _BREAKABLE.sub("\N{NO-BREAK SPACE}", text)


_PHASOR = re.compile(r"(?<![A-Za-z_])(i|v)_(s|c|g|f)_(d|q)\b")
_SUBSCRIPT = re.compile(
    r"(?<![A-Za-z])(K|D|M|P|Q|V|R|L|T|X|Y|Z|d|f|k|ω)_"
    r"(ref|pcc|i|f|ip|iq|pq|qp|pv|iv|pc|ic|ff|dq|p|q|P|Q|g|n|s|t|op|1|2|c)\b"
)


def with_subscripts(text: str) -> Markup:
    """A plain text with its symbols (K_ip, P_ref) set with subscripts, everything else escaped."""
    text = _PHASOR.sub(r"<i>\1</i><sub>\2,\3</sub>", str(escape(typeset(text))))
    return Markup(_SUBSCRIPT.sub(r"<i>\1</i><sub>\2</sub>", text))


_PROLOGUE = re.compile(r"^.*?(?=<svg\b)", re.DOTALL)
_METADATA = re.compile(r"\s*<metadata>.*?</metadata>", re.DOTALL)
_STYLE = re.compile(r"\s*<defs>\s*<style[^>]*>.*?</style>\s*</defs>", re.DOTALL)
_SVG_TAG = re.compile(r"<svg\b[^>]*>")
_VIEW_BOX = re.compile(r'viewBox="0 0 ([\d.]+) ([\d.]+)"')
_ID = re.compile(r'\bid="([^"]+)"')
_REFERENCE = re.compile(r'(?:xlink:)?href="#([^"]+)"')
_URL = re.compile(r"url\(#([^)]+)\)")


def inline_svg(svg: str, name: str, title: str, alone: bool = False) -> Markup:
    """An SVG file as a part of an HTML page: no namespaces or prologue, ids of its own, width from its box.

    ``alone``: it has its own size, because there is no style of a page.
    """
    svg = _STYLE.sub("", _METADATA.sub("", _PROLOGUE.sub("", svg)))
    box = _VIEW_BOX.search(svg)
    if box is None:
        raise ValueError(f"the SVG of figure {name} has no viewBox")
    width, height = (float(size) for size in box.groups())
    form = '<svg role="img" aria-label="{}" viewBox="0 0 {} {}" style="{}: {}pt">'
    sized = "max-width: 100%; width" if alone else "--width"
    tag = filled(form, title, f"{width:g}", f"{height:g}", sized, f"{width:.0f}")
    svg = _SVG_TAG.sub(lambda _: str(tag), svg, count=1)
    # Ids repeat from figure to figure; within one page each figure gets its own.
    prefix = str(escape(name))
    svg = _ID.sub(rf'id="{prefix}-\1"', svg)
    svg = _REFERENCE.sub(rf'href="#{prefix}-\1"', svg)
    return Markup(_URL.sub(rf"url(#{prefix}-\1)", svg).strip())
