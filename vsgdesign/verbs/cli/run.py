"""The verbs of a whole study: run, simulate, compare its gains, show its inner loops, check it; and those that read
results, cite and diff.
"""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsgdesign.errors import counted, visible
from vsgdesign.verbs.cli.common import (
    BRIDGE,
    COMTRADE,
    EXIT_IMPOSSIBLE,
    EXPLORER,
    FULL_ORDER,
    JSON,
    STUDY,
    WORKERS,
    echo_aside,
    exit_code,
    going_on,
    keeping,
    load,
    print_json,
    progress,
    results_at,
    verb,
)

if TYPE_CHECKING:
    from vsgdesign.design.comparison import Comparison
    from vsgdesign.report.page.blocks import Block
    from vsgdesign.simulation.scenario import ScenarioResult
    from vsgdesign.study.parameters import Study


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME]")
@BRIDGE
@click.option("--sheet", default=None, metavar="FILE.pdf", help="Also write one page to sign. It is never replaced.")
@click.option(
    "--quick",
    is_flag=True,
    help="Averaged bridge; nothing is designed, trained or verified.  --out is out/NAME-quick by default.",
)
@EXPLORER
@FULL_ORDER
@WORKERS
@JSON
@verb
def run(
    study_file: str,
    out: str | None,
    bridge: str | None,
    sheet: str | None,
    quick: bool,
    explorer: bool,
    full_order: float,
    workers: int | None,
    as_json: bool,
) -> None:
    """Design, simulate and report everything, and write C.

    The folder contains time series, figures, results.json, report.html, gain tables and their C. With --quick, gain
    tables that exist are used, and a controller whose table or network is missing is left out.
    """
    if quick and bridge == "pwm":
        raise click.UsageError("--quick has an averaged bridge: leave --bridge pwm out, or --quick")
    if sheet is not None and not sheet.lower().endswith(".pdf"):
        raise click.UsageError(f'--sheet writes a PDF: give a name that ends in .pdf, not "{sheet}"')
    _run(
        study_file,
        out,
        bridge,
        as_json,
        "-quick" if quick else "",
        sheet=sheet,
        explorer=explorer,
        workers=workers,
        full_order=full_order,
    )


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME-simulation]")
@BRIDGE
@click.option("--strict", is_flag=True, help="Give the bits of a page of the explorer, as `strict` in [simulation].")
@COMTRADE
@WORKERS
@JSON
@verb
def simulate(
    study_file: str,
    out: str | None,
    bridge: str | None,
    strict: bool,
    comtrade: str | None,
    workers: int | None,
    as_json: bool,
) -> None:
    """Simulate every controller, and write the time series.

    The folder contains time series and results.json.
    """
    _run(study_file, out, bridge, as_json, "-simulation", workers=workers, strict=strict, comtrade=comtrade)


def _warn(text: str) -> None:
    click.echo(f"warning: {text}", err=True)


def _run(
    study_file: str,
    out: str | None,
    bridge: str | None,
    as_json: bool,
    what: str,
    *,
    workers: int | None,
    sheet: str | None = None,
    explorer: bool = False,
    strict: bool = False,
    comtrade: str | None = None,
    full_order: float = 0.0,
) -> None:
    from vsgdesign.artifacts.files import check_new
    from vsgdesign.verbs.pipeline import run_study
    from vsgdesign.verbs.pipeline.run import Told, what_is_there

    report, left_out = what != "-simulation", list[str]()
    study = load(study_file, left_tables=bool(what), plants="whole")
    if sheet is not None and study.plant is not None:
        raise click.UsageError("--sheet is a page of one converter: leave it out for a plant")
    study = study.made_strict() if strict and study.plant is None else study
    if sheet is not None:
        check_new(sheet)
    if what == "-quick":
        study, left_out = what_is_there(study)
        for sentence in left_out:
            echo_aside(sentence)
    folder = Path("out") / f"{study.name}{what}" if out is None else Path(out)
    if study.plant is not None:
        _run_plant(study, folder, bridge, as_json, comtrade, report=report, workers=workers)
        return
    blocks: list[Block] = []

    def done(result: ScenarioResult, document: dict[str, Any]) -> None:
        if not as_json:
            from vsgdesign.report.scenario.page import terminal_blocks

            blocks.extend(terminal_blocks(result))
        if sheet is not None:
            from vsgdesign.report.scenario.page import write_sheet

            write_sheet(result, document, sheet)

    with keeping(folder):
        with progress(quiet=as_json) as tell:
            results = run_study(
                study,
                folder,
                bridge=bridge,
                report=report and (explorer or "still"),
                workers=workers,
                progress=tell,
                warn=_warn,
                say=echo_aside,
                done=done,
                told=Told(left_out, comtrade, full_order),
            )
        if as_json:
            print_json(results)
        else:
            from vsgdesign.report.page.terminal import print_terminal

            print_terminal(blocks)
            click.echo(f"results: {folder / ('report.html' if report else 'results.json')}")
            _say_going_on(results, folder, study_file)
            if sheet is not None:
                click.echo(f"sheet: {sheet}")
    _refuse_divergence(results)


def _say_going_on(results: dict[str, Any], folder: Path, study_file: str) -> None:
    """How the full-order proofs of a run go on."""
    for name, controller in results["controllers"].items():
        found = (controller["table"] or {}).get("full_order")
        if (more := going_on(found, folder / f"{name}.table.json", study_file)) is not None:
            click.echo(more)


def _run_plant(
    study: Study,
    folder: Path,
    bridge: str | None,
    as_json: bool,
    comtrade: str | None,
    *,
    report: bool,
    workers: int | None,
) -> None:
    """A plant of several converters."""
    from vsgdesign.report.page.terminal import print_terminal
    from vsgdesign.report.plant import plant_blocks
    from vsgdesign.verbs.pipeline.plant import run_plant_study

    if bridge is not None:
        study = replace(study, simulation=replace(study.simulation, bridge=bridge))
    with keeping(folder):
        with progress(quiet=as_json) as tell:
            result, document = run_plant_study(
                study,
                folder,
                report=report,
                workers=workers,
                progress=tell,
                warn=_warn,
                say=echo_aside if report else None,
                comtrade=comtrade,
            )
        if as_json:
            print_json(document)
        else:
            print_terminal(plant_blocks(result))
            click.echo(f"results: {folder / ('report.html' if report else 'results.json')}")
    _refuse_divergence(document)


def _refuse_divergence(results: dict[str, Any]) -> None:
    """The results are there; still a script has to notice that a part of them is missing."""
    outcomes = {name: controller["outcome"] for name, controller in results["controllers"].items()}
    from vsgdesign.errors import SimulationDivergedError

    diverged = [
        f"{name}: {one['reason']}" for name, one in outcomes.items() if one["status"] in ("diverged", "blocked")
    ]
    if diverged:
        raise SimulationDivergedError(". ".join(diverged) + ".")


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the report.  [default: out/NAME-comparison]")
@click.option("--emt/--no-emt", default=True, show_default=True, help="Also simulate steps with the real inner loops.")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the search for fixed gains."
)
@WORKERS
@JSON
@verb
def compare(study_file: str, out: str | None, emt: bool, seed: int, workers: int | None, as_json: bool) -> None:
    """Compare the controllers with the best fixed gains.

    All of them are evaluated on the same grids. The [specification] gives the requirements and their range. Gain
    tables that the study asks for are designed first.
    """
    from vsgdesign.verbs.pipeline.comparison import report_comparison

    study = load(study_file, left_tables=True, plants="as one unit")
    folder = Path("out") / f"{study.name}-comparison" if out is None else Path(out)
    found: list[Comparison] = []
    done = found.append
    with keeping(folder):
        with progress(quiet=as_json) as tell:
            document = report_comparison(study, folder, emt=emt, seed=seed, workers=workers, progress=tell, done=done)
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.comparison.page import comparison_page
        from vsgdesign.report.page.terminal import print_terminal

        print_terminal(comparison_page(found[0]).blocks)
        click.echo(f"report: {folder / 'report.html'}")


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Also write a page with maps into this folder.")
@click.option(
    "--what-if/--no-what-if",
    default=True,
    show_default=True,
    help="Also compute what sampling, delay and L_2 would improve.",
)
@click.option(
    "--remedies",
    is_flag=True,
    help="Design the inner loops of other hardware fully, for its current after phase jumps.",
)
@JSON
@verb
def inner(study_file: str, out: str | None, what_if: bool, remedies: bool, as_json: bool) -> None:
    """Show what the inner loops keep, and what limits them.

    The result also says what would improve them. Gains that the study leaves to be designed are designed once and
    kept beside it, for every verb.
    """
    from vsgdesign.verbs.pipeline.inner import assess_inner_loops, inner_document, report_inner_loops
    from vsgdesign.verbs.pipeline.opening import inner_loops_file

    study = load(study_file, quiet=as_json, plants="whole")
    with nullcontext() if out is None else results_at(out):
        with progress(quiet=as_json) as tell:
            if out is None:
                found = assess_inner_loops(study, what_if=what_if, remedies=remedies, progress=tell)
            else:
                found = report_inner_loops(study, out, what_if=what_if, remedies=remedies, progress=tell)
        document = inner_document(found)
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.page.terminal import print_terminal
        from vsgdesign.report.stability.inner import inner_page

        kept = inner_loops_file(study_file)
        file = str(kept) if found.designed and kept.exists() else None
        print_terminal(inner_page(document, file=file).blocks)
        if out is not None:
            click.echo(f"report: {out}/report.html")


@click.command()
@STUDY
@click.option("--deep", is_flag=True, help="Also find what a run would refuse, without a simulation.")
@click.option("--out", default=None, metavar="DIR", help="With --deep: folder of the run.  [default: out/NAME]")
@JSON
@verb
def validate(study_file: str, deep: bool, out: str | None, as_json: bool) -> None:
    """Check a study and its files, and report all faults at once.

    With --deep, everything that a run does before its first sample is done as well, and nothing is kept: gains, rests,
    circuits and starts of all controllers, the cells of tables that are not built yet, and the C of those that are.
    """
    from vsgdesign.errors import Fault, StudyError, VsgDesignError

    if out is not None and not deep:
        raise click.UsageError("--out is the folder of the run that --deep looks at: give --deep, too")
    try:
        from vsgdesign.verbs.pipeline.inputs import check_file

        study, inner_loops, said = check_file(study_file, deep, out)
    except VsgDesignError as error:
        if not as_json:
            raise
        impossible = [Fault("events" if not deep else "run", "", str(error))]
        source, faults = (error.source, error.faults) if isinstance(error, StudyError) else (study_file, impossible)
        print_json({"valid": False, "source": source, "faults": [vars(fault) for fault in faults]})
        sys.exit(exit_code(error))
    if as_json:
        document: dict[str, Any] = {"valid": True, "study": study.name, "hash": study.hash}
        document |= {"inner_loops": inner_loops} if inner_loops else {}
        print_json(document | ({"warnings": said} if deep else {}))
    else:
        counts = [(len(study.controllers), "controller"), (len(study.events), "event")]
        shown = ", ".join(counted(count, word) for count, word in counts)
        for text in said:
            _warn(text)
        click.echo(f"{study_file}: valid ({shown}){', and a run would begin' if deep else ''}")
        if inner_loops:
            click.echo(inner_loops)


@click.command()
@click.argument("path", metavar="STUDY.toml|RESULT", type=click.Path())
@click.option("--bibtex", is_flag=True, help="Print entries of BibTeX.")
@verb
def cite(path: str, bibtex: bool) -> None:
    """Name the papers and versions behind a study or a result.

    The argument is a study file, a folder of results, or its results.json. A result names the versions that it was made
    with; of a study, those that are installed are named.
    """
    from vsgdesign.verbs.pipeline.given_results import cite as found

    click.echo(visible("\n\n".join(one.bibtex() if bibtex else one.text() for one in found(path))))


RESULT = click.Path()


@click.command()
@click.argument("a", metavar="A", type=RESULT)
@click.argument("b", metavar="B", type=RESULT)
@JSON
@verb
def diff(a: str, b: str, as_json: bool) -> None:
    """Show what changed from result A to result B.

    A and B are folders of results, or their results.json. The output gives changed inputs, changed verdicts and changed
    figures with both values. The exit code is 1 if a verdict got worse.
    """
    from vsgdesign.verbs.pipeline.given_results import compare_results

    found = compare_results(a, b)
    if as_json:
        print_json(found.document())
    else:
        from vsgdesign.report.page.terminal import diff_blocks, print_terminal

        print_terminal(diff_blocks(found.document()))
    if found.worse:
        sys.exit(EXIT_IMPOSSIBLE)
