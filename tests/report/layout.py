"""Whether what a figure shows lies on its page, and nothing on another; and a figure as SVG alone."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure, compact
from vsgdesign.report.drawing.style import look


def assert_apart(figure: Figure, slack: float, name: str) -> None:
    """No axes and no legend of a figure reaches ``slack`` pixels beyond the page or overlaps another.

    To ask for the boxes lays the figure out as drawing does.
    """
    with look():
        boxes = [axes.get_tightbbox() for axes in figure.axes]
        boxes += [legend.get_window_extent() for legend in figure.legends]
    seen = [box for box in boxes if box is not None]
    assert len(seen) == len(boxes), name
    for index, box in enumerate(seen):
        assert box.x0 > -slack, (name, index, box)
        assert box.x1 < figure.bbox.width + slack, (name, index, box)
        assert box.y0 > -slack, (name, index, box)
        assert box.y1 < figure.bbox.height + slack, (name, index, box)
        for other in seen[index + 1 :]:
            assert not box.overlaps(other), (name, box, other)


def write_svg(named: NamedFigure, folder: Path) -> WrittenFigure:
    """A figure as SVG only, in half the time."""
    svg = folder / f"{named.name}.svg"
    buffer = io.StringIO()
    with look():
        named.figure.savefig(buffer, format="svg", metadata={"Date": None})
    svg.write_text(compact(buffer.getvalue()), encoding="utf-8")
    return WrittenFigure(named.name, named.title, named.caption, svg, svg, named.part)
