"""The page of a compliance result: one HTML file, nothing fetched; links lead to the files beside it. It says which
model the verdicts are about: base values, hashes, versions, and where the model ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from markupsafe import Markup

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.campaigns.compliance.evidence import MOST_FIGURES, figure_path
from vsgdesign.campaigns.compliance.rows import FAIL
from vsgdesign.execution.jobs import begun, each_of
from vsgdesign.metrics.survival import HARDWARE_PU
from vsgdesign.report.compliance.answer import (
    ABOUT_STRIPS,
    MOST_FAILING,
    below_headline,
    counts_answer,
    dc_side_suffices,
    failing_tests,
    headline,
    limits_table,
    strips,
)
from vsgdesign.report.compliance.arranged import Arranged, arrange, deadline_words
from vsgdesign.report.compliance.figures import Drawn, Traces, draw
from vsgdesign.report.compliance.heat import LEGEND, maps_by_title
from vsgdesign.report.compliance.matrix import Matrix, draw_matrix, draw_strips, matrix_html
from vsgdesign.report.drawing.quantities import plain, plain_quantity
from vsgdesign.report.drawing.sketch import filled
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    Block,
    Box,
    Heading,
    Live,
    Note,
    OnPaper,
    Page,
    Side,
    Sketches,
    Span,
    Table,
    Where,
    words,
)
from vsgdesign.report.page.converter import dc_link_text
from vsgdesign.report.page.html import print_html, text_file
from vsgdesign.report.page.pdf import print_pdf

PAGE, PDF = "report.html", "report.pdf"


def write_page(
    folder: str | Path,
    document: Mapping[str, Any],
    traces: Traces,
    executor: Executor | None = None,
    beside: Callable[[], Callable[[], object]] | None = None,
) -> list[Path]:
    """Write ``report.html``, ``report.pdf`` and ``figures/`` into a folder (made if missing).

    ``document`` is results.json of the verb ``comply``, ``traces`` has the evidence by the field ``csv`` of the rows,
    and may read it when asked. ``executor``: of workers that reach the folder and the traces; they draw, and make the
    HTML while the PDF is set here. ``beside`` begins what may be done beside the PDF, and returns what waits for it.
    Returns every file that was written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    arranged = arrange(document)
    drawn = draw(arranged, document, traces, each_of(executor))
    html = begun(executor, _print_html, document, drawn, folder)
    waits = None if beside is None else beside()
    pdf = print_pdf(compliance_page(document, arranged, drawn), folder / PDF, wide=True)
    if waits is not None:
        waits()
    return [*html(), pdf]


def _print_html(document: Mapping[str, Any], drawn: Drawn, folder: Path) -> list[Path]:
    """The page and the figures beside it."""
    arranged = arrange(document)
    files = _write_figures(folder, arranged, drawn)
    return [*files, print_html(compliance_page(document, arranged, drawn), folder / PAGE)]


def _write_figures(folder: Path, arranged: Arranged, drawn: Drawn) -> list[Path]:
    files = []
    for test in arranged.tests():
        text = drawn.files.get(test.anchor)
        if text is None:
            continue
        path = folder / figure_path(test.suite, test.test)
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")
        files.append(path)
    return files


def compliance_page(document: Mapping[str, Any], arranged: Arranged, drawn: Drawn) -> Page:
    """The page: the answer, the clause matrix, survival maps, the model that was tested, its limits and the sources."""
    title = document["study"].get("title") or document["study"]["name"]
    matrix = Matrix(document, arranged, drawn)
    blocks: list[Block] = [
        Box(
            [
                words(headline(arranged), style=HEADLINE),
                *(words(said) for said in (*below_headline(arranged), *dc_side_suffices(document))),
                counts_answer(arranged),
                Live(lambda: _strips(arranged), [OnPaper(lambda flow: draw_strips(flow, arranged))]),
                *_failing(arranged),
            ],
            warning=bool(failing_tests(arranged)),
            anchor="answer",
        ),
        Heading("Clause matrix", numbered=True, anchor="matrix"),
        words(_ABOUT_MATRIX),
        Live(lambda: matrix_html(matrix), [OnPaper(lambda flow: draw_matrix(flow, matrix))]),
        Heading("Limits that were asked", numbered=True, anchor="limits"),
        words(_ABOUT_LIMITS),
        limits_table(document),
        *_maps(document, drawn),
        Heading("The model that was tested", numbered=True, anchor="identity"),
        Side(identity_tables(document)),
        Heading("Limits of validity", numbered=True, anchor="validity"),
        words(*validity(document), style=BULLETS),
        Heading("Sources", numbered=True, anchor="sources"),
        sources_table(arranged.sources),
        Heading("What is not on this page", numbered=True, anchor="left-out"),
        words(*left_out(arranged, drawn), style=BULLETS),
    ]
    origin = (
        "Study ",
        Span(document["study"]["name"], code=True),
        ", SHA-256 ",
        Span(document["study"]["hash"], code=True),
        ". The same as numbers: ",
        Span("results.json", link="results.json"),
        ". To print: ",
        Span("report.pdf", link="report.pdf"),
        ".",
    )
    script = f"<script>\n{text_file('compliance.js')}</script>"
    return Page(f"{title}: clause matrix", blocks, origin, text_file("compliance.css"), script)


_ABOUT_MATRIX = (
    "A row is a test on one grid from one operating point. Values are in per unit of the converter's ratings, and the "
    "SCR is taken on the impedance. “informational” is not “pass”: nothing was asked for. “impossible” gives the "
    "arithmetic that shows that no converter with this current limit can do it."
)


_ABOUT_LIMITS = (
    "A limit separates if it tells runs that are lost from others. One that no run fails, not even one that slips, "
    "latches up or comes late to rest, is kept by any converter of this kind, and to pass it says little. “ours” is "
    "this project, and “the suite's author” wrote a suite of their own. Survival is judged with the settling time T "
    "of the controller, or with the longest one of the suite where that is shorter. T and the deadline stand beside it."
)


def _strips(arranged: Arranged) -> Markup:
    """The strip of each controller, with its name."""
    rows = [filled("<div><span>{}</span>{}</div>", name, picture) for name, picture in strips(arranged)]
    return filled(
        '<figure class="strips">\n{}\n<figcaption>{}</figcaption>\n</figure>', Markup("\n").join(rows), ABOUT_STRIPS
    )


def _failing(arranged: Arranged) -> list[Block]:
    """The first failing tests, with links into the matrix."""
    failing = failing_tests(arranged)
    if not failing:
        return []
    first, more = arranged.controllers[0], max(len(failing) - MOST_FAILING, 0)
    shown = failing[:MOST_FAILING]
    named = any(one.network for one in shown)
    rows = tuple(
        (
            Span(f"✗ {one.test}", bold=True, link=f"#{one.anchor}"),
            *((one.network,) if named else ()),
            one.who or first,
            one.why,
        )
        for one in shown
    )
    head = ("Test", *(("Grid, power",) if named else ()), "Controllers", "Why")
    return [
        Heading(f"What fails: {len(failing)} tests" if len(failing) > 1 else "What fails: one test", 3),
        Table("", head, rows, texts=len(head)),
        *([words(f"{more} more tests fail; the matrix has all of them.")] if more else []),
    ]


def _maps(document: Mapping[str, Any], drawn: Drawn) -> list[Block]:
    if not drawn.maps:
        return []
    found: list[Block] = [Heading("Survival maps", numbered=True, anchor="maps"), Note(LEGEND)]
    for title, said, sketches in maps_by_title(document, drawn.maps):
        found.append(Sketches(title, said, sketches, kind="heat", least=0.85))
    return found


def left_out(arranged: Arranged, drawn: Drawn) -> list[str]:
    """Sentences about what is not on the page, and where it is."""
    said = []
    outside = len(drawn.tests) - len(drawn.inside)
    if outside:
        said.append(
            f"The figures of {outside} failing tests are files in figures/ beside this page, linked in the matrix."
        )
    if drawn.beyond:
        said.append(
            f"{drawn.beyond} failing tests have no figure, because at most {MOST_FIGURES} are drawn. Their CSV files "
            "have the same curves."
        )
    if drawn.missing:
        said.append(f"The traces of {drawn.missing} runs are missing, so their curves are not drawn.")
    thinned = sum(len(group.tests) for group in arranged.groups()) - len(drawn.tests)
    if thinned:
        said.append(
            "Tests that no controller fails have no figure of their own: each group has one figure with some of its "
            "tests. The CSV files have every curve of every test."
        )
    said.append("Curves are thinned to the resolution of the figures; their extremes are kept.")
    return said


SHOWN = 10
"""Failing rows of a suite that a terminal names. The page has all of them."""

_COUNTS = {
    "pass": "pass",
    "limit of source": "pass_source",
    "of ours": "pass_ours",
    "of author": "pass_user",
    "fail": "fail",
    "not begun": "not_begun",
    "informational": "informational",
    "not applicable": "not_applicable",
    "impossible": "impossible",
}
"""Columns of a terminal, and the names of the counts in the summary."""


def _beyond(counts: Mapping[str, Any]) -> str:
    """How many of the survivors have a current that hardware does not carry; empty where none has."""
    count = counts["beyond_hardware"]
    return f"; {count} above {plain(HARDWARE_PU)} pu, {MORE_THAN_HARDWARE}" if count else ""


def terminal_blocks(document: Mapping[str, Any]) -> list[Block]:
    """The answer for each suite and controller, the failing rows with their reasons, and what could not be tested."""
    summary = document["summary"]
    written = any(one["pass_user"] for one in summary)
    shown = {head: name for head, name in _COUNTS.items() if name != "pass_user" or written}
    rows = tuple(
        (
            one["suite"],
            one["controller"],
            *(str(one[name]) for name in shown.values()),
            f"{one['survived']} of {one['judged']}{_beyond(one)}",
            deadline_words(one),
        )
        for one in summary
    )
    title = f"Grid-code tests of {document['study']['name']}"
    lines: list[str] = []
    for one in document["suites"]:
        failing = [row for row in document["rows"] if row["suite"] == one["name"] and row["verdict"] == FAIL]
        for row in failing[:SHOWN]:
            lines.append(f"fail {row['suite']}, {row['test']}, {row['controller']}: {row['why']}")
        if len(failing) > SHOWN:
            lines.append(f"… and {len(failing) - SHOWN} more of {one['name']} on the page")
    timing = ", ".join(f"{name} {value:.3g} s" for name, value in document["timing_s"].items())
    lines += [*document["notes"], f"{len(document['rows']):,} rows: {timing}"]
    head = ("suite", "controller", *shown, "survived", "judged with")
    return [Table(title, head, rows, texts=2, on=Where.TERMINAL), words(*lines, on=Where.TERMINAL)]


Document = Mapping[str, Any]

VALIDITY = (
    "The verdicts are about a simulation of the converter and its controller, not about hardware. Each run is an EMT "
    "simulation with sampling, delay, limits and the nonlinear power loops; nothing in it is linearised.",
    "Active and reactive power are those at the filter's capacitor, as the controller measures them.",
    "The converter and the grid have three wires. There is no zero sequence, and a fault to ground has no current "
    "through the ground.",
    "The grid is one resistance and one inductance behind an ideal source, with the load and the faults that a test "
    "names. Saturation of transformers, protection relays and other converters are not there.",
    "Every number that is asked for has a source and a confidence. “read” was read in its source, “secondary” is told "
    "by another document, “ours” was chosen by this project, and “user” by the user of the suite. The last two are "
    "no requirements of a grid code.",
    "A pass says that this one test was kept from one operating point. It says nothing about tests that were not run.",
)

_MEASURED = "The power and the energy that storage would have to give are measured"
_AVERAGED = "The bridge is averaged over a sampling period: it has no switching ripple and no dead time."
_SWITCHED = "The bridge is switched ideally: it has no dead time and no voltage drop."

_FILTER = (
    ("L_1_h", "L_1", "H"), ("R_1_ohm", "R_1", "Ω"), ("C_f", "C", "F"), ("R_c_ohm", "R_c", "Ω"),
    ("L_2_h", "L_2", "H"), ("R_2_ohm", "R_2", "Ω"),
)  # fmt: skip


def validity(document: Document) -> tuple[str, ...]:
    """Sentences that say where the model ends."""
    converter = document.get("converter") or {}
    bridge, source = converter.get("bridge"), converter.get("dc_source")
    link = f"{dc_link_text(source)} {_MEASURED}{', and they limit nothing' if source is None else ''}."
    said = [{"averaged": _AVERAGED}.get(bridge, _SWITCHED)] if bridge else []
    return (*VALIDITY[:1], *said, *VALIDITY[1:3], link, *VALIDITY[3:], *document.get("notes", ()))


def identity_tables(document: Document) -> list[Table]:
    """The converter's base values, and the hashes of everything that the verdicts depend on."""
    tables = []
    if document.get("converter"):
        tables.append(Table("Converter", ("Quantity", "Value"), tuple(_converter(document["converter"])), texts=2))
    tables.append(Table("Hashes and versions", ("What", "SHA-256 or version"), tuple(_hashes(document)), texts=2))
    return tables


def _converter(c: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield "Rated power S_rated", plain_quantity(c["S_rated_va"], "VA")
    yield "Rated voltage", f"{plain_quantity(c['V_rated_ll_rms_v'], 'V')} line to line, rms"
    yield "Nominal frequency", f"{plain(c['f_n_hz'])} Hz"
    yield "Base impedance Z_base", plain_quantity(c["Z_base_ohm"], "Ω")
    yield "Rated current", f"{plain_quantity(c['I_rated_pk_a'], 'A')} peak"
    yield "Dc link", plain_quantity(c["V_dc_v"], "V")
    carrier, sampling = plain_quantity(c["f_sw_hz"], "Hz"), plain_quantity(c["T_s_s"], "s")
    delay = f"delay {c['delay_samples']} sample" if c["delay_samples"] else "no delay"
    yield "Bridge", f"{c['bridge']}, carrier {carrier}, sampled every {sampling}, {delay}"
    parts = [f"{symbol} {plain_quantity(c['filter'][key], unit)}" for key, symbol, unit in _FILTER if c["filter"][key]]
    yield "Filter", ", ".join(parts)
    basis, of_study = c["scr_basis"], c["scr_basis_of_study"]
    yield "Basis of the SCR", basis if of_study == basis else f"{basis}; {of_study} in the study and its explorer"
    for one in c["limits"]:
        limit = one["current_limit_pu"]
        said = "none" if limit is None else f"{plain(limit)} pu of the rated peak, {one['limiter']}"
        yield f"Current limit of {one['controller']}", said


def _hashes(document: Document) -> Iterator[tuple[str, str]]:
    hashes = dict(document.get("hashes") or {})
    yield (
        f"Study {document['study']['name']}",
        hashes.pop("study", None) or document["study"].get("hash") or "not known",
    )
    for name, title in (("tables", "Gain table"), ("package", "This package"), ("c", "Exported C")):
        yield from _hash(title, hashes.pop(name, None))
    for name, value in hashes.items():
        yield from _hash(name, value)
    for name, value in (document.get("provenance") or {}).items():
        yield str(name), str(value)


def _hash(title: str, value: Any) -> Iterator[tuple[str, str]]:
    """A hash, or one for each name; a missing one is said."""
    if isinstance(value, Mapping):
        for name, one in value.items():
            yield f"{title}: {name}", str(one or "none: there is no gain table")
    elif value:
        yield title, str(value)
    else:
        yield title, "none"


def sources_table(sources: Any) -> Table:
    """Every source with its edition and how far it is known."""
    rows = tuple(
        (f"[{k}]", one["document"], one["edition"], one["confidence"], one.get("note", ""))
        for k, one in enumerate(sources, start=1)
    )
    return Table("Sources", ("", "Document", "Edition", "Confidence", "Note"), rows, texts=5, row_anchor="source")
