"""Labels of ticks: plain text that says the same as matplotlib's formulas."""

from __future__ import annotations

import pickle

import pytest

from vsgdesign.report.drawing.style import add_axes, look, new_figure
from vsgdesign.report.drawing.ticks import Labels, PlainNumbers, plain_ticks, power_of_ten


def test_no_tick_is_a_formula_and_a_common_factor_is_written_as_a_power_of_ten() -> None:
    with look():
        figure = new_figure(4.0, 3.0)
        axes = add_axes(figure, 0.5, 0.5, 3.0, 2.0)
        axes.plot([0.01, 1000.0], [-2e-5, 4e-5])
        axes.set_xscale("log")
        plain_ticks(figure)
        figure.draw_without_rendering()
    labels = [label.get_text() for axis in (axes.xaxis, axes.yaxis) for label in axis.get_ticklabels()]
    assert not [text for text in labels if "$" in text]
    assert {"0.01", "1", "100", "−2", "4"} <= set(labels)
    assert axes.yaxis.get_offset_text().get_text() == "×10⁻⁵"


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (0.01, "0.01"), (1e4, "10⁴"), (-1e-5, "−10⁻⁵"), (1e12, "10¹²")]
)
def test_powers_of_ten(value: float, text: str) -> None:
    assert power_of_ten(value) == text


def test_labels_go_to_another_process() -> None:
    assert pickle.loads(pickle.dumps(Labels(power_of_ten)))(1e5) == "10⁵"  # noqa: S301
    assert pickle.loads(pickle.dumps(PlainNumbers((-3, 4)))) is not None  # noqa: S301
