"""Verbs of the impedance estimator."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from vsgdesign.cli_common import EXIT_INTERRUPTED, JSON, STUDY, load, print_json, progress, verb


@click.group()
def estimator() -> None:
    """Grid impedance from measured windows."""


@estimator.command()
@STUDY
@click.option("--recipe", default="published", show_default=True, metavar="NAME|FILE.toml",
              help="Packaged (published, continuous) or a file.")  # fmt: skip
@click.option("--out", required=True, metavar="FILE.npz", help="Where to write the windows.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@JSON
@verb
def windows(study_file: str, recipe: str, out: str, seed: int, workers: int, as_json: bool) -> None:
    """Make a data set of windows from EMT. An interrupted call goes on where it was."""
    from vsgdesign.estimator.recipes import load_recipe
    from vsgdesign.estimator.windows import generate_windows

    study, made_of = load(study_file), load_recipe(recipe)
    try:
        with progress(quiet=as_json) as tell:
            data = generate_windows(study, made_of, seed, out=out, workers=workers, progress=tell)
    except KeyboardInterrupt:
        click.echo("interrupted: finished blocks are kept, the same command goes on from them", err=True)
        sys.exit(EXIT_INTERRUPTED)
    scenarios = made_of.scenarios
    if as_json:
        print_json({
            "file": out, "sha256": data.hash, "windows": len(data), "scenarios": scenarios,
            "synchronised": data.synchronised, "shape": data.windows.shape, "header": data.header,
        })  # fmt: skip
    else:
        shape = f"{len(data)} windows of {data.windows.shape[1]} values from {scenarios} scenarios"
        click.echo(f"{out}: {shape}, sha256 {data.hash[:12]}")
        if data.synchronised:
            click.echo("synchronised with the grid's phase, as published: no converter in the field has that signal")


@estimator.command()
@STUDY
@click.option("--out", required=True, metavar="FILE.json", help="Where to write the weights.")
@click.option("--recipe", default=None, metavar="NAME|FILE.toml", help="[default: of the study, else published]")
@click.option("--seed", type=click.IntRange(0), default=None, help="[default: of the study, else 0]")
@click.option(
    "--hidden", type=click.IntRange(1, 64), default=None, help="Hidden units.  [default: of the study, else 8]"
)
@click.option("--components", type=click.IntRange(0, 1000), default=None,
              help="Principal components; 0: all above the noise.  [default: of the study, else 6]")  # fmt: skip
@click.option("--windows", default=None, metavar="FILE.npz", help="Keep the windows too.")
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@JSON
@verb
def train(
    study_file: str, out: str, recipe: str | None, seed: int | None, hidden: int | None, components: int | None,
    windows: str | None, workers: int, as_json: bool,
) -> None:  # fmt: skip
    """Make windows, train a network on them and write its weights."""
    from dataclasses import replace

    from vsgdesign.parameters.estimator import EstimatorSpec
    from vsgdesign.pipeline.training import train_weights_file

    study = load(study_file)
    given = {"recipe": recipe, "seed": seed, "hidden": hidden, "components": components}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    spec = replace(study.estimator or EstimatorSpec(), **changes)
    with progress(quiet=as_json) as tell:
        document = train_weights_file(study, spec, out, windows=windows, workers=workers, progress=tell)
    if as_json:
        print_json(document)
        return
    test = document["parts"]["test"]["correlation"]
    click.echo(
        f"{out}: recipe {document['recipe']}, {document['epochs']} epochs, {document['stop']}; on the windows for test "
        f"R = {test['R_g']:.6f} (R_g), {test['L_g']:.6f} (L_g)"
    )
    if document["synchronised"]:
        click.echo("synchronised with the grid's phase, as published: no converter in the field has that signal")


_FOLDER = click.option("--out", required=True, metavar="FOLDER", help="Where to write results and report.")
_WEIGHTS = click.option("--weights", "weights", multiple=True, metavar="FILE.json",
                        help="Networks to compare.  [default: two are trained]")  # fmt: skip


@estimator.command()
@STUDY
@_FOLDER
@_WEIGHTS
@JSON
@verb
def compare(study_file: str, out: str, weights: tuple[str, ...], as_json: bool) -> None:
    """Classical methods and networks on the same windows: error beside its bound, disturbance, delay."""
    from vsgdesign.pipeline.estimator import report_comparison

    _report(report_comparison, study_file, out, weights, as_json)


@estimator.command()
@STUDY
@_FOLDER
@_WEIGHTS
@JSON
@verb
def stress(study_file: str, out: str, weights: tuple[str, ...], as_json: bool) -> None:
    """The same methods where frequency, phase, voltage, X/R, SCR, noise or harmonics are not as trained."""
    from vsgdesign.pipeline.estimator import report_stress

    _report(report_stress, study_file, out, weights, as_json)


def _report(
    make: Callable[..., dict[str, Any]], study_file: str, out: str, weights: tuple[str, ...], as_json: bool
) -> None:
    with progress(quiet=as_json) as tell:
        document = make(load(study_file), out, weights=weights, progress=tell)
    if as_json:
        print_json(document)
    else:
        click.echo(f"report: {Path(out) / 'report.html'}")
