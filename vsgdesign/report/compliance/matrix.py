"""The clause matrix as a browser shows it: groups that open and close, a filter, and the traces of failing tests."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any

from markupsafe import Markup

from vsgdesign.campaigns.compliance.evidence import figure_path
from vsgdesign.campaigns.compliance.rows import (
    FAIL,
    IMPOSSIBLE,
    INFORMATIONAL,
    PASS,
    VERDICTS,
    not_begun,
    passes_against,
)
from vsgdesign.report.compliance.answer import ABOUT_STRIPS, counts_bar, strip
from vsgdesign.report.compliance.arranged import LOOKS, WHOSE, Arranged, Group, Line, Reason, SuiteRows, Tested
from vsgdesign.report.compliance.figures import MOST_ON_PAPER, Drawn, TestFigure, dashes_of
from vsgdesign.report.drawing.flow import DIM, Cells, Flow, Said
from vsgdesign.report.drawing.paper import MARGIN, text_width
from vsgdesign.report.drawing.quantities import typeset
from vsgdesign.report.drawing.sketch import Sketch, filled, svg

MOST_OPEN = 30
"""A group with more tests is closed at first, also if one of them fails."""

_NOTHING = Markup("")


@dataclass(frozen=True)
class Matrix:
    """What the matrix is made of."""

    document: Mapping[str, Any]
    arranged: Arranged
    drawn: Drawn

    @property
    def columns(self) -> int:
        """Columns of its tables."""
        return len(self.arranged.controllers) + 3


def matrix_html(matrix: Matrix) -> Markup:
    """The lines' keys, the filter, and the tests of every suite."""
    keys = _joined(filled("<span>{} {}</span>", *one) for one in _keys(matrix.arranged))
    suites = [_suite(matrix, k, suite) for k, suite in enumerate(matrix.arranged.suites, start=1)]
    return filled('<p class="key">{}</p>\n{}\n{}', keys, _filter(), Markup("\n").join(suites))


def explore_command(document: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """The command that opens the explorer at the grid of a row; empty where the row has no state."""
    if not row.get("explore"):
        return ""
    file = document["study"].get("file") or f"{document['study']['name']}.toml"
    return f"vsgdesign explore {shlex.quote(file)} --state {shlex.quote(row['explore'])}"


def _joined(parts: Iterator[Markup] | Sequence[Markup]) -> Markup:
    return _NOTHING.join(parts)


def _keys(arranged: Arranged) -> Iterator[tuple[Sketch, str]]:
    """A sample of each controller's line."""
    for k, (name, colour) in enumerate(zip(arranged.controllers, arranged.colours, strict=True)):
        sketch = Sketch(28.0, 8.0, f"line of {name}", kind="key")
        sketch.line((0.0, 4.0), (28.0, 4.0), colour, 2.0, tuple(0.8 * length for length in dashes_of(k)))
        yield sketch, name


def _verdict(name: str, style: str = "v") -> Markup:
    look = LOOKS[name]
    sign = '<span class="{} {}"><span aria-hidden="true">{}</span> {}</span>'
    return filled(sign, style, look.style, look.sign, name)


def _filter() -> Markup:
    choice = '<label><input type="radio" name="show" value="{}"> {}</label>\n'
    choices = _joined([filled(choice, LOOKS[name].style, _verdict(name)) for name in VERDICTS])
    return filled(
        '<form id="filter" hidden>\n<span>Show</span>\n'
        '<label><input type="radio" name="show" value="" checked> all tests</label>\n{}'
        '<label class="words">with the words <input type="search" name="words" placeholder="SCR 2, +60 deg"></label>\n'
        "<output></output>\n</form>",
        choices,
    )


def _suite(matrix: Matrix, number: int, suite: SuiteRows) -> Markup:
    source, about = suite.source, filled("<p>{}</p>\n", typeset(suite.about)) if suite.about else _NOTHING
    said = _NOTHING
    if source:
        named = ", ".join(part for part in (source["document"], source["edition"]) if part)
        text = f"{named}; confidence: {source['confidence']}. {source.get('note') or ''}".strip()
        said = filled('<p class="source">{}</p>\n', typeset(text))
    passing = _passing(matrix.arranged, suite)
    about += filled('<p class="source">{}</p>\n', passing) if passing else _NOTHING
    groups = Markup("\n").join(_group(matrix, group) for group in suite.groups)
    head = filled('<section class="suite">\n<h3 id="suite-{}">{}</h3>\n', number, suite.title)
    return head + said + about + groups + Markup("\n</section>")


def _passing(arranged: Arranged, suite: SuiteRows) -> str:
    """Whose limits are kept by what passes in a suite, of each controller."""
    named = zip(arranged.controllers, suite.counts, strict=True)
    return "; ".join(f"{name}: {counts.of[PASS]} pass: {counts.limits}" for name, counts in named if counts.limits)


def _group(matrix: Matrix, group: Group) -> Markup:
    names = matrix.arranged.controllers
    counts = _joined(
        filled('<span class="of">{}{}</span>', name, _counts(of)) for name, of in zip(names, group.counts, strict=True)
    )
    opened = " open" if group.fails and len(group.tests) <= MOST_OPEN else ""
    figure = matrix.drawn.groups.get((group.suite, group.name))
    overlay = _NOTHING
    if figure is not None:
        plots = Markup("\n").join(svg(one, "plot") for one in figure.plots)
        overlay = filled(
            '<figure class="plots"><div class="row">{}</div><figcaption>{}</figcaption></figure>\n',
            plots,
            typeset(figure.caption),
        )
    head = _joined(
        filled('<th class="text">{}</th>', cell) for cell in ("Test, and what is measured", "Asked", *names, "Source")
    )
    tests = Markup("\n").join(_test(matrix, test) for test in group.tests)
    return filled(
        '<details class="group"{}>\n<summary><b>{}</b> <span class="counts">{}</span></summary>\n{}'
        '<div class="scroll">\n<table class="matrix" style="min-width:{}rem">\n'
        '<colgroup><col class="c-test"><col class="c-asked">{}<col class="c-source"></colgroup>\n'
        "<thead><tr>{}</tr></thead>\n{}\n</table>\n</div>\n</details>",
        opened,
        group.name,
        counts,
        overlay,
        26 + 7 * len(names),
        Markup("<col>") * len(names),
        head,
        tests,
    )


def _counts(counts: Any) -> Markup:
    one = ' <span class="v {}">{} {} {}</span>'
    found = [(LOOKS[name], counts.of[name], name) for name in VERDICTS if counts.of[name]]
    return _joined([filled(one, look.style, look.sign, count, name) for look, count, name in found])


def _test(matrix: Matrix, test: Tested) -> Markup:
    source = matrix.arranged.sources[test.reference - 1]
    known = ", ".join(part for part in (source["edition"], source["confidence"]) if part)
    head = filled(
        '<tr class="head"><th class="text" scope="rowgroup" colspan="2">{} <small>{}</small></th>\n',
        typeset(test.test),
        typeset(test.network),
    )
    head += _joined(filled('<td class="text">{}</td>', _ran(row)) for row in test.rows)
    head += filled(
        '\n<td class="text src"><a href="#source-{}">[{}]</a> {}</td></tr>\n', test.reference, test.reference, known
    )
    lines = Markup("\n").join(_line(line) for line in test.lines)
    why = [
        filled("{} ({}): {}", _verdict(one.verdict), ", ".join(one.controllers), typeset(one.text))
        for one in test.reasons
    ]
    if test.fails:
        why.append(_evidence(matrix, test))
    row = '\n<tr class="why"><td class="text" colspan="{}">{}</td></tr>'
    below = _joined([filled(row, matrix.columns, one) for one in why])
    kinds = "".join(f"has-{LOOKS[name].style} " for name in test.verdicts)
    return filled('<tbody id="{}" class="{}">\n{}{}{}\n</tbody>', test.anchor, kinds, head, lines, below)


def _ran(row: Mapping[str, Any] | None) -> Markup | str:
    """The verdict of a controller, with the link to its curves."""
    if row is None:
        return "not run"
    link = filled(' <a href="{}">CSV</a>', row["csv"]) if row["csv"] else _NOTHING
    return _verdict(row["verdict"]) + filled("<small>{}</small>", besides(row)) + link


def besides(row: Mapping[str, Any]) -> str:
    """What is said beside a verdict: whose limits a passing row keeps, and that a test could not begin."""
    whose = passes_against(row)
    return f" (limit of {WHOSE[whose]})" if whose else " (could not begin)" * not_begun(row)


def _line(line: Line) -> Markup:
    values = []
    for value in line.values:
        if value is None:
            values.append(Markup("–"))
            continue
        look, long = LOOKS[value.verdict], " long" if value.long else ""
        shown = '<span class="v {}{}" title="{}">{} {}</span>'
        values.append(filled(shown, look.style, long, value.verdict, look.sign, typeset(value.words)))
    cells = _joined([filled('<td class="text">{}</td>', value) for value in values])
    head = '<tr><td class="text m">{}</td><td class="text">{}</td>'
    return filled(head, typeset(line.label), typeset(line.asked)) + cells + Markup("<td></td></tr>")


def _evidence(matrix: Matrix, test: Tested) -> Markup:
    """The trace of a failing test, its figure as a file, and how to repeat it."""
    trace, figure = matrix.drawn.inside.get(test.anchor), _NOTHING
    if trace is not None:
        shown = (
            '<details class="trace"><summary>Trace</summary><figure class="plots"><div class="row">{}</div></figure>'
        )
        figure = filled(shown, trace) + Markup("</details>\n")
    if test.anchor in matrix.drawn.tests:
        file = figure_path(test.suite, test.test)
        figure += filled('<a href="{}">Figure of this test as a file</a>\n', file)
    else:
        figure += Markup("This test has no figure; its CSV files have the curves.\n")
    return figure + _joined([_repeat(matrix, row) for row in test.known if row["verdict"] == FAIL])


def _repeat(matrix: Matrix, row: Mapping[str, Any]) -> Markup:
    """The commands that repeat a failing row, and open the explorer there."""
    repeat = f"vsgdesign simulate {shlex.quote(row['study'])}" if row.get("study") else ""
    commands = (
        ("In the folder of this page:", repeat),
        ("Where the study is:", explore_command(matrix.document, row)),
    )
    one = '<p class="note">{}</p><div><code>{}</code></div>'
    shown = _joined([filled(one, where, command) for where, command in commands if command])
    summary = '<details class="command"><summary>Repeat {}, or open it in the explorer</summary>{}</details>\n'
    return filled(summary, row["controller"], shown) if shown else _NOTHING


MOST_LETTERS = 160
"""Of a reason why a test fails. The arithmetic of what is impossible is never cut."""


def draw_strips(flow: Flow, arranged: Arranged) -> None:
    """The shares of the verdicts of each controller, and its strip."""
    flow.need(24.0 * len(arranged.controllers) + 12.0)
    for k, name in enumerate(arranged.controllers):
        flow.sheet.text(MARGIN, flow.y + 11.0, name, 7.0)
        flow.sheet.sketch(counts_bar(arranged.counts[k], name), MARGIN + 90.0, flow.y + 3.0, 0.8)
        flow.sheet.sketch(strip(arranged, k), MARGIN + 200.0, flow.y, (flow.room - 200.0) / 960.0)
        flow.y += 17.0
    flow.paragraph(f"Left: shares of the verdicts, what fails is hatched. Right: {ABOUT_STRIPS}", 6.6, DIM)


def draw_matrix(flow: Flow, matrix: Matrix) -> None:
    """The tests of every suite, then the figures of groups and of failing tests."""
    for suite in matrix.arranged.suites:
        _suite_on_paper(flow, matrix.arranged, suite)
    _figures(flow, matrix.arranged, matrix.drawn)


def _suite_on_paper(flow: Flow, arranged: Arranged, suite: SuiteRows) -> None:
    flow.heading(suite.title, 9.5, below=90.0)
    if suite.source:
        source = suite.source
        named = ", ".join(part for part in (source["document"], source["edition"]) if part)
        flow.paragraph(f"{named}; confidence: {source['confidence']}. {source.get('note', '')}", 6.6, DIM)
    if suite.about:
        flow.paragraph(suite.about)
    if passing := _passing(arranged, suite):
        flow.paragraph(passing, 6.6, DIM)
    count = len(arranged.controllers)
    widths = (26, 20, *[max(45.0 / count, 11.0)] * count, 12)
    head = ("Test and network", "Asked", *arranged.controllers, "Source")
    blocks: list[list[Cells]] = []
    for group in suite.groups:
        said = ", ".join(
            f"{name}: {counts.words()}"
            for name, counts in zip(arranged.controllers, group.counts, strict=True)
            if counts.total
        )
        title: Cells = [[Said(group.name, bold=True)], [Said(said, DIM)]]
        of_tests = [_test_rows(arranged, test) for test in group.tests]
        blocks += [[title, *of_tests[0]], *of_tests[1:]]
    flow.table(flow.shares(widths), head, blocks)


def _test_rows(arranged: Arranged, test: Tested) -> list[Cells]:
    asked = [line for line in test.lines if any(v is not None and v.verdict != INFORMATIONAL for v in line.values)]
    shown = asked or list(test.lines)
    source = arranged.sources[test.reference - 1]
    cells: list[list[Said]] = [
        [Said(test.test, bold=True), Said(test.network, DIM)],
        [Said(line.label if line.asked == "not asked for" else f"{line.label}: {line.asked}") for line in shown]
        or [Said("–")],
    ]
    for k, row in enumerate(test.rows):
        if row is None:
            cells.append([Said("not run", DIM)])
            continue
        look = LOOKS[row["verdict"]]
        values = [value.words for line in shown if (value := line.values[k]) is not None]
        cells.append(
            [
                Said(f"{look.sign} {row['verdict']}{besides(row)}", look.colour, row["verdict"] == FAIL),
                Said("; ".join(values)),
            ]
        )
    known = ", ".join(part for part in (source["edition"], source["confidence"]) if part)
    cells.append([Said(f"[{test.reference}] {known}", DIM)])
    rows: list[Cells] = [[[one for one in cell if one.text] or [Said("")] for cell in cells]]
    for verdict in VERDICTS:
        reasons = [reason for reason in test.reasons if reason.verdict == verdict]
        if reasons:
            said = "; ".join(f"{', '.join(one.controllers)}: {_short(one)}" for one in reasons)
            rows.append([[Said("")], [Said(f"{LOOKS[verdict].sign} {verdict}, {said}", LOOKS[verdict].colour)]])
    return rows


def _short(reason: Reason) -> str:
    whole = reason.verdict == IMPOSSIBLE
    return reason.text if whole else shorten(reason.text, MOST_LETTERS, placeholder=" …")


def _figures(flow: Flow, arranged: Arranged, drawn: Drawn) -> None:
    if not drawn.groups and not drawn.tests:
        return
    flow.new_sheet()
    flow.heading("Figures of the matrix", 9.5, below=150.0, listed=False)
    x = MARGIN
    for name, colour in zip(arranged.controllers, arranged.colours, strict=True):
        flow.sheet.line((x, flow.y + 8.0), (x + 20.0, flow.y + 8.0), colour, 1.6)
        flow.sheet.text(x + 24.0, flow.y + 10.5, name, 7.0)
        x += 44.0 + text_width(name, 7.0)
    flow.y += 16.0
    titles = {suite.name: suite.title for suite in arranged.suites}
    for (suite, _), figure in drawn.groups.items():
        flow.sketches(f"{titles[suite]}: {figure.title}", figure.caption, figure.plots, 3)
    figures: list[TestFigure] = list(drawn.tests.values())
    for figure in figures[:MOST_ON_PAPER]:
        flow.sketches(f"✗ {figure.title}", figure.caption, figure.plots, 3)
    left = len(figures) - MOST_ON_PAPER + drawn.beyond
    if left > 0:
        flow.paragraph(f"{left} more failing tests have their figures or CSV files beside this document.")
