"""The verb that sends a study's controllers through jumps, faults and phase steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from vsgdesign.verbs.cli.common import EXPLORER, JSON, STUDY, in_blocks, keeping, load, print_json, progress, verb

if TYPE_CHECKING:
    from vsgdesign.execution.executors import How


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME-survival]")
@click.option(
    "--controller",
    "controllers",
    multiple=True,
    metavar="NAME",
    help="Only this controller. May be repeated.  [default: all]",
)
@click.option(
    "--limiter",
    "limiters",
    multiple=True,
    metavar="NAME",
    help="Replace the study's current limiter by this one; none: no limiter. May be repeated.",
)
@click.option(
    "--bridge", type=click.Choice(["averaged", "pwm"]), default="averaged", show_default=True, help="Bridge model."
)
@EXPLORER
@in_blocks
@JSON
@verb
def survive(
    study_file: str,
    out: str | None,
    controllers: tuple[str, ...],
    limiters: tuple[str, ...],
    bridge: str,
    explorer: bool,
    how: How,
    as_json: bool,
) -> None:
    """Send the controllers through jumps, faults and phase steps.

    The systematic disturbances are always the same; [survival] in the study adds random ones. An interrupted
    measurement continues with the same command.
    """
    from pathlib import Path

    from vsgdesign.verbs.pipeline.survival import Asked, report_survival

    study = load(study_file, left_tables=True, plants="whole")
    folder = Path("out") / f"{study.name}-survival" if out is None else Path(out)
    with keeping(folder):
        with progress(quiet=as_json) as tell:
            document = report_survival(
                study,
                folder,
                Asked(controllers or None, limiters or None, bridge, explorer),
                progress=tell,
                **how,
            )
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.page.terminal import print_terminal
        from vsgdesign.report.survival import survival_blocks

        print_terminal(survival_blocks(document))
        click.echo(f"results: {folder / 'report.html'}, every case: {folder / 'cases.csv'}")
