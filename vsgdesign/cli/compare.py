"""The verb that compares fixed, closed-form and table gains under one specification."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from vsgdesign.cli.common import JSON, STUDY, keeping, load, print_json, progress, verb

if TYPE_CHECKING:
    from vsgdesign.report.page.blocks import Block


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the report.  [default: out/NAME-comparison]")
@click.option("--emt/--no-emt", default=True, show_default=True, help="Also simulate steps with the real inner loops.")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the search for fixed gains."
)
@click.option(
    "--workers",
    type=click.IntRange(1),
    default=None,
    metavar="N",
    help="Number of processes for tables.  [default: one per core]",
)
@JSON
@verb
def compare(study_file: str, out: str | None, emt: bool, seed: int, workers: int | None, as_json: bool) -> None:
    """Compare the controllers with the best fixed gains.

    All of them are evaluated on the same grids. The [specification] gives the requirements and their range. Gain
    tables that the study asks for are designed first.
    """
    from pathlib import Path

    from vsgdesign.pipeline.comparison import report_comparison

    study = load(study_file, left_tables=True)
    folder = Path("out") / f"{study.name}-comparison" if out is None else Path(out)
    blocks: list[Block] = []
    show = None if as_json else blocks.extend
    with keeping(folder):
        with progress(quiet=as_json) as tell:
            document = report_comparison(study, folder, emt=emt, seed=seed, workers=workers, progress=tell, show=show)
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.page.terminal import print_terminal

        print_terminal(blocks)
        click.echo(f"report: {folder / 'report.html'}")
