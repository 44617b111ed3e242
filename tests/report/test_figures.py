"""Figures: all there, well-formed, labelled with units, small, and the same on every run."""

from __future__ import annotations

import itertools
import pickle
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.mathtext import MathTextParser
from matplotlib.patches import Rectangle

from tests.report.layout import assert_apart
from vsgdesign.report.drawing import ticks
from vsgdesign.report.drawing.figures import compact, write_figure
from vsgdesign.report.drawing.style import look
from vsgdesign.report.drawing.time_axis import event_labels, time_unit
from vsgdesign.report.scenario.bode_figures import loops_on_grids
from vsgdesign.report.scenario.figures import all_figures, choose_zooms, signal_figure
from vsgdesign.report.scenario.signals import power_signals, signals
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import study_from_text

NAMES = ["active_power", "reactive_power", "voltage", "frequency", "grid_impedance", "gains", "bode_P"]
SVG = "{http://www.w3.org/2000/svg}"


def texts(path) -> list[str]:
    # Labels with symbols come glyph by glyph: white space says nothing.
    return [re.sub(r"\s", "", "".join(element.itertext())) for element in ET.parse(path).iter(f"{SVG}text")]


def test_every_figure_is_written_once_in_both_formats(made):
    assert [figure.name for figure in made.figures] == NAMES
    for figure in made.figures:
        assert figure.png.read_bytes().startswith(b"\x89PNG")
        assert ET.parse(figure.svg).getroot().tag == f"{SVG}svg"
        assert figure.svg.stat().st_size < 300_000


@pytest.mark.parametrize(
    ("name", "small", "large"),
    [
        ("active_power", ["Time [s]", "Active power [kW]"], ["Time [ms]", "Active power [MW]"]),
        ("reactive_power", ["Time [s]", "Reactive power [kvar]"], ["Time [ms]", "Reactive power [kvar]"]),
        ("voltage", ["Time [s]", "Voltage, phase rms [V]", "[pu]"], ["Voltage, phase rms [V]", "[pu]"]),
        ("frequency", ["Time [s]", "Frequency [Hz]"], ["Time [ms]", "Frequency [Hz]"]),
        ("grid_impedance", ["Time [s]", "[Ω]", "[mH]"], ["Time [ms]", "[mΩ]", "[µH]"]),
        ("gains", ["[rad/(s²·W)]", "[W·s/rad]", "[V/(s·var)]", "[var/V]"], ["[rad/(s²·W)]", "[var/V]"]),
        ("bode_P", ["Angular frequency [rad/s]", "Magnitude [dB]", "Phase [°]"], ["Magnitude [dB]", "Phase [°]"]),
    ],
)
def test_axes_have_labels_with_units(short, megawatt, name, small, large):
    for made, labels in ((short, small), (megawatt, large)):
        shown = " | ".join(texts(next(figure.svg for figure in made.figures if figure.name == name)))
        for label in labels:
            assert label.replace(" ", "") in shown, shown


def test_text_stays_text_of_at_least_seven_points(made):
    for figure in made.figures:
        sizes = [float(size) for size in re.findall(r"font(?:-size)?: (?:\w+ )*?([\d.]+)px", figure.svg.read_text())]
        families = re.findall(r"font-family: ([^;\"]+)", figure.svg.read_text())
        assert all(family.endswith("sans-serif") for family in families)
        # Indices of symbols may be smaller.
        assert len(sizes) > 5
        assert sorted(sizes)[len(sizes) // 3] >= 7.0
        assert all(size >= 4.8 for size in sizes)


def test_two_builds_are_identical_also_where_another_process_draws_one(short, tmp_path):
    """To draw files beside other work, figures are sent to worker processes."""
    for before, again in zip(short.figures, all_figures(short.result), strict=True):
        after = write_figure(pickle.loads(pickle.dumps(again)), tmp_path)  # noqa: S301
        assert before.svg.read_bytes() == after.svg.read_bytes(), before.name
        assert before.png.read_bytes() == after.png.read_bytes(), before.name


def test_formulas_that_are_kept_are_drawn_as_those_just_parsed(short, tmp_path, monkeypatch):
    """Ticks of decades are formulas: every figure's are parsed afresh here, and nothing of it stays outside."""
    before = MathTextParser.parse
    monkeypatch.setattr(ticks, "_parse", before)
    drawn = next(figure for figure in short.figures if figure.name == "bode_P")
    named = next(figure for figure in all_figures(short.result, None) if figure.name == "bode_P")
    afresh = write_figure(named, tmp_path)
    assert afresh.svg.read_bytes() == drawn.svg.read_bytes()
    assert afresh.png.read_bytes() == drawn.png.read_bytes()
    monkeypatch.undo()
    with look():
        assert MathTextParser.parse is not before
    assert MathTextParser.parse is before


def test_a_users_settings_do_not_show_and_stay_as_they_were(short):
    signal = next(signals(short.result))
    with matplotlib.rc_context({"font.size": 30.0, "axes.facecolor": "red", "lines.linewidth": 9.0}):
        before = dict(matplotlib.rcParams)
        axes = signal_figure(short.result, signal).figure.axes[0]
        assert dict(matplotlib.rcParams) == before
        assert axes.get_facecolor() == (1.0, 1.0, 1.0, 1.0)
        assert axes.xaxis.label.get_fontsize() == 8.0


def test_curves_keep_the_peaks_of_the_signal(short):
    signal = next(signals(short.result))
    axes = signal_figure(short.result, signal).figure.axes[0]
    drawn = [y for line in axes.get_lines() if len(y := np.asarray(line.get_ydata())) > 50]
    assert len(drawn) == 2
    for line, controller in zip(drawn, short.result.controllers, strict=True):
        power = controller.series["P_pcc"] / 1e3
        assert np.max(line) == np.max(power)
        assert np.min(line) == np.min(power)


def heights_of_bands(axes: Axes) -> list[float]:
    bands = []
    for patch in axes.patches:
        assert isinstance(patch, Rectangle)
        bands.append(patch.get_height())
    return bands


def test_own_steps_are_enlarged_with_their_band(short):
    P, Q, *_ = signals(short.result)
    assert [zoom.event.t_s for zoom in choose_zooms(short.result, P) if zoom.is_step] == [1.0]
    assert [zoom.event.t_s for zoom in choose_zooms(short.result, Q) if zoom.is_step] == [6.0]
    first, *panels = signal_figure(short.result, P).figure.axes
    # 2 % of the 500 W step to either side, in kW; both controllers end at the same power.
    assert heights_of_bands(panels[0]) == pytest.approx([0.02], rel=1e-3)
    assert not [height for height in heights_of_bands(first) if height == pytest.approx(0.02)]


def test_ripple_is_drawn_light_under_its_mean_with_pwm_only(short, megawatt):
    for made, envelopes in ((short, 0), (megawatt, 1)):
        signal = next(signals(made.result))
        named = signal_figure(made.result, signal)
        fills = [c for c in named.figure.axes[0].collections if type(c).__name__ == "FillBetweenPolyCollection"]
        assert len(fills) == envelopes
        assert ("mean over the preceding cycle" in named.caption) == bool(envelopes)


def test_the_caption_says_what_the_droop_adds_to_a_reference(short):
    """A soft droop of Q keeps it far from its reference, and the step is met all the same."""
    captions = [signal_figure(short.result, signal).caption for signal in power_signals(short.result)]
    assert "D_p·(ω_n − ω_g)" in captions[0]
    assert "D_q·(V_n − V)" in captions[1]


def test_no_axes_or_legends_overlap(made):
    for signal in signals(made.result):
        assert_apart(signal_figure(made.result, signal).figure, 1.0, signal.name)


def test_scheduled_loops_are_alike_on_all_grids_and_fixed_ones_are_not(short):
    fixed, scheduled = (loops_on_grids(short.result, controller) for controller in short.result.controllers)
    first, second = (loop.margins.crossover_rad_s for loop in scheduled[:2])
    assert first == pytest.approx(second, rel=1e-9)
    first, second = (loop.margins.crossover_rad_s for loop in fixed[:2])
    assert first is not None
    assert second is not None
    assert second > 2.0 * first
    for loop in (*fixed, *scheduled):
        at_crossover = loop.response(np.array([loop.margins.crossover_rad_s]))[0]
        assert abs(at_crossover) == pytest.approx(1.0, rel=1e-6)
        assert np.degrees(np.angle(at_crossover)) + 180.0 == pytest.approx(loop.margins.phase_margin_deg, abs=1e-6)


def test_labels_never_overlap_and_turn_to_numbers_without_room():
    few = event_labels([(10.0 * k, f"event {k}") for k in range(6)], 60.0, 6.0)
    assert not few.numbered
    assert few.rows == 1
    many = event_labels([(2.0 * k, f"a rather long event {k}") for k in range(30)], 60.0, 6.0)
    assert many.numbered
    assert [label.text for label in many.labels] == [str(k + 1) for k in range(30)]
    for row in range(many.rows):
        begins = [label.x_in for label in many.labels if label.row == row]
        assert all(b - a > 0.1 for a, b in itertools.pairwise(begins))


@pytest.mark.parametrize(("span", "symbol"), [(0.05, "ms"), (0.5, "s"), (600.0, "s"), (3600.0, "min")])
def test_time_units_fit_the_span(span, symbol):
    assert time_unit(span).symbol == symbol


def test_compacting_touches_coordinates_only():
    svg = '<path id="m12.34567" d="M 1.23456 -7.00049 \nL 2 3.5 "/><text x="1.23456">0.123456</text>'
    assert compact(svg) == '<path id="m12.34567" d="M 1.23 -7 L 2 3.5"/><text x="1.23456">0.123456</text>'


def test_importing_the_room_loads_no_heavy_library():
    code = "import sys, vsgdesign.report; print([m for m in ('matplotlib', 'jinja2', 'control') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_loop_without_a_corner_has_none() -> None:
    """Gains without sense may leave a constant."""
    study = study_from_text("""
base = "case:hoang2025_5kva"
simulation = { duration = "0.02 s", P_ref = "1 kW", Q_ref = "0 var" }
controllers = [{ name = "a", kind = "fixed" }]
""")
    result = run_scenario(study)
    loop = loops_on_grids(result, result.controllers[0])[0]
    assert loop.corner_rad_s > 0.0
    assert replace(loop, denominator=np.array([0.0, 0.0, 1.0])).corner_rad_s == 0.0
