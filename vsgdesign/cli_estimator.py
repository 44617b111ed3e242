"""Verbs of the impedance estimator."""

from __future__ import annotations

import sys

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
