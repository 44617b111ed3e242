"""The stability page: eight parts, every verdict, links that lead somewhere, and nothing from outside."""

from __future__ import annotations

import html
import json
import re
from urllib.parse import unquote

import pytest

from tests.report.stability_cases import TEXTS, Made, assessed, case
from tests.report.test_page import checked
from vsgdesign.linear.stability.verdict import OWN, counted_rows
from vsgdesign.report.drawing.figures import ExplorerFile
from vsgdesign.report.page.html import print_html
from vsgdesign.report.stability.page import csv_files, stability_page


@pytest.fixture(scope="session", params=sorted(TEXTS))
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    return case(request.param, tmp_path_factory)


@pytest.fixture(scope="session")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return case("plain", tmp_path_factory)


def words(cell: str) -> str:
    """Text without white space and without the marks of subscripts and minus signs."""
    return re.sub(r"[\s_]", "", cell).replace("−", "-")


def test_well_formed_and_nothing_from_outside(made: Made) -> None:
    page = checked(made.page)
    assert page.faults == []
    assert page.open == []
    assert not {"link", "img", "iframe", "object"} & set(page.tags)
    assert len(page.ids) == len(set(page.ids))
    files = {name for name, _ in csv_files(made.result)}
    for target in page.targets:
        inside = target.startswith("data:") or (target.startswith("#") and target[1:] in page.ids)
        assert inside or unquote(target) in files, target[:60]
    text = made.text
    assert "http" not in text.replace("http-equiv", "")
    assert "src=" not in text
    assert "@import" not in text
    assert text.count("<script") == 2
    assert "<short>" not in text


def test_eight_parts_each_with_something_to_say(made: Made) -> None:
    parts = re.split(r'<h2 id="part-(\d)">', made.text)
    assert parts[1::2] == list("12345678")
    for number, part in zip(parts[1::2], parts[2::2], strict=True):
        said = re.sub(r"<svg.*?</svg>|<[^>]+>", " ", part, flags=re.DOTALL)
        assert len(said.split()) > 20, number


def test_every_verdict_is_a_row(made: Made) -> None:
    shown = [[words(cell) for cell in row] for row in checked(made.page).rows]
    assert made.result.verdicts
    for v in made.result.verdicts:
        row = (
            v.controller,
            v.source,
            v.confidence or "ours",
            v.test,
            v.value or "–",
            v.limit or "–",
            v.verdict,
            v.evidence,
        )
        assert [words(cell) for cell in row] in shown, row
    # Ours are marked as ours, and what is of others never passes.
    for v in made.result.verdicts:
        assert (v.source == OWN) == (v.confidence == "")
        assert v.source == OWN or v.verdict in ("informational", "not assessed")


def test_every_figure_stands_in_its_part_with_a_way_to_read_it(made: Made) -> None:
    parts = re.split(r'<h2 id="part-(\d)">', made.text)
    assert made.text.count('<figure class="drawing"') == len(made.figures)
    for figure in made.figures:
        # The first one belongs to the answer, which stands before all parts.
        part = figure.part if figure is not made.figures[0] else 0
        assert f'id="figure-{figure.name}"' in parts[2 * part]
        assert figure.caption.startswith("How to read: ")


def test_the_verdict_counts_gates_and_names_the_worst(plain: Made) -> None:
    verdict = re.search(r'<section class="verdict">\s*<p>(.*?)</p>\s*</section>', plain.text, re.DOTALL)
    assert verdict is not None
    for a in plain.result.assessments:
        own = [v for v in plain.result.verdicts if v.controller == a.spec.name and v.source == OWN]
        met = sum(v.verdict == "pass" for v in own)
        assert f"{a.spec.name} ({a.spec.kind} gains) meets {met} of its {len(own)} gates" in verdict.group(1)
        stable, counted = int(counted_rows(a.full_order).stable.sum()), int(a.full_order.counted.sum())
        assert f"{stable} of {counted} analysed cells" in verdict[1]
    assert "no grid code asks for it" in html.unescape(verdict.group(1))
    assert " Hz (s = " in verdict.group(1)


def test_the_answer_on_top_counts_the_rows_of_the_clause_matrix(made: Made) -> None:
    """Counted again from the cells of the matrix on the page."""
    rows = [[words(cell) for cell in row] for row in checked(made.page).rows]
    for a in made.result.assessments:
        name = words(a.spec.name)
        matrix = [row for row in rows if len(row) == 8 and row[0] == name and row[2] == "ours"]
        top = next(row for row in rows if row[0] == name and row not in matrix)
        passed, failed = (sum(row[6] == verdict for row in matrix) for verdict in ("pass", "fail"))
        if passed + failed == 0:
            assert top[1].startswith("?notassessed")
        elif failed:
            assert top[1].startswith(f"✗missed{failed}of{passed + failed}")
        else:
            assert top[1].startswith(f"✓met{passed}of{passed}")
        full_order = [row for row in matrix if row[3].endswith("(fullorder)") or row[3].startswith("2%settling")]
        for shown, row in zip(top[2:], full_order, strict=True):
            assert shown.startswith({"pass": "✓met", "fail": "✗missed"}.get(row[6], "?notassessed"))
            assert row[4].partition("at")[0] in shown or row[6] == "notassessed"
    good = [a.spec.name for a in made.result.assessments if gates_met(made, a.spec.name)]
    headline = re.search(r'<p class="headline">(.*?)</p>', made.text)
    assert headline is not None
    missed = any(v.verdict == "fail" for v in made.result.verdicts if v.source == OWN)
    assert ("No controller" in headline[1] or "does not meet" in headline[1]) == (not good and missed)
    assert ("could not be assessed" in headline[1]) == (not good and not missed)


def gates_met(made: Made, name: str) -> bool:
    return all(v.verdict == "pass" for v in made.result.verdicts if v.controller == name and v.source == OWN)


def test_identity(plain: Made) -> None:
    study, text = plain.result.study, plain.text
    for said in (study.hash, "7.26 Ω", "314.16 rad/s", "5 kVA", "50 µs", "Version of numpy"):
        assert said in text
    for pair in plain.result.evidence.values():
        for e in pair:
            assert f"{100.0 * e.error('full_order'):.2g}" in text


ABSENT = {
    "plain": ["Envelopes of grid-code tests", "peak currents are not assessed"],
    "odd": ["the worst of those of its 4 operating points", "No small step was simulated"],
    "unstable": [
        "No controller of the study is scheduled",
        "an unstable mode",
        "the full-order model is unstable there",
    ],
    "faulty": [
        "none of its 4 cells could be analysed within the limits",
        "No grid of the scenario could be analysed in detail",
        "no cell that is asked for could be analysed within the converter's limits",
        "No eigenvalue could be drawn",
    ],
}


def test_what_is_not_there_is_said(made: Made) -> None:
    name = next(name for name in TEXTS if assessed(name) is made.result)
    for said in ABSENT[name]:
        assert said in html.unescape(made.text), said


def test_nothing_analysed_passes_nothing() -> None:
    verdicts = assessed("faulty").verdicts
    assert {v.verdict for v in verdicts} <= {"not assessed", "informational"}
    assert {v.verdict for v in verdicts if v.source == OWN} == {"not assessed"}


def test_the_readout_knows_every_cell(plain: Made) -> None:
    data = json.loads(plain.text.split('id="hover-data">')[1].split("</script>")[0])
    for index, a in enumerate(plain.result.assessments):
        for field in (a.reduced, a.full_order):
            entry = data[f"map.{index}.{field.model}"]
            assert len(entry["texts"]) == len(field.faults) == entry["per"] * 4
            assert entry["values"] == [[2.0, 8.0], [1.0, 5.0]]
            for k, flat in enumerate(field.analysed):
                assert f"ζ {field.table.least_damping[k]:.3g}" in entry["texts"][flat]
    keys = re.findall(r'id="[^"]+-hover\.([^"]+)"', plain.text)
    assert keys
    assert all(key in data or key.rpartition(".")[0] in data for key in keys)


def test_the_explorer_is_a_part_of_its_own(plain: Made, tmp_path) -> None:
    page = stability_page(plain.result, plain.figures, ExplorerFile("explorer.html", 1_620_000))
    text = print_html(page, tmp_path / "page.html").read_text(encoding="utf-8")
    parts = re.split(r'<h2 id="part-(\d)">|<h2 id="explorer">', text)
    assert parts[1::2] == [*"1234567", None, "9"]
    assert text.count("src=") == 1  # nothing else is fetched
    assert '<iframe src="explorer.html" title="Explorer: Small, &lt;short&gt; &amp; sweet"' in parts[16]
    assert "(1.6 MB)" in parts[16]
    assert "Hold the gains" in parts[16]
    assert set(re.findall(r'href="#(part-\d)"', text)) == {f"part-{k}" for k in (*range(1, 8), 9)}
    assert text.count('href="#explorer"') == 2  # at the top, and in the contents


def test_why_there_is_no_explorer_is_said(plain: Made, tmp_path) -> None:
    why = "P must be a number between -10 and 10 kW, not 12."
    page = stability_page(plain.result, plain.figures, ExplorerFile(why=why))
    text = print_html(page, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<iframe" not in text
    assert "There is no explorer. P must be a number between −10 and 10 kW, not 12." in text
    assert "you can drag" not in text


def test_two_builds_are_identical(plain: Made, tmp_path) -> None:
    again = print_html(stability_page(plain.result, plain.figures), tmp_path / "again.html")
    assert again.read_bytes() == plain.page.read_bytes()
