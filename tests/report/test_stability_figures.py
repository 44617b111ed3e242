"""Figures of a stability assessment: all there, readable, labelled, small, and the same on every run."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.report.layout import assert_apart
from tests.report.stability_cases import AS_WRITTEN, TEXTS, assessed, case, drawn
from vsgdesign.report.drawing.figures import write_figure
from vsgdesign.report.drawing.look import Cells, Scale, edges, gate_scale
from vsgdesign.report.stability.frequency import shown_cells
from vsgdesign.report.stability.maps import QUANTITIES, settling_cells, worst_over_powers
from vsgdesign.report.stability.schedule import worst_over_boxes
from vsgdesign.study.parameters.grid import Grid

MAPS = {f"map_{quantity.name}" for quantity in QUANTITIES} | {"map_settling"}
ONE_OF_A_KIND = ("map_damping", "between_nodes", "nichols", "nyquist", "loci_1")
UNIT = re.compile(r"\[[^\]]+\]$")


def test_which_figures_there_are() -> None:
    one_of_each = {"between_nodes", "nfp", "nichols", "passivity", "nyquist"}
    assert set(drawn("plain")) == MAPS | one_of_each | {
        "map_gains_2",
        "stale_damping_2",
        "stale_disk_margin_2",
        "estimate_error_2",
        "error_box_2",
        "loci_1",
        "loci_2",
        "admittance_1",
        "admittance_2",
        "steps_1",
    }
    assert set(drawn("unstable")) == MAPS | one_of_each | {"loci_1", "admittance_1"}
    assert set(drawn("faulty")) == MAPS | {"stale_damping_1", "stale_disk_margin_1", "estimate_error_1", "error_box_1"}


@pytest.mark.parametrize("name", sorted(TEXTS))
def test_every_axis_has_a_unit_and_nothing_overlaps(name: str) -> None:
    for named in drawn(name).values():
        figure = named.figure
        labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
        assert labels
        assert all(UNIT.search(label) for label in labels), (named.name, labels)
        assert_apart(figure, 1.5, named.name)


def test_files_are_small_well_formed_and_the_same_twice(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The second time a figure of each kind, as other tests have drawn it."""
    once = case(AS_WRITTEN, tmp_path_factory).figures
    twice = {name: write_figure(drawn(AS_WRITTEN)[name], tmp_path) for name in ONE_OF_A_KIND}
    assert set(twice) <= {a.name for a in once}
    for a in once:
        if a.name in twice:
            assert a.svg.read_bytes() == twice[a.name].svg.read_bytes(), a.name
            assert a.png.read_bytes() == twice[a.name].png.read_bytes(), a.name
        assert a.svg.stat().st_size < 300_000
        text = a.svg.read_text(encoding="utf-8")
        assert ET.fromstring(text.encode()).tag.endswith("svg")
        assert not re.search(r'href="(?!#|data:)', text)
        sizes = [float(size) for size in re.findall(r"font(?:-size)?: (?:\w+ )*?([\d.]+)px", text)]
        assert sorted(sizes)[len(sizes) // 3] >= 7.0


@pytest.mark.parametrize(("larger", "log"), [(True, False), (False, True)])
@pytest.mark.parametrize("gate", [0.0, 0.3, 1.0, 60.0])
def test_a_scale_breaks_at_its_gate(gate: float, larger: bool, log: bool) -> None:
    if log and gate == 0.0:
        gate = 1e-3
    scale = gate_scale(0.5 if log else 0.0, 10.0, gate, (0.5, 1.0, 10.0), larger_is_better=larger, log=log)
    assert scale.low < gate < scale.high
    assert scale(gate) == pytest.approx(0.5)
    values = np.linspace(scale.low, scale.high, 101)
    assert (np.diff(scale(values)) >= 0.0).all()
    assert np.isnan(scale(np.nan))
    assert gate in scale.shown_ticks()
    assert scale.passes(np.array([gate, np.nan])).tolist() == [True, False]


def test_colours_step_evenly_and_worse_is_never_the_colour_of_better() -> None:
    def lightness(colours: np.ndarray) -> np.ndarray:
        linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
        return 116.0 * np.cbrt(linear @ np.array([0.2126, 0.7152, 0.0722])) - 16.0

    colours = np.array(gate_scale(0.0, 1.0, 0.3, ()).colours().colors)
    worse, better = colours[:64], colours[64:]
    for half, sign in ((worse, 1.0), (better, -1.0)):
        steps = sign * np.diff(lightness(half))
        assert steps.min() > 0.3 * steps.mean()
        assert steps.max() < 2.5 * steps.mean()
    assert (worse[:, 0] > worse[:, 2]).all()  # warm
    assert (better[:, 0] < better[:, 2]).all()  # cold


def test_edges_lie_between_the_values() -> None:
    for values, log in (([1.2, 1.5, 20.0], True), ([3.0], True), ([-0.1, 0.0, 0.3], False), ([0.0], False)):
        found = edges(np.array(values), log)
        assert len(found) == len(values) + 1
        assert all(found[k] < value < found[k + 1] for k, value in enumerate(values))


def test_a_map_shows_the_worst_of_its_powers() -> None:
    for a in assessed("odd").assessments:
        field = a.full_order
        cells = worst_over_powers(field, field.table.least_damping)
        assert isinstance(cells, Cells)
        spread = field.field(field.table.least_damping)
        for place in np.ndindex(*cells.values.shape):
            row, within = spread[place], field.cells.inside.reshape(field.shape)[place]
            assert cells.missing[place] == np.isnan(row).all()
            assert cells.outside is not None
            assert cells.outside[place] == (not cells.missing[place] and np.isnan(row[within]).all())
            if not cells.missing[place]:
                row = row if cells.outside[place] else row[within]
                assert cells.values[place] == np.nanmin(row)
        assert settling_cells(a).values.shape == (1, 2)


def test_a_larger_box_of_errors_is_never_better() -> None:
    field = assessed("plain").assessments[1].estimate_error
    assert field is not None
    sizes, worst = worst_over_boxes(field, field.table.least_damping)
    assert sizes.tolist() == [0.0, 0.1]
    assert (np.diff(worst, axis=1) <= 0.0).all()
    nominal = field.field(field.table.least_damping)[:, 0, 1, 1]
    assert worst[:, 0].tolist() == nominal.tolist()


def test_unstable_cells_are_hatched_and_cells_without_a_point_are_crossed() -> None:
    for name, hatched, crossed in (("unstable", True, False), ("faulty", False, True)):
        figure = drawn(name)["map_damping"].figure
        assert any(c.get_hatch() for axes in figure.axes for c in axes.collections) == hatched
        assert any(line.get_marker() == "x" for axes in figure.axes for line in axes.get_lines()) == crossed


def test_a_scale_without_a_gate_has_none() -> None:
    scale = Scale(0.0, 2.0, ticks=(0.0, 1.0, 2.0))
    assert not scale.passes(np.array([0.0, 5.0])).any()
    assert scale([0.0, 1.0, 2.0, 9.0]).tolist() == [0.0, 0.5, 1.0, 1.0]


def test_grids_are_ordered_by_their_strength_at_the_studys_frequency() -> None:
    """Of nine grids the fifth is left out. 1 Ω and 1/345 H change places between 50 and 60 Hz."""
    known: Any = [SimpleNamespace(grid=Grid(R, 0.0)) for R in (0.1, 0.2, 0.3, 0.4, 1.0, 2.0, 3.0, 4.0)]
    coil: Any = SimpleNamespace(grid=Grid(0.0, 1.0 / 345.0))
    assert coil not in shown_cells([*known, coil], 2.0 * np.pi * 50.0)
    assert coil in shown_cells([*known, coil], 2.0 * np.pi * 60.0)
    assert len(shown_cells([*known, coil], 2.0 * np.pi * 60.0)) == 8
