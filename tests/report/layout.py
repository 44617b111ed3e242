"""Whether what a figure shows lies on its page, and nothing on another."""

from __future__ import annotations

from matplotlib.figure import Figure


def assert_apart(figure: Figure, slack: float, name: str) -> None:
    """No axes and no legend of a laid-out figure reaches ``slack`` pixels beyond the page or overlaps another."""
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
