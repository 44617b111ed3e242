"""Verbs of gain tables: build, show, check, compare, report."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from vsgdesign.verbs.cli.common import (
    EXIT_IMPOSSIBLE,
    EXPLORER,
    FULL_ORDER,
    JSON,
    STUDY,
    going_on,
    in_blocks,
    kept_words,
    load,
    print_json,
    progress,
    results_at,
    verb,
)

if TYPE_CHECKING:
    from vsgdesign.certificate.recheck.verdict import ProofCheck
    from vsgdesign.execution.executors import How
    from vsgdesign.linear.stability.gain_table import TableCheck
    from vsgdesign.study.parameters.study import Study

_FILE = click.argument("table_file", metavar="TABLE.json", type=click.Path())


@click.group()
def table() -> None:
    """Build, show, check and compare gain tables.

    A gain table contains gains over SCR and X/R with their promises, in one guarded file.
    """


@table.command()
@STUDY
@click.option(
    "--controller", default=None, metavar="NAME", help="The controller whose table is built.  [default: the last one]"
)
@click.option(
    "--out", default=None, metavar="FILE.json", help="File for the table.  [default: out/STUDY-CONTROLLER.json]"
)
@in_blocks
@click.option(
    "--points",
    type=click.IntRange(1),
    default=None,
    metavar="N",
    help="Number of random grids in each check between the nodes.  [default: 2000]",
)
@click.option(
    "--verify",
    type=click.IntRange(1),
    default=None,
    metavar="N",
    help="Also verify the table in N random EMT cases. Its file keeps the result.",
)
@FULL_ORDER
@JSON
@verb
def build(
    study_file: str,
    controller: str | None,
    out: str | None,
    how: How,
    points: int | None,
    verify: int | None,
    full_order: float,
    as_json: bool,
) -> None:
    """Design a table for the study's [specification].

    Every node is designed first, and then the table is checked and mended between the nodes.
    An interrupted or killed build continues from its finished cells and gives the same file.
    """
    from pathlib import Path

    from vsgdesign.verbs.pipeline.study_tables import CELLS
    from vsgdesign.verbs.pipeline.table import build_table_file, prove_table_file

    study = load(study_file, plants="as one unit")
    default = Path("out") / f"{study.name}-{controller or study.controllers[-1].name}.json"
    file = default if out is None else Path(out)

    with results_at(file, lambda: kept_words(file, CELLS, "cell")):
        with progress(quiet=as_json) as tell:
            document = build_table_file(
                study,
                file,
                controller=controller,
                points=points,
                verify=verify or 0,
                progress=tell,
                **how,
            )
            workers = how.get("workers")
            document |= prove_table_file(study, file, full_order, controller=controller, workers=workers, progress=tell)
        if as_json:
            print_json(document)
        else:
            from vsgdesign.report.gain_table.words import built_text

            click.echo(built_text(document))
            follows = any(spec.schedule == "table" for spec in study.controllers)
            if (more := going_on(document.get("full_order"), file, study_file, follows)) is not None:
                click.echo(more)


@table.command()
@_FILE
@click.option(
    "--sigma",
    is_flag=True,
    help="Show only how certain an estimate must be in each cell to be followed fully.",
)
@JSON
@verb
def show(table_file: str, sigma: bool, as_json: bool) -> None:
    """Show a table: its purpose, gains, margins and certificate."""
    from vsgdesign.artifacts.gain_table import table_document
    from vsgdesign.artifacts.gain_table_file import read_table_file
    from vsgdesign.runtime.needed_sigma import needed_sigmas

    found = read_table_file(table_file)
    if as_json and sigma:
        print_json({"scr": found.scr, "x_over_r": found.x_over_r, "needed_sigma": needed_sigmas(found)})
        return
    if as_json:
        print_json(table_document(found) | {"sha256": found.sha256})
        return
    from vsgdesign.report.gain_table.overview import sigma_blocks, table_blocks
    from vsgdesign.report.page.terminal import print_terminal

    print_terminal((sigma_blocks if sigma else table_blocks)(found))


@table.command()
@click.argument("table_file", metavar="[TABLE.json]", required=False, type=click.Path())
@click.option(
    "--study", "study_file", default=None, metavar="STUDY.toml", help="Also compare the table with its study."
)
@click.option(
    "--proof",
    is_flag=False,
    flag_value="",
    default=None,
    metavar="[FILE.proof]",
    help="Also check its full-order proof, for the converter of --study.  [default file: beside the table]",
)
@JSON
@verb
def check(table_file: str | None, study_file: str | None, proof: str | None, as_json: bool) -> None:
    """Read a table, and compute again what follows from it.

    Gains, margins, counts and the certificate's inequality at points are compared with the file. What cannot be
    computed again is listed as carried, not checked. The exit code is 1 if something does not agree with the file.

    With --proof, boxes and arcs of the proof of the sampled full-order loop are checked by a second derivation: all
    that they must cover, and the enclosures of at least 200 boxes. Without a table it is the proof of the study.
    """
    from vsgdesign.artifacts.gain_table_file import read_table_file
    from vsgdesign.verbs.pipeline.table import check_document, check_whole_table

    if proof is not None and study_file is None:
        raise click.UsageError("--proof needs --study: a table has no filter and no inner loops")
    if table_file is None and not proof:
        raise click.UsageError("give a TABLE.json, or the --proof FILE.proof of a --study")
    study = None if study_file is None else load(study_file, plants="as one unit")
    own: ProofCheck | None = None
    lines: list[str] = []
    document: dict[str, Any] = {}
    if proof is not None and study_file is not None:
        own, words = _check_proof(table_file, study_file, proof, as_json)
        document, lines = {"proof": own.as_document()}, [words]
    faults = own is not None and bool(own.faults)
    if table_file is not None:
        found = read_table_file(table_file)
        outcome = check_whole_table(found, study, own)
        document = {"table": found.name, "sha256": found.sha256} | check_document(outcome) | document
        from vsgdesign.report.gain_table.words import check_text

        lines.insert(0, check_text(table_file, found, outcome))
        faults |= bool(outcome.faults)
    if as_json:
        print_json(document)
    else:
        click.echo("\n".join(lines))
    if faults:
        sys.exit(EXIT_IMPOSSIBLE)


def _check_proof(table_file: str | None, study_file: str, proof: str, as_json: bool) -> tuple[ProofCheck, str]:
    """The check of a proof, and its words."""
    from vsgdesign.artifacts.gain_table_file import read_table_file
    from vsgdesign.artifacts.proof_file import proof_of
    from vsgdesign.report.gain_table.full_order import proof_check_text
    from vsgdesign.verbs.pipeline.full_order import check_proof_file
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.verify import with_table

    study = load(study_file, plants="whole")
    table = None
    place = proof
    if table_file is not None:
        table, place = read_table_file(table_file), proof or str(proof_of(table_file))
        study, _ = with_table(study, table_file)
    study = as_unit(study, "vsgdesign table check --proof")
    with progress(quiet=as_json) as tell:
        found = check_proof_file(place, study, table, progress=tell)
    return found, proof_check_text(place, found)


@table.command()
@click.argument("table_files", metavar="TABLE.json...", nargs=-1, required=True, type=click.Path())
@JSON
@verb
def compare(table_files: tuple[str, ...], as_json: bool) -> None:
    """Compare the gains and margins of two or more tables.

    All of them are compared on the grids of the first one.
    """
    from vsgdesign.artifacts.gain_table_file import read_table_file
    from vsgdesign.linear.stability.gain_table import compare_tables

    if len(table_files) < 2:
        raise click.UsageError("give at least two tables to compare")
    compared = compare_tables([read_table_file(path) for path in table_files], table_files)
    from vsgdesign.report.gain_table.overview import comparison_blocks, comparison_document
    from vsgdesign.report.page.terminal import print_terminal

    if as_json:
        print_json(comparison_document(compared, table_files))
    else:
        print_terminal(comparison_blocks(compared, table_files))


@table.command()
@_FILE
@click.option("--out", default=None, metavar="DIR", help="Folder for the report.  [default: out/NAME-table]")
@click.option(
    "--study", "study_file", default=None, metavar="STUDY.toml", help="The study with the converter that is simulated."
)
@EXPLORER
@JSON
@verb
def report(table_file: str, out: str | None, study_file: str | None, explorer: bool, as_json: bool) -> None:
    """Write the table as one page with figures.

    The page shows gains, margin maps, active constraints, the certificate, and stale schedules. With --study it
    simulates in the browser, too.
    """
    from pathlib import Path

    from vsgdesign.artifacts.gain_table_file import read_table_file
    from vsgdesign.verbs.pipeline.table import report_table

    found = read_table_file(table_file)
    folder = Path("out") / f"{Path(table_file).stem}-table" if out is None else Path(out)
    study = None if study_file is None or not explorer else _with_table(study_file, table_file)
    checked: list[TableCheck] = []
    with results_at(folder):
        with progress(quiet=as_json) as tell:
            document = report_table(found, folder, study=study, inputs=[table_file], progress=tell, done=checked.append)
        if as_json:
            print_json(document)
        else:
            from vsgdesign.report.gain_table.overview import table_answer, table_headline
            from vsgdesign.report.page.blocks import answered
            from vsgdesign.report.page.terminal import print_terminal

            print_terminal(answered(table_headline(found, checked[0]), *table_answer(found, checked[0])))
            click.echo(f"report: {folder / 'report.html'}")


def _with_table(study_file: str, table_file: str) -> Study:
    """The study with nothing but the controller that has the table."""
    from dataclasses import replace

    from vsgdesign.verbs.pipeline.verify import with_table

    study, name = with_table(load(study_file), table_file)
    return replace(study, controllers=tuple(spec for spec in study.controllers if spec.name == name))
