"""The verb that sends a study's controllers through suites of grid-code tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from vsgdesign.verbs.cli.common import (
    COMTRADE,
    EXIT_IMPOSSIBLE,
    JSON,
    STUDY,
    in_blocks,
    kept_words,
    load,
    print_json,
    progress,
    results_at,
    verb,
)

if TYPE_CHECKING:
    from vsgdesign.execution.executors import How


@click.command()
@STUDY
@click.option(
    "--suite",
    "suites",
    multiple=True,
    metavar="NAME|FILE.toml|all",
    help="A packaged suite, a file of your own, or all packaged ones. May be repeated.  [default: all]",
)
@click.option(
    "--controller",
    "controllers",
    multiple=True,
    metavar="NAME",
    help="Only this controller. May be repeated.  [default: all]",
)
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME-compliance]")
@click.option("--maps/--no-maps", default=True, help="Also draw survival maps of every controller.  [default: yes]")
@click.option(
    "--cases",
    type=click.Choice(["failing", "all", "none"]),
    default="failing",
    show_default=True,
    help="Which rows of the matrix to write as study files.",
)
@COMTRADE
@in_blocks
@click.option(
    "--must-pass",
    "--strict",
    "must_pass",
    is_flag=True,
    help="End with exit code 1 if a test fails. --strict says the same.",
)
@JSON
@verb
def comply(
    study_file: str,
    suites: tuple[str, ...],
    controllers: tuple[str, ...],
    out: str | None,
    maps: bool,
    cases: str,
    comtrade: str | None,
    how: How,
    must_pass: bool,
    as_json: bool,
) -> None:
    """Run suites of grid-code tests, with a verdict for each test.

    The folder contains a page with the matrix of all tests and controllers, results.json, and the trace of every run as
    CSV. An interrupted or killed run continues with the same command.
    """
    from pathlib import Path

    from vsgdesign.verbs.pipeline.comply import ALL, WORK, Asked, comply_study, suites_of

    suites_of(suites or (ALL,))  # what is wrong with a suite is said before the inner loops are designed
    study = load(study_file, quiet=as_json, plants="whole")
    folder = Path("out") / f"{study.name}-compliance" if out is None else Path(out)
    asked = Asked(
        suites=suites or (ALL,), controllers=controllers, maps=maps, cases=cases, file=study_file, comtrade=comtrade
    )

    if as_json:
        how = {**how, "say": None}
    with results_at(folder, lambda: kept_words(folder, WORK, "test")):
        with progress(quiet=as_json) as tell:
            document = comply_study(study, folder, asked, progress=tell, **how)
        if as_json:
            print_json(document)
        else:
            from vsgdesign.report.compliance.page import terminal_blocks
            from vsgdesign.report.page.terminal import print_terminal

            print_terminal(terminal_blocks(document))
            page = folder / ("report.html" if (folder / "report.html").exists() else "results.json")
            click.echo(f"report: {page}")
    if must_pass and any(one["fail"] for one in document["summary"]):
        raise SystemExit(EXIT_IMPOSSIBLE)
