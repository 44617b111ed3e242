"""The verbs that simulate a study: with everything that belongs to it, or alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsgdesign.cli.common import BRIDGE, JSON, STUDY, keeping, load, print_json, progress, verb

if TYPE_CHECKING:
    from vsgdesign.report.page.blocks import Block


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME]")
@BRIDGE
@JSON
@verb
def run(study_file: str, out: str | None, bridge: str | None, as_json: bool) -> None:
    """Design, simulate and report everything, and write C.

    The folder contains time series, figures, results.json, report.html, gain tables and their C.
    """
    _run(study_file, out, bridge, as_json, report=True)


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME-simulation]")
@BRIDGE
@JSON
@verb
def simulate(study_file: str, out: str | None, bridge: str | None, as_json: bool) -> None:
    """Simulate every controller, and write the time series.

    The folder contains time series and results.json.
    """
    _run(study_file, out, bridge, as_json, report=False)


def _warn(text: str) -> None:
    click.echo(f"warning: {text}", err=True)


def _say(text: str) -> None:
    click.echo(text, err=True)


def _run(study_file: str, out: str | None, bridge: str | None, as_json: bool, report: bool) -> None:
    from vsgdesign.pipeline import run_study

    study = load(study_file, left_tables=not report)
    name = study.name if report else f"{study.name}-simulation"
    folder = Path("out") / name if out is None else Path(out)
    blocks: list[Block] = []
    show = None if as_json else blocks.extend
    with keeping(folder):
        with progress(quiet=as_json) as tell:
            results = run_study(
                study, folder, bridge=bridge, report=report, progress=tell, warn=_warn, say=_say, show=show
            )
        if as_json:
            print_json(results)
        else:
            from vsgdesign.report.page.terminal import print_terminal

            print_terminal(blocks)
            click.echo(f"results: {folder / ('report.html' if report else 'results.json')}")
    _refuse_divergence(results)


def _refuse_divergence(results: dict[str, Any]) -> None:
    """The results are there; still a script has to notice that a part of them is missing."""
    outcomes = {name: controller["outcome"] for name, controller in results["controllers"].items()}
    from vsgdesign.errors import SimulationDivergedError

    diverged = [f"{name}: {one['reason']}" for name, one in outcomes.items() if one["status"] == "diverged"]
    if diverged:
        raise SimulationDivergedError(". ".join(diverged) + ".")
