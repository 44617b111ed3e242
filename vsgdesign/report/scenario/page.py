"""The report of a scenario: one HTML file that contains everything and loads nothing, and a sheet to sign. Its only
scripts are those of the part on which one tries other grids.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.files import write_new
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.table_text import proof_sentences, table_lines, table_summary
from vsgdesign.identification.interface import why_no_c
from vsgdesign.metrics import mean_in_words
from vsgdesign.report.drawing.figures import WrittenFigure
from vsgdesign.report.drawing.quantities import plain, plain_quantity
from vsgdesign.report.page.blocks import (
    BULLETS,
    HEADLINE,
    SOURCE,
    Block,
    Box,
    Heading,
    Line,
    Note,
    Page,
    Side,
    Span,
    Table,
    Where,
    drawings,
    opening,
    words,
)
from vsgdesign.report.page.converter import converter_table, dc_link_text, filter_table, known_grid, phase_jump_blocks
from vsgdesign.report.page.live import StaticPage, try_it, way_to_it
from vsgdesign.report.page.pdf import print_pdf, sheets_of
from vsgdesign.report.scenario import estimate_tables, tables
from vsgdesign.report.scenario.answer import scenario_answer, scenario_headline, steps_answer
from vsgdesign.report.scenario.field_figures import answers_table, answers_text
from vsgdesign.report.scenario.outcomes import promise_sentences, promises_table, step_outcomes
from vsgdesign.report.scenario.signals import field_controllers
from vsgdesign.report.scenario.verdict import explanation, placing_text, survival_sentence, verdict
from vsgdesign.report.stability.inner import explanation as explanation_of
from vsgdesign.report.stability.inner import headline, inner_tables, what_for
from vsgdesign.simulation.every_sample import spacing_of_figures
from vsgdesign.simulation.rest import WHERE_TO_LOOK
from vsgdesign.simulation.scenario import ScenarioResult, mean_cycles
from vsgdesign.simulation.scenario.checking import BRIDGES
from vsgdesign.simulation.scenario.judging import Judgement, judge_estimates, promises_kept
from vsgdesign.study.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.estimator.trained import TrainedEstimator


def scenario_page(
    result: ScenarioResult,
    figures: Sequence[WrittenFigure] = (),
    trained: TrainedEstimator | None = None,
    inner: dict[str, Any] | None = None,
    jumps: dict[str, Any] | None = None,
    live: StaticPage | None = None,
) -> Page:
    """The page: the answer, all figures, what was asked for, the system, and the response to each event.

    ``inner`` says what designed inner loops keep, and ``jumps`` what current phase jumps make (results.json of the verb
    ``inner`` and its ``phase_jumps``). ``live`` becomes the part on which one tries other grids and events.
    """
    study = result.study
    outcomes, kept, judged = step_outcomes(result), promises_kept(result), judge_estimates(result)
    answer = scenario_headline(result, outcomes)
    answers = [scenario_answer(result, outcomes, kept, judged), steps_answer(result, outcomes)]
    said = [answers_text(result, controller) for _, controller in field_controllers(result)]
    said += [*verdict(result, outcomes), *promise_sentences(kept), *_designed(result, inner)]
    why = explanation(outcomes)
    blocks: list[Block | None] = [
        words(f"Parameters: {study.source}" if study.source else "", style=SOURCE),
        words(_scenario(result)),
        *left_out(result),
        *_warnings(result),
        *way_to_it(live),
        *opening(answer, [one for one in answers if one is not None], figures),
        *try_it(live, study.title),
        Heading("In words"),
        Box([words(*(line for line in said if line != answer))]),
        *([Heading("Why the closed form misses"), words(*why)] if why else []),
        tables.targets_table(outcomes) if outcomes else None,
        Heading("Figures"),
        *drawings(figures[1:]),
        *_with_heading("Margins against what was asked for", promises_table(kept)),
        Heading("System"),
        Side((converter_table(result), filter_table(result))),
        tables.controllers_table(result),
        words(placing_text(result)),
        tables.events_table(result) if study.events else None,
        *_with_heading("Gain tables", _of_tables(result)),
        *([] if inner is None else _inner(inner)),
        *phase_jump_blocks(jumps),
        Heading("Operating points"),
        tables.rests_table(result),
        *_estimate(result, judged, trained),
        *_with_heading("The dc link", tables.dc_table(result)),
        Heading("Gains over time"),
        Side([tables.gains_table(result, controller) for controller in result.controllers]),
        tables.margins_table(result),
        *_responses(result),
        *terminal_blocks(result),
        Heading("Limits of validity"),
        words(*limits_of_validity(result), style=BULLETS),
        Heading("In other tools"),
        words(*_other_tools(result)),
    ]
    origin = ("Study ", Span(study.name, code=True), ", SHA-256 of its resolved document ", Span(study.hash, code=True))
    return Page(study.title, [block for block in blocks if block is not None], (*origin, "."))


def _other_tools(result: ScenarioResult) -> list[Line]:
    """How a controller of the run comes into another tool, with links to the C that lies beside the page."""
    command = Span(
        f"vsgdesign export fmu STUDY.toml --controller {result.controllers[-1].spec.name} --out FOLDER", code=True
    )
    others = "The words dll (IEEE/CIGRE TB 958), simulink, plecs, modelica, firmware and c take the place of fmu"
    said: list[Line] = [
        ("This writes a controller of the study as an FMU: ", command, f". {others}, and all writes every form.")
    ]
    if made := list(result.ready.tables):
        links: list[str] = []
        for name in made:
            links += [", " if links else "", Span(f"{name}.c", link=f"{name}.c/INTEGRATION.md")]
        said.append(("The C of each gain table is beside this page: ", *links, "."))
    return said


def terminal_blocks(result: ScenarioResult) -> list[Block]:
    """What a terminal prints: whether every judged step meets its target, the tables that were designed, the
    responses, and whether the events were survived."""
    outcomes = step_outcomes(result)
    answer = scenario_headline(result, outcomes) if any(outcome.judged for outcome in outcomes) else ""
    limits = [(one.name, one.rate_limit) for one in judge_estimates(result) if one.rate_limit]
    survived = [survival_sentence(c.spec.name, c.survival) for c in result.controllers if c.survival is not None]
    held = [estimate_tables.rate_limit_text(name, *limit) for name, limit in limits]
    responses = tables.responses_table(result)
    found = [
        words(answer, style=HEADLINE, on=Where.TERMINAL),
        words(*lines_of_tables(result), on=Where.TERMINAL),
        tables.dc_table(result, Where.TERMINAL),
        responses if responses.rows else words(f"{result.study.title}: no event to measure", on=Where.TERMINAL),
        words(*survived, *held, on=Where.TERMINAL),
    ]
    return [block for block in found if block is not None]


def _with_heading(title: str, block: Block | None) -> list[Block]:
    return [] if block is None else [Heading(title), block]


def left_out(result: ScenarioResult) -> list[Block]:
    """A box that says which controllers of the study were not run; nothing where all were."""
    return [Box([words(*result.left_out)], warning=True)] if result.left_out else []


def _warnings(result: ScenarioResult) -> list[Block]:
    if not result.instabilities:
        return []
    said = words((Span("Unstable.", bold=True),), *(one.message for one in result.instabilities), WHERE_TO_LOOK)
    return [Box([said], warning=True)]


def lines_of_tables(result: ScenarioResult) -> list[str]:
    """What is proved and counted of every gain table, in words."""
    return [line for name, table in _tables(result) for line in table_lines(name, table_summary(result.study, table))]


def _of_tables(result: ScenarioResult) -> Block | None:
    lines = lines_of_tables(result)
    return words(*lines) if lines else None


def _inner(document: dict[str, Any]) -> list[Block]:
    """What designed inner loops keep."""
    said = words((Span(headline(document), bold=True), f" {what_for(document)}"), *explanation_of(document))
    return [Heading("Inner loops"), said, Side(inner_tables(document))]


def _responses(result: ScenarioResult) -> list[Block]:
    """Figures of each event."""
    found = [tables.metrics_table(result, controller) for controller in result.controllers if controller.events]
    notes = [Note(note) for note in tables.METRICS_NOTES]
    return [Heading("Responses to the events"), *found, *notes] if found else []


def _tables(result: ScenarioResult) -> list[tuple[str, GainTable]]:
    """Names of the controllers that run from a gain table, with it."""
    pairs = ((c.spec, result.ready.table(c.spec)) for c in result.controllers)
    return [(spec.name, table) for spec, table in pairs if table is not None]


def _designed(result: ScenarioResult, inner: dict[str, Any] | None) -> list[str]:
    """What was designed for this run and whether it is proved, each in one sentence."""
    said = [f"{name}: {proof_sentences(table)}" for name, table in _tables(result)]
    return said if inner is None else [*said, headline(inner)]


def _estimate(result: ScenarioResult, judgements: Sequence[Judgement], trained: TrainedEstimator | None) -> list[Block]:
    """What the page says about estimates; nothing if there are none."""
    if not judgements:
        return []
    about = [] if result.ready.network is None else [estimate_tables.network_table(result, trained)]
    about += estimate_tables.methods_table(result)
    if trained is not None:
        about.append(estimate_tables.training_table(trained))
    found = []
    for judged in judgements:
        found.append(estimate_tables.rest_table(result, judged))
        if judged.changes:
            found.append(estimate_tables.changes_table(judged))
        if judged.steps:
            found.append(estimate_tables.truth_table(judged))
    found += [answers_table(result, controller) for _, controller in field_controllers(result)]
    text = estimate_tables.estimate_text(result, judgements)
    return [Heading("The estimated grid"), words(*text), Side(about), Side(found)]


def _scenario(result: ScenarioResult) -> str:
    study = result.study
    names = ", ".join(controller.spec.name for controller in result.controllers)
    count = len(study.events)
    events = "no events" if count == 0 else f"{count} event{'s' if count > 1 else ''}"
    plural = "s" if len(result.controllers) > 1 else ""
    bridges = " and ".join(sorted({BRIDGES[controller.bridge] for controller in result.controllers}))
    return (
        f"{plain(study.simulation.duration)} s of electromagnetic-transient simulation with {bridges}, {events}, "
        f"controller{plural} {names}, on a converter of {plain_quantity(study.converter.S_rated, 'VA')}."
    )


def _said_of_link(study: Study) -> str:
    """What the simulated dc link is, and is not."""
    V_dc = plain_quantity(study.converter.V_dc, "V")
    if study.dc is None:
        return f"The dc link is an ideal source of {V_dc}, nothing behind it."
    nominal = f"The nominal voltage is {V_dc}. Margins and proofs are those of an ideal link."
    return f"{dc_link_text(study.dc.source)} {nominal}"


def _said_of_grid(result: ScenarioResult) -> list[str]:
    """What the simulated grid is, and is not."""
    of_grid = "The grid is an ideal three-phase source behind one balanced R–L branch"
    if all(network.plain for _, network in result.timeline.networks):
        return [f"{of_grid}; no other converter or load is near."]
    return [
        f"{of_grid}, with the loads, faults and breakers of the events; no other converter is near. There are three "
        "wires: a fault has no connection to earth.",
        "A fault that is cleared ends phase by phase at the zeros of its currents. A breaker that opens interrupts all "
        "currents at the given instant, and a load that is switched off is discharged at once.",
    ]


def limits_of_validity(result: ScenarioResult) -> list[str]:
    """What the simulation leaves out, as far as it matters for the numbers of this report."""
    study = result.study
    bridges = {controller.bridge for controller in result.controllers}
    sensed = study.sensors is not None and study.sensors.act
    mean = mean_in_words(mean_cycles(study))
    items = []
    if "averaged" in bridges:
        items.append(
            "The bridge is averaged over a sampling period: no switching ripple, no dead time, no device losses."
        )
    if "pwm" in bridges:
        items.append(
            "The bridge switches ideally at the exact instants of its modulation: no dead time, no device losses. "
            f"Figures of the instantaneous signal contain the ripple; targets are judged on the {mean}."
        )
    if study.background is not None and study.background.distorts:
        items.append(
            "The voltage of the grid wanders and is distorted as the table of filter and grid says. The simulation "
            f"starts in the steady state of the fundamental at t = 0. Targets are judged on the {mean}; "
            "margins, modes and operating points are those of the fundamental without its wander."
        )
    elif study.replay is not None:
        items.append(
            "The grid source is a recorded voltage. The simulation starts in the steady state of its fundamental over "
            "the first ten cycles; margins, modes and operating points are those of this fundamental. Targets are "
            f"judged on the {mean}."
        )
    elif study.has_components:
        items.append(
            "The grid source contains a negative sequence or harmonics. The simulation starts in the steady state of "
            "the fundamental alone, so their currents begin with a transient of the inner loops. Targets are judged "
            f"on the {mean}. Margins, modes and operating points are those of the fundamental."
        )
    items += [
        _said_of_link(study),
        *_said_of_grid(result),
        f"Inductors do not saturate, capacitors {'are' if sensed else 'and measurements are'} ideal; "
        f"the controller is sampled every {plain_quantity(study.converter.T_s, 's')}.",
    ]
    told = [c.spec for c in result.controllers if c.spec.kind == "scheduled" and c.estimates is None]
    knowing = [spec.name for spec in told if spec.knowledge is None]
    items += [
        f"Gains of {spec.name} come from {known_grid(spec)}; the estimator itself is not simulated."
        for spec in told
        if spec.knowledge is not None
    ]
    if knowing:
        items.append(
            f"Gains of {', '.join(knowing)} come from the true grid impedance, as it was up to each update; "
            "the error of an impedance estimator is not included."
        )
    estimating = [c for c in result.controllers if c.estimates is not None]
    if estimating:
        items.append(
            f"{', '.join(c.spec.name for c in estimating)} measures v_pcc and i_pcc "
            f"{'with the sensors of the controller' if sensed else 'without noise or quantisation'} and "
            "begins with the gains of the true grid at the start."
        )
        with_tables = [c.spec for c in estimating if result.ready.table(c.spec) is not None]
        items += [said for spec in with_tables if (said := why_no_c(spec.name, spec.estimate))]
        network = result.ready.network
        trained_with = None if network is None else network.recipe.get("bridge")
        if any(c.bridge == "pwm" for c in estimating) and trained_with == "averaged":
            items.append(
                "The network was trained with an averaged bridge: samples of a switched one are biased, and so is "
                "its estimate."
            )
    limited = [study.with_limit_of(c.spec).converter.current_limit_pu is not None for c in result.controllers]
    if not all(limited):
        free = [c.spec.name for c, has_limit in zip(result.controllers, limited, strict=True) if not has_limit]
        whose = f" in {', '.join(free)}" if any(limited) else ""
        items.append(
            f"No current limit acts{whose}: currents beyond the rating are simulated as if the converter could carry "
            "them."
        )
    spacing = plain_quantity(spacing_of_figures(study) * study.converter.T_s, "s")
    items.append(
        f"Figures come from samples every {spacing}, up to the next event or the end. Curves are drawn from a log with "
        f"a row every {plain_quantity(study.simulation.log_interval, 's')}."
    )
    return items


_MOST = (30, 20, 14, 10, 7, 5, 3, 2, 1)
"""Rows of a table, fewer and fewer until all is on one sheet."""

_TO_SIGN = "Name, date, signature: ______________________________________________________________________"


def write_sheet(result: ScenarioResult, document: Mapping[str, Any], out_path: str | Path) -> None:
    """Write a PDF of one sheet, which must not be there yet: a signed one is never replaced.

    ``document`` is the content of results.json, with its hash. Raises ArtifactError.
    """
    pages = (sheet_page(result, document, most) for most in _MOST)
    fits = next((page for page in pages if sheets_of(page) == 1), None)
    with TemporaryDirectory() as folder:
        made = print_pdf(fits or sheet_page(result, document, _MOST[-1]), Path(folder) / "sheet.pdf")
        write_new(out_path, made.read_bytes())


def sheet_page(result: ScenarioResult, document: Mapping[str, Any], most: int = _MOST[0]) -> Page:
    """The page of a sheet, with at most so many rows of each table; what is left out is counted."""
    study = result.study
    outcomes, kept, judged = step_outcomes(result), promises_kept(result), judge_estimates(result)
    answer = scenario_answer(result, outcomes, kept, judged)
    evidence = [*lines_of_tables(result), *promise_sentences(kept)]
    blocks: list[Block] = [
        words(f"Parameters: {study.source}" if study.source else "", style=SOURCE),
        *left_out(result),
        *opening(scenario_headline(result, outcomes), [replace(answer, notes=())], ()),
        *(_in_line(table) for table in (converter_table(result), filter_table(result))),
        _first(tables.controllers_table(result), most),
        *(_first(tables.gains_table(result, controller), most) for controller in result.controllers[:most]),
        Heading("Evidence", 3),
        *([_first(tables.targets_table(outcomes), most)] if outcomes else []),
        *map(Note, evidence),
        Heading("Limits", 3),
        *map(Note, limits_of_validity(result)),
        _hashes(document),
        words(_TO_SIGN),
    ]
    origin = ("Study ", Span(study.name, code=True), ".")
    return Page(f"{study.title}: sheet of a run", blocks, origin)


def _hashes(document: Mapping[str, Any]) -> Table:
    """SHA-256 of what the sheet stands for; results.json has those of all files of its folder."""
    files = document["files"]
    made = [
        name for name in files if name.endswith((".table.json", ".weights.json", ".c/manifest.json", "report.html"))
    ]
    rows = [("study, with all that it is based on", document["study"]["hash"]), ("results.json", document["sha256"])]
    return Table("Hashes (SHA-256)", ("File", "Hash"), (*rows, *((name, files[name]) for name in made)), texts=2)


def _in_line(table: Table) -> Note:
    """A table of quantities and values as one paragraph."""
    said = ["" if not name else f"{name}: {value}" for name, value in table.rows]
    said = [text or f"{value}" for text, (_, value) in zip(said, table.rows, strict=True)]
    return Note(f"{table.title}. {'. '.join(said)}.")


def _first(table: Table, most: int) -> Table:
    """The first rows of a table, without its notes."""
    left = _more(len(table.rows) - most)
    flagged = frozenset(row for row in table.flagged if row < most)
    return replace(table, rows=table.rows[:most], flagged=flagged, notes=(left,) if left else ())


def _more(left: int) -> str:
    return f"… and {left} more in report.html." if left > 0 else ""
