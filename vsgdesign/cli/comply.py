"""The verb that sends a study's controllers through suites of grid-code tests."""

from __future__ import annotations

import click

from vsgdesign.cli.common import EXIT_IMPOSSIBLE, JSON, STUDY, kept_words, load, print_json, progress, results_at, verb


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
@click.option(
    "--workers", type=click.IntRange(1), default=None, metavar="N", help="Number of processes.  [default: one per core]"
)
@click.option("--resume/--fresh", default=True, help="Continue an interrupted run, or begin again.  [default: resume]")
@click.option("--strict", is_flag=True, help="End with exit code 1 if a test fails.")
@JSON
@verb
def comply(
    study_file: str,
    suites: tuple[str, ...],
    controllers: tuple[str, ...],
    out: str | None,
    maps: bool,
    cases: str,
    workers: int | None,
    resume: bool,
    strict: bool,
    as_json: bool,
) -> None:
    """Run suites of grid-code tests, with a verdict for each test.

    The folder contains a page with the matrix of all tests and controllers, results.json, and the trace of every run as
    CSV. An interrupted or killed run continues with the same command.
    """
    from pathlib import Path

    from vsgdesign.compliance.journal import kept_rows
    from vsgdesign.pipeline.comply import ALL, Asked, comply_study, suites_of

    suites_of(suites or (ALL,))  # what is wrong with a suite is said before the inner loops are designed
    study = load(study_file, quiet=as_json)
    folder = Path("out") / f"{study.name}-compliance" if out is None else Path(out)
    asked = Asked(suites=suites or (ALL,), controllers=controllers, maps=maps, cases=cases, file=study_file)

    def kept() -> str:
        return kept_words(kept_rows(folder), "test")

    with results_at(folder, kept):
        with progress(quiet=as_json) as tell:
            document = comply_study(
                study, folder, asked, workers=workers, fresh=not resume, progress=tell, say=None if as_json else _say
            )
        if as_json:
            print_json(document)
        else:
            from vsgdesign.cli.console.comply import compliance_lines

            compliance_lines(document)
            page = folder / ("report.html" if (folder / "report.html").exists() else "results.json")
            click.echo(f"report: {page}")
    if strict and any(one["fail"] for one in document["summary"]):
        raise SystemExit(EXIT_IMPOSSIBLE)


def _say(sentence: str) -> None:
    click.echo(sentence, err=True)
