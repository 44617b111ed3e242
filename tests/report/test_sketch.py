"""Light drawings: what the short text of a path draws is what was given, and no extreme is lost."""

from __future__ import annotations

import re

import numpy as np
import pytest

from vsgdesign.report.compliance.heat import heat_sketch, heat_sketches
from vsgdesign.report.drawing.plot import Band, Curve, Plot, plot_sketch, round_ticks
from vsgdesign.report.drawing.sketch import Area, Sketch, Stroke, Words, svg, svg_file

NUMBER = re.compile(r"-?\d+")


def drawn(path: str) -> list[np.ndarray]:
    """The corners of each run of a path, in px, as a browser draws them."""
    runs = []
    for run in path.split("M")[1:]:
        first, _, steps = run.partition("l")
        start = np.array([int(n) for n in NUMBER.findall(first)])
        moves = np.array([int(n) for n in NUMBER.findall(steps)]).reshape(-1, 2)
        runs.append((start + np.concatenate([[[0, 0]], np.cumsum(moves, axis=0)])) / 10.0)
    return runs


def path_of(points: np.ndarray) -> list[np.ndarray]:
    sketch = Sketch(100.0, 100.0, "x", [Stroke(points, "#000")])
    found = re.search(r'd="([^"]*)"', svg(sketch))
    return drawn(found.group(1)) if found else []


def distance(points: np.ndarray, line: np.ndarray) -> float:
    """Largest distance of points from a polyline."""
    a, b = line[:-1], line[1:]
    along = b - a
    share = np.clip(((points[:, None] - a) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(points[:, None] - (a + share[..., None] * along), axis=-1).min(axis=1).max())


def test_a_path_passes_every_point_to_a_twentieth_of_a_pixel() -> None:
    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(0.0, 100.0, 400))
    for y in (rng.uniform(0.0, 100.0, 400), np.full(400, 31.4), 50.0 + 40.0 * np.sin(x), np.round(x)):
        points = np.stack([x, y], axis=1)
        (found,) = path_of(points)
        # Half a tenth on each axis.
        assert distance(points, found) <= 0.0708
        assert found[0] == pytest.approx(points[0], abs=0.0501)
        assert found[-1] == pytest.approx(points[-1], abs=0.0501)
    (flat,) = path_of(np.stack([x, np.full(400, 31.4)], axis=1))
    assert len(flat) == 2


def test_a_line_that_turns_back_keeps_its_end() -> None:
    (found,) = path_of(np.array([[0.0, 0.0], [10.0, 0.0], [5.0, 0.0]]))
    assert found.tolist() == [[0.0, 0.0], [10.0, 0.0], [5.0, 0.0]]


def test_a_line_is_cut_at_what_is_not_known() -> None:
    points = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, np.nan], [3.0, 0.0], [4.0, 1.0], [5.0, np.nan], [6.0, 2.0]])
    assert [run.tolist() for run in path_of(points)] == [[[0.0, 0.0], [1.0, 1.0]], [[3.0, 0.0], [4.0, 1.0]]]
    assert path_of(np.full((3, 2), np.nan)) == []


def test_words_are_escaped_and_a_file_holds_every_sketch() -> None:
    sketch = Sketch(100.0, 50.0, 'a "label"', [Words(1.0, 2.0, "P < 1 & Q")])
    assert "P &lt; 1 &amp; Q" in svg(sketch)
    text = svg_file([sketch, sketch], "Title <1>", ("line & more",))
    assert text.count("P &lt; 1 &amp; Q") == 2
    assert "Title &lt;1&gt;" in text
    assert "translate(1000 " in text


@pytest.mark.parametrize(
    ("low", "high"), [(0.0, 1.0), (-3.3, 7.1), (49.99, 50.02), (1e-6, 3e-6), (-1e6, 2e6), (0.0, 1e-3)]
)
def test_ticks_are_round_few_and_within(low: float, high: float) -> None:
    ticks = round_ticks(low, high, 6)
    assert 3 <= len(ticks) <= 7
    slack = 1e-9 * (high - low)
    assert all(low - slack <= tick <= high + slack for tick in ticks)
    step = ticks[1] - ticks[0]
    assert f"{step:.0e}"[0] in "125"


def test_no_ticks_of_no_range() -> None:
    assert round_ticks(1.0, 1.0, 5) == []
    assert round_ticks(0.0, float("inf"), 5) == []


def test_a_plot_keeps_every_extreme_and_says_what_is_beyond_it() -> None:
    t = np.linspace(0.0, 1.0, 5000)
    y = np.zeros(5000)
    y[1234], y[4321] = 2.5, -1.5
    sketch = plot_sketch(Plot("T", "y [pu]", [Curve(t, y, "#123456")]))
    curve = next(part for part in sketch.parts if isinstance(part, Stroke) and part.colour == "#123456")
    heights = curve.points[:, 1]
    # The scale has 8 % of room on either side of -1.5 to 2.5.
    frame = 190.0 - 20.0 - 32.0
    assert heights.min() == pytest.approx(20.0 + frame * 0.08 / 1.16, abs=1e-6)
    assert heights.max() == pytest.approx(20.0 + frame * 1.08 / 1.16, abs=1e-6)
    cut = plot_sketch(Plot("T", "y [pu]", [Curve(t, y, "#123456")], within=(-3.0, 2.0)))
    assert [part.text for part in cut.parts if isinstance(part, Words) and "beyond" in part.text] == [
        "beyond the scale: 2.5"
    ]
    inside = next(part for part in cut.parts if isinstance(part, Stroke) and part.colour == "#123456")
    assert inside.points[:, 1].min() >= 20.0


def test_a_limit_on_one_side_is_an_area_to_the_end_of_the_scale() -> None:
    t = np.linspace(0.0, 1.0, 100)
    none, limit = np.full(100, np.nan), np.full(100, 0.8)
    for band, end in ((Band(t, none, limit), 158.0), (Band(t, limit, none), 20.0)):
        sketch = plot_sketch(Plot("T", "y", [Curve(t, t, "#123456")], [band]))
        area = next(part for part in sketch.parts if isinstance(part, Area))
        assert end in area.points[:, 1].round(6)
    outside = plot_sketch(Plot("T", "y", [Curve(t, t, "#123456")], [Band(t, none, none)]))
    assert not any(isinstance(part, Area) for part in outside.parts)


def test_curves_that_are_empty_or_broken_are_no_error() -> None:
    empty, gone = np.zeros(0), np.full(50, np.nan)
    plot_sketch(Plot("T", "y", []))
    plot_sketch(Plot("T", "y", [Curve(empty, empty, "#123456")]))
    svg(plot_sketch(Plot("T", "y", [Curve(np.arange(50.0), gone, "#123456")])))
    svg(plot_sketch(Plot("T", "y", [Curve(np.arange(50.0), np.zeros(50), "#123456")])))


def test_the_words_of_a_map_can_be_read_on_their_cells() -> None:
    """Contrast 4.5 to 1. Before, white words on the middle blue had 3 to 1."""

    def luminance(colour: str) -> float:
        parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    values = [float(v) for v in np.linspace(0.1, 3.0, 60)]
    found = {
        "title": "T", "controller": "A", "label": "L", "unit": "s", "words": "",
        "x": {"label": "SCR", "unit": "1", "values": list(range(60))},
        "y": {"label": "X/R", "unit": "1", "values": [1.0]}, "values": [values],
    }  # fmt: skip
    sketch = heat_sketch(found)
    cells = [part for part in sketch.parts if isinstance(part, Area)][:60]
    words = [part for part in sketch.parts if isinstance(part, Words) and part.y == 26.0 + 12.5]
    assert len(words) == 60
    for cell, word in zip(cells, words, strict=True):
        light, dark = sorted((luminance(cell.colour), luminance(word.colour)), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 4.5, (cell.colour, word.colour)


def test_a_map_says_a_number_or_a_word_in_every_cell() -> None:
    found = {
        "title": "Critical clearing time", "controller": "A", "label": "Longest fault", "unit": "s", "words": "",
        "x": {"label": "SCR", "unit": "1", "values": [1.2, 2.0, 5.0]},
        "y": {"label": "X/R", "unit": "1", "values": [0.5, 10.0]},
        "values": [[0.05, None, 3.0], [None, None, 0.25]],
        "status": [["a longer fault is lost", "slipped", "survived up to 3 s"], ["no rest", "unheard of", "a longer"]],
    }  # fmt: skip
    texts = [part.text for part in heat_sketch(found).parts if isinstance(part, Words)]
    for said in ("0.05", "slips", "≥ 3", "0.25", "A", "SCR [1]", "X/R [1]"):
        assert said in texts, said
    assert texts.count("–") == 2
    # The largest value of y is on top.
    places = {part.text: part.y for part in heat_sketch(found).parts if isinstance(part, Words)}
    assert places["10"] < places["0.5"]
    colours = [part.colour for part in heat_sketch(found).parts if isinstance(part, Area)][:6]
    assert len(set(colours)) == 5
    empty = found | {"values": [[None] * 3] * 2, "status": [["slipped"] * 3] * 2}
    assert [w.text for w in heat_sketch(empty).parts if isinstance(w, Words)].count("slips") == 6


def test_maps_of_one_title_share_their_scale() -> None:
    axis = {"label": "SCR", "unit": "1", "values": [1.0]}
    maps = [
        {"title": title, "controller": name, "label": "T", "unit": "s", "x": axis, "y": axis, "values": [[value]]}
        for title, name, value in (("T", "A", 1.0), ("T", "B", 3.0), ("U", "A", 3.0))
    ]
    first, second, other = heat_sketches(maps)
    cells = [next(part.colour for part in one.parts if isinstance(part, Area)) for one in (first, second, other)]
    assert len(set(cells)) == 3
    for one, ends in ((first, ["1", "3 s: t"]), (second, ["1", "3 s: t"]), (other, ["3", "3 s: t"])):
        said = [part.text for part in one.parts if isinstance(part, Words)]
        assert [said[-2], said[-1]] == ends


def test_a_converter_that_survives_no_fault_at_all_is_shown_as_lost() -> None:
    axis = {"label": "SCR", "unit": "1", "values": [1.0]}
    zero, slips = (
        heat_sketch(
            {"title": "T", "controller": "A", "label": "T", "unit": "s", "x": axis, "y": axis, "values": [[value]]}
            | {"status": [[status]]}
        )
        for value, status in ((0.0, "a longer fault is lost"), (None, "slipped"))
    )
    colours = [next(part.colour for part in one.parts if isinstance(part, Area)) for one in (zero, slips)]
    assert colours[0] == colours[1]
