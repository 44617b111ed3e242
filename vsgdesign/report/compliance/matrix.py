"""The clause matrix as a browser shows it: groups that open and close, a filter, and the traces of failing tests."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from vsgdesign.compliance.evidence import figure_path
from vsgdesign.compliance.rows import FAIL, VERDICTS
from vsgdesign.report.compliance.arranged import Arranged, Group, Line, SuiteRows, Tested
from vsgdesign.report.compliance.drawn import Drawn
from vsgdesign.report.compliance.figures import dashes_of
from vsgdesign.report.compliance.verdicts import LOOKS
from vsgdesign.report.drawing.sketch import Sketch, svg
from vsgdesign.report.quantities import typeset

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
    keys = _joined(Markup("<span>{} {}</span>").format(*one) for one in _keys(matrix.arranged))
    suites = [_suite(matrix, k, suite) for k, suite in enumerate(matrix.arranged.suites, start=1)]
    return Markup('<p class="key">{}</p>\n{}\n{}').format(keys, _filter(), Markup("\n").join(suites))


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
    return Markup(sign).format(style, look.style, look.sign, name)


def _filter() -> Markup:
    choice = Markup('<label><input type="radio" name="show" value="{}"> {}</label>\n')
    choices = _joined([choice.format(LOOKS[name].style, _verdict(name)) for name in VERDICTS])
    return Markup(
        '<form id="filter" hidden>\n<span>Show</span>\n'
        '<label><input type="radio" name="show" value="" checked> all tests</label>\n{}'
        '<label class="words">with the words <input type="search" name="words" placeholder="SCR 2, +60 deg"></label>\n'
        "<output></output>\n</form>"
    ).format(choices)


def _suite(matrix: Matrix, number: int, suite: SuiteRows) -> Markup:
    source, about = suite.source, Markup("<p>{}</p>\n").format(typeset(suite.about)) if suite.about else _NOTHING
    said = _NOTHING
    if source:
        named = ", ".join(part for part in (source["document"], source["edition"]) if part)
        text = f"{named}; confidence: {source['confidence']}. {source.get('note') or ''}".strip()
        said = Markup('<p class="source">{}</p>\n').format(typeset(text))
    groups = Markup("\n").join(_group(matrix, group) for group in suite.groups)
    head = Markup('<section class="suite">\n<h3 id="suite-{}">{}</h3>\n').format(number, suite.title)
    return head + said + about + groups + Markup("\n</section>")


def _group(matrix: Matrix, group: Group) -> Markup:
    names = matrix.arranged.controllers
    counts = _joined(
        Markup('<span class="of">{}{}</span>').format(name, _counts(of))
        for name, of in zip(names, group.counts, strict=True)
    )
    opened = " open" if group.fails and len(group.tests) <= MOST_OPEN else ""
    figure = matrix.drawn.groups.get((group.suite, group.name))
    overlay = _NOTHING
    if figure is not None:
        plots = Markup("\n").join(svg(one, "plot") for one in figure.plots)
        overlay = Markup(
            '<figure class="plots"><div class="row">{}</div><figcaption>{}</figcaption></figure>\n'
        ).format(plots, typeset(figure.caption))
    head = _joined(
        Markup('<th class="text">{}</th>').format(cell)
        for cell in ("Test, and what is measured", "Asked", *names, "Source")
    )
    tests = Markup("\n").join(_test(matrix, test) for test in group.tests)
    return Markup(
        '<details class="group"{}>\n<summary><b>{}</b> <span class="counts">{}</span></summary>\n{}'
        '<div class="scroll">\n<table class="matrix" style="min-width:{}rem">\n'
        '<colgroup><col class="c-test"><col class="c-asked">{}<col class="c-source"></colgroup>\n'
        "<thead><tr>{}</tr></thead>\n{}\n</table>\n</div>\n</details>"
    ).format(opened, group.name, counts, overlay, 26 + 7 * len(names), Markup("<col>") * len(names), head, tests)


def _counts(counts: Any) -> Markup:
    one = Markup(' <span class="v {}">{} {} {}</span>')
    found = [(LOOKS[name], counts.of[name], name) for name in VERDICTS if counts.of[name]]
    return _joined([one.format(look.style, look.sign, count, name) for look, count, name in found])


def _test(matrix: Matrix, test: Tested) -> Markup:
    source = matrix.arranged.sources[test.reference - 1]
    known = ", ".join(part for part in (source["edition"], source["confidence"]) if part)
    head = Markup('<tr class="head"><th class="text" scope="rowgroup" colspan="2">{} <small>{}</small></th>\n').format(
        typeset(test.test), typeset(test.network)
    )
    head += _joined(Markup('<td class="text">{}</td>').format(_ran(row)) for row in test.rows)
    head += Markup('\n<td class="text src"><a href="#source-{}">[{}]</a> {}</td></tr>\n').format(
        test.reference, test.reference, known
    )
    lines = Markup("\n").join(_line(line) for line in test.lines)
    why = [
        Markup("{} ({}): {}").format(_verdict(one.verdict), ", ".join(one.controllers), typeset(one.text))
        for one in test.reasons
    ]
    if test.fails:
        why.append(_evidence(matrix, test))
    row = Markup('\n<tr class="why"><td class="text" colspan="{}">{}</td></tr>')
    below = _joined([row.format(matrix.columns, one) for one in why])
    kinds = "".join(f"has-{LOOKS[name].style} " for name in test.verdicts)
    return Markup('<tbody id="{}" class="{}">\n{}{}{}\n</tbody>').format(test.anchor, kinds, head, lines, below)


def _ran(row: Mapping[str, Any] | None) -> Markup | str:
    """The verdict of a controller, with the link to its curves."""
    if row is None:
        return "not run"
    link = Markup(' <a href="{}">CSV</a>').format(row["csv"]) if row["csv"] else _NOTHING
    return _verdict(row["verdict"]) + link


def _line(line: Line) -> Markup:
    values = []
    for value in line.values:
        if value is None:
            values.append(Markup("–"))
            continue
        look, long = LOOKS[value.verdict], " long" if value.long else ""
        shown = '<span class="v {}{}" title="{}">{} {}</span>'
        values.append(Markup(shown).format(look.style, long, value.verdict, look.sign, typeset(value.words)))
    cells = _joined([Markup('<td class="text">{}</td>').format(value) for value in values])
    head = Markup('<tr><td class="text m">{}</td><td class="text">{}</td>')
    return head.format(typeset(line.label), typeset(line.asked)) + cells + Markup("<td></td></tr>")


def _evidence(matrix: Matrix, test: Tested) -> Markup:
    """The trace of a failing test, its figure as a file, and how to repeat it."""
    trace, figure = matrix.drawn.inside.get(test.anchor), _NOTHING
    if trace is not None:
        shown = (
            '<details class="trace"><summary>Trace</summary><figure class="plots"><div class="row">{}</div></figure>'
        )
        figure = Markup(shown).format(trace) + Markup("</details>\n")
    if test.anchor in matrix.drawn.tests:
        file = figure_path(test.suite, test.test)
        figure += Markup('<a href="{}">Figure of this test as a file</a>\n').format(file)
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
    one = Markup('<p class="note">{}</p><div><code>{}</code></div>')
    shown = _joined([one.format(where, command) for where, command in commands if command])
    summary = '<details class="command"><summary>Repeat {}, or open it in the explorer</summary>{}</details>\n'
    return Markup(summary).format(row["controller"], shown) if shown else _NOTHING
