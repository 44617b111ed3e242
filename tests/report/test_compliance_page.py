"""The page of a clause matrix: every row with its verdict, source and evidence, and nothing said twice differently."""

from __future__ import annotations

import functools
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compliance_documents import document, evidence, traces_of
from vsgdesign.campaigns.compliance.evidence import figures_of
from vsgdesign.campaigns.compliance.rows import FAIL, INFORMATIONAL, PASS, VERDICTS
from vsgdesign.report.compliance.answer import (
    below_headline,
    counts_answer,
    dc_side_suffices,
    headline,
    limits_table,
    strip,
)
from vsgdesign.report.compliance.arranged import LOOKS, Arranged, arrange, asked_words, value_words
from vsgdesign.report.compliance.figures import shown_signal
from vsgdesign.report.compliance.matrix import explore_command
from vsgdesign.report.compliance.page import terminal_blocks, write_page
from vsgdesign.report.page.blocks import Table

VOID = {"col", "meta", "input", "br", "link", "img", "path", "rect"}


@functools.cache
def made() -> dict[str, Any]:
    found = document(sizes=0)
    assert {row["verdict"] for row in found["rows"]} == set(VERDICTS)
    return found


@functools.cache
def arranged() -> Arranged:
    return arrange(made())


class Elements(HTMLParser):
    """Checks that every element is closed, and keeps ids, links and the text of each test."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[tuple[str, str | None]] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.texts: dict[str, str] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if found.get("id"):
            self.ids.append(str(found["id"]))
        if tag == "a":
            self.links.append(str(found["href"]))
        if tag not in VOID:
            self.open.append((tag, found.get("id")))

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        for tag, name in self.open:
            if tag == "tbody" and name:
                self.texts[name] = self.texts.get(name, "") + data


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compliance")
    for path in write_page(folder, made(), traces_of(made(), 400)):
        assert path.is_file()
    return folder


@pytest.fixture(scope="module")
def page(written: Path) -> str:
    return (written / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def elements(page: str) -> Elements:
    found = Elements()
    found.feed(page)
    assert not found.open
    return found


def test_every_test_is_there_once_with_each_controllers_verdict(elements: Elements) -> None:
    assert len(set(elements.ids)) == len(elements.ids)
    tests = list(arranged().tests())
    assert len(tests) * 3 == len(made()["rows"])
    for test in tests:
        words = elements.texts[test.anchor]
        for verdict in VERDICTS:
            rows = [row for row in test.known if row["verdict"] == verdict]
            reasons = [reason for reason in test.reasons if reason.verdict == verdict]
            assert words.count(f"{LOOKS[verdict].sign} {verdict}") == len(rows) + len(reasons), (test.test, verdict)
        assert test.network in words
        for line in test.lines:
            assert line.label in words
            assert all(value.words.replace("-", "−") in words for value in line.values if value is not None)


def test_every_link_leads_somewhere(elements: Elements, written: Path) -> None:
    files = {row["csv"] for row in made()["rows"]} | {"results.json", "report.pdf"}
    for link in elements.links:
        if link.startswith("#"):
            assert link[1:] in elements.ids, link
        else:
            assert link in files or (written / link).is_file(), link


def test_nothing_is_fetched(page: str) -> None:
    assert not re.search(r'(?:src|href)="(?:https?:)?//', page)
    assert "url(" not in page


def test_counts_are_those_of_the_summary() -> None:
    for suite in arranged().suites:
        for name, counts in zip(arranged().controllers, suite.counts, strict=True):
            said = next(one for one in made()["summary"] if (one["suite"], one["controller"]) == (suite.name, name))
            assert {verdict: said[verdict.replace(" ", "_")] for verdict in VERDICTS} == dict(counts.of)
    whole = [cell for row in counts_answer(arranged()).rows[:1] for cell in row.cells]
    failing = [
        sum(r["verdict"] == FAIL and r["controller"] == n for r in made()["rows"]) for n in arranged().controllers
    ]
    assert all(failing[:2])
    assert [cell.words.split()[0] for cell in whole[:2]] == [str(count) for count in failing[:2]]


def test_whose_limits_are_kept_is_said_everywhere(page: str) -> None:
    """ "28 pass" held against limits of this project alone, and nothing said so."""
    words = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    for suite in arranged().suites:
        for name, counts in zip(arranged().controllers, suite.counts, strict=True):
            passing = [row for row in made()["rows"] if (row["suite"], row["controller"]) == (suite.name, name)]
            passing = [row for row in passing if row["verdict"] == PASS]
            own = len(passing) if suite.name == "own" else 0
            limits = f"{len(passing) - own} against a limit of the source, {own} against a limit of ours"
            assert counts.limits == limits
            assert f"{name}: {len(passing)} pass: {limits}" in words
    ours = sum(row["verdict"] == PASS and row["suite"] == "own" for row in made()["rows"])
    assert words.count("pass (limit of ours)") == ours > 0
    first = next(counts for counts in arranged().counts)
    assert f"CVSG: {first.limits}" in words[: words.index("Clause matrix")]
    head = terminal_blocks(made() | {"timing_s": {}, "notes": []})[0]
    assert isinstance(head, Table)
    said = next(one for one in made()["summary"] if one["suite"] == "own")
    assert dict(zip(head.head, head.rows[made()["summary"].index(said)], strict=True))["of ours"] == str(said["pass"])


def test_tests_without_a_run_are_counted_apart() -> None:
    rows = [dict(row) for row in made()["rows"]]
    failing = [row for row in rows if row["verdict"] == FAIL and row["controller"] == "CVSG"]
    failing[0] |= {"csv": None, "status": "no rest"}
    found = arrange(made() | {"rows": rows})
    said = below_headline(found)[1]
    never, lacks = (found.counts[0].of[verdict] for verdict in ("impossible", "not applicable"))
    assert said.startswith(
        f"Tests without a run: CVSG: 1 could not begin, {lacks} not applicable, {never} impossible; "
    )
    assert said.endswith("What could not begin fails, because the converter has no rest before the test.")
    assert "1 could not begin" in counts_answer(found).rows[0].cells[0].detail


def test_a_limit_that_no_lost_run_fails_does_not_separate() -> None:
    limit = {"suite": "own", "measure": "response_i_ms", "label": "response", "at_least": None, "at_most": 10.0}
    limit |= {"envelope": None, "unit": "ms", "ours": False, "limit_of": "source", "judged": 36, "lost": 12}
    cases = {(0, 12): "It does not separate", (9, 3): "It separates."}
    for (failed, kept), words in cases.items():
        table = limits_table(made() | {"limits": [limit | {"failed": failed, "lost_kept": kept}]})
        assert str(table.rows[0][-1]).startswith(words)
        assert table.rows[0][2:6] == ("≤ 10 ms", "the source", f"{failed} of 36", f"{kept} of 12")


def test_informational_is_never_counted_as_pass() -> None:
    rows = [row | {"verdict": "informational"} for row in made()["rows"]]
    found = arrange(made() | {"rows": rows})
    assert headline(found) == "No test was judged: nothing was asked for, or nothing was possible."
    assert all(cell.words == "nothing judged" for row in counts_answer(found).rows for cell in row.cells)


def test_the_headline_of_one_controller() -> None:
    one = document(controllers=1)
    rows = []
    for row in one["rows"]:
        checks = [check | {"verdict": PASS} if check["verdict"] == FAIL else check for check in row["checks"]]
        rows.append(row | {"verdict": PASS, "checks": checks} if row["verdict"] == FAIL else row)
    judged = sum(row["verdict"] == PASS for row in rows)
    own = sum(row["verdict"] == PASS and row["suite"] == "own" for row in rows)
    assert headline(arrange(one | {"rows": rows})) == (
        f"CVSG passes all {judged} tests that were judged: {judged - own} against a limit of the source, "
        f"{own} against a limit of ours."
    )


def test_a_strip_has_a_full_stroke_for_every_failing_test() -> None:
    sketch = strip(arranged(), 0)
    full: list[Any] = [part for part in sketch.parts if part.points[:, 1].min() == 0.0]  # type: ignore[union-attr]
    step = min(float(part.points[:, 0].max() - part.points[:, 0].min()) for part in full)
    found = sum(round(float(part.points[:, 0].max() - part.points[:, 0].min()) / step) for part in full)
    assert found == arranged().counts[0].of[FAIL]


def test_what_is_asked_and_found_in_words() -> None:
    check = {"unit": "pu", "at_least": None, "at_most": 1.2, "envelope": None, "value": -0.5, "why": ""}
    check |= {"measure": "peak", "verdict": PASS}
    assert asked_words(check) == "≤ 1.2 pu"
    assert asked_words(check | {"at_least": 0.9}) == "0.9 to 1.2 pu"
    assert asked_words(check | {"at_most": None}) == "not asked for"
    assert asked_words(check | {"verdict": INFORMATIONAL}) == "≤ 1.2 pu, not judged"
    assert asked_words(check | {"ours": True}) == "≤ 1.2 pu, a limit of ours"
    inside = check | {"at_most": 0.0, "envelope": "ramp", "value": 0.0}
    assert (asked_words(inside), value_words(inside)) == ("inside its envelope", "inside")
    assert value_words(inside | {"value": 0.25, "verdict": FAIL}) == "0.250 pu outside"
    lived = check | {"measure": "survived", "unit": "", "at_least": 1.0, "at_most": None, "value": 0.0}
    assert (asked_words(lived), value_words(lived)) == ("yes", "no")
    judged = {"settling_time_s": 0.5, "deadline_s": 1.2}
    assert value_words(lived | {"value": 1.0}, judged) == "yes (T 0.500 s, deadline 1.20 s)"
    heavy = value_words(lived | {"value": 1.0}, judged | {"peak_pu": 2.5})
    assert heavy == "yes (T 0.500 s, deadline 1.20 s); 2.50 pu, more than hardware carries"
    assert value_words(lived, {"peak_pu": 2.5}) == "no"
    assert value_words(check) == "−0.500 pu"
    assert value_words(check | {"value": None, "why": "it diverged"}) == "not known: it diverged"
    assert value_words(check | {"unit": "1", "value": 0.0}) == "0"
    assert value_words(check | {"unit": "s", "value": 2.5, "plus_minus": 0.08}) == "2.50 ± 0.08 s"
    assert value_words(check | {"unit": "s", "value": 2.5, "plus_minus": 0.001}) == "2.50 s"


def test_the_explorers_command_survives_a_shell() -> None:
    import shlex

    row = next(row for row in made()["rows"] if row["explore"])
    words = shlex.split(explore_command(made(), row))
    assert words == ["vsgdesign", "explore", "my study.toml", "--state", row["explore"]]


def test_two_pages_of_one_result_are_the_same(written: Path, tmp_path: Path) -> None:
    files = write_page(tmp_path, made(), traces_of(made(), 400))
    for path in files:
        assert path.read_bytes() == (written / path.relative_to(tmp_path)).read_bytes(), path.name


def test_a_missing_trace_is_said(tmp_path: Path) -> None:
    write_page(tmp_path, made(), {})
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "runs are missing, so their curves are not drawn" in text
    assert "This test has no figure" in text


def test_a_drawn_current_is_the_largest_of_five_milliseconds() -> None:
    rng = np.random.default_rng(2)
    t = np.concatenate([np.arange(0.0, 0.1, 5e-4), np.arange(0.1, 1.0, 5e-3)])
    row = next(row for row in made()["rows"] if row["csv"])
    trace = replace(evidence(row, len(t)).trace, t_s=t, i_phase_pu=rng.random(len(t)), P_pu=rng.random(len(t)))
    drawn = shown_signal(trace, "i_phase_pu")
    for k in (0, 3, 50, 199, 200, 260, len(t) - 1):
        window = (t > t[k] - 5e-3 + 1e-9) & (t <= t[k])
        assert drawn[k] == trace.i_phase_pu[window].max()
    assert shown_signal(trace, "P_pu") is trace.P_pu


def test_a_reason_that_is_printed_below_is_not_said_twice() -> None:
    check = {"value": None, "why": "it slipped", "unit": "s", "measure": "recovery_s"}
    assert value_words(check, {"why": "slipped: it slipped at 0.4 s"}) == "not known"
    assert value_words(check, {"why": "another reason"}) == "not known: it slipped"


def test_only_so_many_failing_tests_have_a_figure_and_the_page_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vsgdesign.campaigns.compliance.evidence.MOST_FIGURES", 1)
    monkeypatch.setattr("vsgdesign.report.compliance.page.MOST_FIGURES", 1)
    monkeypatch.setattr("vsgdesign.report.compliance.figures.MOST_FIGURES", 1)
    write_page(tmp_path, made(), traces_of(made(), 200))
    failing = [test for test in arranged().tests() if test.fails]
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"{len(failing) - 1} failing tests have no figure, because at most 1 are drawn" in text
    assert [str(path.relative_to(tmp_path)) for path in (tmp_path / "figures").iterdir()] == list(
        figures_of(made()["rows"]).values()
    )


def test_a_source_without_an_edition_has_no_comma_of_one(tmp_path: Path) -> None:
    """A suite of the user's gives its title alone: "My feeder, ; confidence: user" stood on the page."""
    text = re.sub(r'"edition": "[^"]*"', '"edition": ""', json.dumps(made()))
    plain = json.loads(text)
    write_page(tmp_path, plain, traces_of(plain, 100))
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "; confidence: " in html
    assert ", ; confidence" not in html
    assert "</a> , " not in html


def test_whether_the_dc_side_suffices() -> None:
    """Blocked bridges, and powers that the source has no rest for, by controller; nothing of an ideal link."""
    why = {
        "blocked": "the dc link fell below V_low",
        "no rest": "before the test: dc: the bridge takes 9 kW, and …",
    }
    rows = [
        {"controller": name, "test": f"{name}{k}", "status": status, "why": why.get(status, "")}
        for name, statuses in (("A", ["survived", "slipped", ""]), ("B", ["survived", "blocked", "no rest", "no rest"]))
        for k, status in enumerate(statuses)
    ]
    rows[-1]["why"] = "before the test: the current limiter acts"
    assert dc_side_suffices({"converter": {"dc_source": None}, "rows": rows}) == []
    assert dc_side_suffices({"converter": {"dc_source": "battery"}, "rows": rows}) == [
        "A: the energy and power of the dc side suffice in all 2 tests that were run.",
        "B: the energy and power of the dc side do not suffice in 2 of 3 tests: B1; B2.",
    ]
