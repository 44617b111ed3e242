"""How every page is made: one skeleton, figures inlined and numbered, nothing fetched."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign import __version__
from vsgdesign.report.figure_types import WrittenFigure
from vsgdesign.report.quantities import typeset

if TYPE_CHECKING:
    import jinja2


def write_html(
    out_path: Path, template: str, figures: Sequence[WrittenFigure], largest: str = "", **values: Any
) -> Path:
    """Write a page: a template of this room with these values, and with the figures' SVG text as it lies on disk.

    The template sees ``figures`` as (number, figure, svg), numbered from 1 in the order of their parts. The figure with
    the name ``largest`` belongs to the answer: it is the first one, and in ``largest`` instead of ``figures``.
    """
    placed = [
        (k + 1, figure, inline_svg(figure.svg.read_text(encoding="utf-8"), figure.name, figure.title))
        for k, figure in enumerate(sorted(figures, key=lambda figure: (figure.name != largest, figure.part)))
    ]
    first = [one for one in placed if one[1].name == largest]
    rest = [one for one in placed if one[1].name != largest]
    text = environment().get_template(template).render(figures=rest, largest=first, version=__version__, **values)
    out_path.write_text(text, encoding="utf-8", newline="\n")
    return out_path


def environment() -> jinja2.Environment:
    """Templates of this room, with the filter ``sub``; every text is escaped, a missing one is an error."""
    import jinja2

    def read(name: str) -> str:
        return (resources.files("vsgdesign.report") / "templates" / name).read_text(encoding="utf-8")

    found = jinja2.Environment(
        loader=jinja2.FunctionLoader(read),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        finalize=_finalize,
    )
    found.filters["sub"] = with_subscripts
    found.filters["tight"] = tight
    return found


def _finalize(value: Any) -> Any:
    """Plain texts that a template prints; Markup is finished."""
    return typeset(value) if type(value) is str else value


_BREAKABLE = re.compile(r"(?<=[≤≥\d]) (?=[\d%°a-zA-Z])|(?<=asked) (?=[≤≥])|(?<=limit) (?=\d)")


def tight(text: str) -> str:
    """The same text with no line break between a sign, its number and its unit."""
    return _BREAKABLE.sub("\N{NO-BREAK SPACE}", text)


_PHASOR = re.compile(r"(?<![A-Za-z_])(i|v)_(s|c|g|f)_(d|q)\b")
_SUBSCRIPT = re.compile(
    r"(?<![A-Za-z])(K|D|M|P|Q|V|R|L|T|X|Y|Z|d|f|k|ω)_"
    r"(ref|pcc|i|f|ip|iq|pq|qp|pv|iv|pc|ic|ff|dq|p|q|P|Q|g|n|s|t|op|1|2|c)\b"
)


def with_subscripts(text: str) -> str:
    """A plain text with its symbols (K_ip, P_ref) set with subscripts, everything else escaped."""
    from markupsafe import Markup, escape

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


def inline_svg(svg: str, name: str, title: str) -> str:
    """An SVG file as a part of an HTML page: no namespaces or prologue, ids of its own, width from its box."""
    from markupsafe import Markup, escape

    svg = _STYLE.sub("", _METADATA.sub("", _PROLOGUE.sub("", svg)))
    box = _VIEW_BOX.search(svg)
    if box is None:
        raise ValueError(f"the SVG of figure {name} has no viewBox")
    width, height = (float(size) for size in box.groups())
    tag = Markup('<svg role="img" aria-label="{}" viewBox="0 0 {:g} {:g}" style="--width: {:.0f}pt">').format(
        title, width, height, width
    )
    svg = _SVG_TAG.sub(lambda _: str(tag), svg, count=1)
    # Ids repeat from figure to figure; within one page each figure gets its own.
    prefix = str(escape(name))
    svg = _ID.sub(rf'id="{prefix}-\1"', svg)
    svg = _REFERENCE.sub(rf'href="#{prefix}-\1"', svg)
    return Markup(_URL.sub(rf"url(#{prefix}-\1)", svg).strip())
