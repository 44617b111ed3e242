"""A gain table's figures and page: which there are, that they are readable, and that they say what the table says."""

from __future__ import annotations

import functools
import itertools
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from tests.gain_tables import table
from tests.report.layout import assert_apart, write_svg
from vsgdesign.artifacts import GainTable, read_table_file
from vsgdesign.artifacts.measured_errors import shipped_errors
from vsgdesign.linear.stability.gain_table import check_table, nominal_margins
from vsgdesign.linear.stability.table_claims import limit_of
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure, write_all
from vsgdesign.report.drawing.panels import surface_scale
from vsgdesign.report.gain_table.maps import varies
from vsgdesign.report.gain_table.overview import stiffness, table_answer, table_headline
from vsgdesign.report.gain_table.page import margins_table, table_figures, table_page, verdict_of
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.html import print_html
from vsgdesign.verbs.pipeline.table import report_table

UNIT = re.compile(r"\[[^\]]+\]$")
SPECIFICATION = {"aim": "settling", "settling_time": 1.05, "overshoot": 0.01, "disk_margin": 1.2, "damping_ratio": 0.5}


@functools.cache
def rich() -> GainTable:
    """Everything that a table may have: all statuses, constraints, worst margins, a certificate."""
    made = table(
        scr=(0.4, 2.0, 8.0),
        x_over_r=(0.3, 1.0, 20.0),
        specification=SPECIFICATION,
        parameters={"k_1": np.linspace(14.0, 17.0, 9).reshape(3, 3)},
        certificate={
            "proof": "gap-free",
            "decay": 2.1,
            "region": {"scr": [2.0, 8.0], "x_over_r": [0.5, 20.0]},
            "P": [[1.0]],
        },
        provenance={"vsgdesign": "0.1.0"},
    )
    assert not made.valid.all()
    margins = nominal_margins(made)
    margins["worst_overshoot_P_pct"] = 1.3 * margins["overshoot_P_pct"]
    margins["worst_differential_decay_1_s"] = np.where(made.valid, 3.1, np.nan)
    margins["mine"] = np.where(made.valid, 3.0, np.nan)
    status, active = made.status.copy(), made.active.astype("U20")
    status[1, 1], active[1, 1], active[2, 0] = "relaxed", "overshoot", "disk margin"
    price = np.where(made.valid, np.arange(9.0).reshape(3, 3), np.nan)
    return replace(made, margins=margins, status=status, active=active, price=price)


def test_the_page_shows_the_slope_of_the_power_at_the_rest_of_each_node() -> None:
    """dP/dδ from a difference of complex powers, over 3VV_g/|Z|; the least one is at the import of a resistive grid."""
    made = rich()
    base, (at_design, least) = made.base, stiffness(made)
    Z_base = 3.0 * base.V_rated_rms**2 / base.S_rated
    assert base.scr_basis == "impedance"
    places = np.argwhere(np.isfinite(at_design))
    assert 3 < len(places) < at_design.size
    for row, column in places:
        scr, x_over_r = made.scr[row], made.x_over_r[column]
        Z = Z_base / scr * np.exp(1j * np.arctan(x_over_r)) + complex(base.R_2, base.omega_n * base.L_2)
        slopes = []
        for P, Q in ((made.P_design, made.Q_design), *itertools.product(made.validity.P, made.validity.Q)):
            v = complex(base.V_g_rms)
            for _ in range(500):  # the fixed point is the root of high voltage
                v = base.V_g_rms + Z * (complex(P, Q) / (3.0 * v)).conjugate()
            power = [3.0 * (u * ((u - base.V_g_rms) / Z).conjugate()).real for u in (v, v * np.exp(1e-6j))]
            slope = (power[1] - power[0]) / 1e-6 * abs(Z) / (3.0 * abs(v) * base.V_g_rms)
            sound = 3.0 * abs(v) ** 2 >= 1.3 * abs(complex(P, Q) * Z)
            slopes.append(slope if sound and made.validity.V_rms[0] <= abs(v) <= made.validity.V_rms[1] else np.inf)
        assert at_design[row, column] == pytest.approx(slopes[0], rel=1e-4)
        lowest = min(slopes[1:])
        assert (
            np.isnan(least[row, column]) if np.isinf(lowest) else least[row, column] == pytest.approx(lowest, rel=1e-4)
        )
    assert np.isnan(at_design[0, 0])
    (shown,) = [one for one in table_page(made).blocks if isinstance(one, Table) and "dP/dδ" in one.title]
    assert shown.rows[0][1] == "–"
    assert float(shown.rows[2][3].split()[0]) == pytest.approx(at_design[2, 2], rel=0.05)


@functools.cache
def bare() -> GainTable:
    """The least that a table can be, unstable at X/R 0.3."""
    made = table("published", scr=(2.0, 8.0), x_over_r=(0.3, 1.0))
    return replace(made, margins={name: nominal_margins(made)[name] for name in ("damping_power_loops", "decay_1_s")})


@functools.cache
def drawn(name: str) -> dict[str, NamedFigure]:
    return {figure.name: figure for figure in table_figures({"rich": rich, "bare": bare}[name]())}


def test_which_figures_there_are() -> None:
    always = {"table_active", "table_stale_damping", "table_stale_disk_margin"}
    assert set(drawn("rich")) == always | {
        "table_overshoot_P_pct",
        "table_settling_P_s",
        "table_overshoot_Q_pct",
        "table_settling_Q_s",
        "table_differential_decay_1_s",
        "table_mine",
        "table_disk_margin_output",
        "table_disk_margin_input",
        "table_damping_power_loops",
        "table_decay_1_s",
        "table_H_s",
        "table_parameters",
        "table_gains_1",
        "table_gains_2",
        "table_price",
        "table_certificate",
    }
    assert set(drawn("bare")) == always | {"table_damping_power_loops", "table_decay_1_s", "table_gains"}


@pytest.mark.parametrize("name", ["rich", "bare"])
def test_every_axis_has_a_unit_and_nothing_overlaps(name: str) -> None:
    for named in drawn(name).values():
        figure = named.figure
        labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
        assert labels
        assert all(UNIT.search(label) for label in labels), (named.name, labels)
        assert_apart(figure, 1.5, named.name)


def legend_of(name: str, figure: str) -> list[str]:
    (legend,) = drawn(name)[figure].figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_the_constraint_map_counts_its_cells() -> None:
    valid, outside = int(rich().valid.sum()), int((~rich().valid).sum())
    assert legend_of("rich", "table_active") == [
        "disk margin (1)",
        "overshoot (1)",
        f"no constraint active ({valid - 2})",
        "hatched: a promise was relaxed (1)",
        f"outside ({outside})",
    ]
    assert legend_of("bare", "table_active") == ["no constraint active (4)"]


def test_the_certified_region_is_drawn_where_it_is() -> None:
    axes = drawn("rich")["table_certificate"].figure.axes[0]
    patch = axes.patches[0]
    assert isinstance(patch, Rectangle)
    region = patch.get_bbox()
    assert (region.x0, region.x1, region.y0, region.y1) == pytest.approx((2.0, 8.0, 0.5, 20.0))
    assert "certified: decay ≥ 2.1 1/s" in legend_of("rich", "table_certificate")


def test_what_is_constant_is_said_not_drawn() -> None:
    assert "d_1 = 6.6, k_2 = 4, q = 0" in drawn("rich")["table_parameters"].caption
    assert "D_p = 318.3" in drawn("rich")["table_gains_1"].caption
    assert not varies(np.array([[1.0, np.nan], [1.0, 1.0 + 1e-12]]))
    assert varies(np.array([[1.0, 2.0]]))
    assert not varies(np.array([[np.nan]]))


def test_limits_come_from_the_specification() -> None:
    assert limit_of(rich(), "overshoot_P_pct") == 1.0
    assert limit_of(rich(), "settling_Q_s") == 1.05
    assert limit_of(rich(), "H_s") is None
    assert limit_of(bare(), "disk_margin_output") is None
    inertia = table(law="inertia", specification=SPECIFICATION)
    assert limit_of(inertia, "settling_P_s") is None
    assert limit_of(inertia, "damping_power_loops") == 0.5
    asked = {row[0]: row[1] for row in margins_table(rich()).rows}
    assert asked["Overshoot of P [%]"] == "≤ 1"
    assert asked["Disk margin at the output [1]"] == "≥ 1.2"


def test_a_scale_without_a_gate_spans_the_values() -> None:
    scale = surface_scale(np.array([1e-4, 1e-2, np.nan]))
    assert (scale.low, scale.high, scale.log) == (1e-4, 1e-2, True)
    assert surface_scale(np.array([-1.0, 3.0])).log is False
    same = surface_scale(np.array([2.0, 2.0]))
    assert same.low < 2.0 < same.high


@pytest.fixture(scope="session")
def bare_figures(tmp_path_factory: pytest.TempPathFactory) -> list[WrittenFigure]:
    """The figures of one table on disk, once for all tests that read them."""
    return write_all(table_figures(bare(), shipped_errors()), tmp_path_factory.mktemp("bare"))


def test_files_are_well_formed(bare_figures: list[WrittenFigure]) -> None:
    for figure in bare_figures:
        assert ET.fromstring(figure.svg.read_text(encoding="utf-8").encode()).tag.endswith("svg")


class Page(HTMLParser):
    """Ids, headings' order and anything that would be fetched."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.fetched: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:  # noqa: ARG002
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href") and not (value or "").startswith(("#", "data:")):
                self.fetched.append(value or "")


@pytest.mark.parametrize("name", ["rich", "bare"])
def test_the_page_has_everything_and_fetches_nothing(
    tmp_path: Path, bare_figures: list[WrittenFigure], name: str
) -> None:
    made = {"rich": rich, "bare": bare}[name]()
    figures = [write_svg(one, tmp_path) for one in drawn("rich").values()] if name == "rich" else bare_figures
    text = print_html(table_page(made, figures), tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.fetched == []
    assert len(page.ids) == len(set(page.ids))
    assert [i for i in page.ids if i.startswith("part-")] == [f"part-{k}" for k in range(1, 8)]
    assert [f"figure-{figure.name}" in page.ids for figure in figures] == [True] * len(figures)
    assert made.sha256 in text
    assert ("gap-free" in text) == (name == "rich")
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL).lower().split()


def test_the_verdict_counts() -> None:
    none = "There is no certificate: no proof was made for this table."
    assert verdict_of(bare()) == f"4 of 4 cells keep every promise of the specification. {none}"
    text = verdict_of(rich())
    assert f"{int((rich().status == 'met').sum())} of 9 cells" in text
    assert "In 1 a promise is relaxed" in text
    assert "Certified, gap-free" in text


def test_the_answer_on_top_says_what_the_tables_say() -> None:
    verdicts, worst = table_answer(rich())
    (row,) = verdicts.rows
    assert [(cell.mark, cell.words) for cell in row.cells] == [
        ("missed", "7 of 9 met"),
        ("open", "not looked at"),
        ("met", "certified, gap-free"),
        ("open", "not verified"),
    ]
    # The worst values are those of the table of margins below: its least or its largest of the box.
    below = {row[0].partition(" [")[0]: row for row in margins_table(rich()).rows}
    for title, cell in zip(worst.head, worst.rows[0].cells, strict=True):
        _, asked, *ranges = below[title]
        nominal, box = ranges[:3], ranges[3:]
        side = nominal if box[0] == "–" else box
        assert cell.words.split()[0] == (side[2] if asked[0] == "≤" else side[0])
        assert asked in cell.detail
    assert table_headline(rich()) == "7 of 9 cells keep every promise of the specification, and the table is certified."
    assert table_headline(bare()).startswith("All 4 cells keep every promise")


def test_a_failed_proof_a_broken_grid_and_a_broken_promise_come_first() -> None:
    failed = rich().certificate
    assert failed is not None
    family = {"promises": {"overshoot": {"broken": 3, "judged": 100}, "settling": {"broken": 0, "judged": 100}}}
    made = replace(
        rich(),
        certificate=replace(failed, certified=False),
        between={"points": 50, "outside": 5, "promised": 40, "broken": [{}, {}]},
        verification={"families": {"step": family}},
    )
    assert table_headline(made).startswith("Not certified: a proof was tried and failed.")
    cells = table_answer(made)[0].rows[0].cells
    assert [(cell.mark, cell.words) for cell in cells[1:]] == [
        ("missed", "2 of 40 broken"),
        ("missed", "failed"),
        ("missed", "1 of 2 promises broken"),
    ]


def test_names_are_escaped(tmp_path: Path) -> None:
    made = replace(bare(), name="<b>&", margins={})
    text = print_html(table_page(made), tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>&lt;b&gt;&amp;: gain table</h1>" in text
    assert "The table has no margins." in text


def test_a_folder_with_all_of_it(tmp_path: Path, bare_figures: list[WrittenFigure]) -> None:
    """Its figures are, byte by byte, those that were drawn before."""
    told: list[str] = []
    document = report_table(bare(), tmp_path / "out", progress=lambda what, _share: told.append(what))
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "report.html",
        "results.json",
        "table.json",
        "table.csv",
        "figures",
    }
    assert read_table_file(tmp_path / "out" / "table.json").sha256 == bare().sha256
    assert document["cells"] == {"met": 4, "relaxed": 0, "outside": 0}
    assert document["check"]["good"] is False  # unstable at X/R 0.3, and says so
    assert "draw figures" in told
    drawn = {path.name: path.read_bytes() for path in (tmp_path / "out" / "figures").iterdir()}
    assert drawn == {path.name: path.read_bytes() for figure in bare_figures for path in (figure.svg, figure.png)}


def test_a_page_of_a_file_that_contradicts_itself_says_so_first(tmp_path: Path) -> None:
    """And marks what no check computes again."""
    made = table(scr=(2.0, 8.0), x_over_r=(0.5, 3.0))
    figures = nominal_margins(made)
    settling = figures["settling_P_s"]
    honest, forged = (
        replace(made, margins=figures | {"worst_settling_P_s": worst}) for worst in (settling + 0.01, 0.5 * settling)
    )
    for one, first in ((honest, "All 4 cells keep every promise"), (forged, "The file contradicts itself: 1 fault")):
        checked = check_table(one)
        text = print_html(table_page(one, checked=checked), tmp_path / "report.html").read_text(encoding="utf-8")
        assert first in text
        assert all(f"<code>{fault.partition(' ')[0]}</code> is" in text for fault in checked.faults)
        assert "worst of the box (carried, not checked)" in text
    (fault,) = check_table(forged).faults
    assert fault.startswith("margins.worst_settling_P_s is 0.")
    assert f"better than {settling[0, 0]:.6g} of margins.settling_P_s at the design point" in fault
