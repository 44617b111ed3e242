"""Verbs of the impedance estimator."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsgdesign.errors import counted
from vsgdesign.verbs.cli.common import JSON, STUDY, WORKERS, in_blocks, load, print_json, progress, results_at, verb

if TYPE_CHECKING:
    from vsgdesign.execution.executors import How
    from vsgdesign.report.page.blocks import Block

_RECIPE = click.option(
    "--recipe",
    default=None,
    metavar="NAME|FILE.toml",
    help="A packaged recipe (published, continuous, wide; field for estimator train) or a file.  "
    "[default: that of the study, else published]",
)
_SEED = click.option(
    "--seed",
    type=click.IntRange(0),
    default=None,
    help="Seed of all random draws.  [default: that of the study, else 0]",
)


@click.group()
def estimator() -> None:
    """Train, compare and stress estimators of the grid impedance."""


@estimator.command()
@STUDY
@_RECIPE
@click.option("--out", required=True, metavar="FILE.npz", help="File for the windows.")
@_SEED
@in_blocks
@JSON
@verb
def windows(study_file: str, recipe: str | None, out: str, seed: int | None, how: How, as_json: bool) -> None:
    """Make a data set of windows from EMT simulations.

    The same command continues after an interruption.
    """
    from vsgdesign.estimator.recipes import describe_sampling, sampling_document, with_sampling
    from vsgdesign.estimator.specification import WINDOW_NETWORK, generate
    from vsgdesign.report.estimator.training import SYNCHRONISED, window_sentences
    from vsgdesign.study.parameters.estimator import EstimatorSpec

    study = load(study_file)
    spec = study.estimator or EstimatorSpec()
    made_of = WINDOW_NETWORK.recipes.load(spec.recipe if recipe is None else recipe)
    with results_at(out, _kept(out, "blocks", whole=False)):
        drawn_from = spec.seed if seed is None else seed
        with progress(quiet=as_json) as tell:
            data = generate(WINDOW_NETWORK, study, made_of, drawn_from, out=out, progress=tell, **how)
        scenarios, sampled = made_of.scenarios, with_sampling(made_of, study.converter)
        if as_json:
            print_json(
                {
                    "file": out,
                    "sha256": data.hash,
                    "windows": len(data),
                    "scenarios": scenarios,
                    "synchronised": data.synchronised,
                    "shape": data.windows.shape,
                    "draws": data.draws,
                    "window": sampling_document(sampled, study.converter),
                    "header": data.header,
                }
            )
        else:
            count, made_in = counted(len(data), "window"), counted(scenarios, "scenario")
            shape = f"{count} of {data.windows.shape[1]} values from {made_in}"
            click.echo(f"{out}: {shape}, sha256 {data.hash[:12]}")
            for sentence in window_sentences(describe_sampling(sampled, study.converter), data.draws):
                click.echo(sentence)
            if data.synchronised:
                click.echo(SYNCHRONISED)


@estimator.command()
@STUDY
@click.option("--out", required=True, metavar="FILE.json", help="File for the weights.")
@_RECIPE
@_SEED
@click.option(
    "--hidden",
    type=click.IntRange(1, 64),
    default=None,
    help="Number of hidden units.  [default: that of the study, else of the recipe]",
)
@click.option(
    "--components",
    type=click.IntRange(0, 1000),
    default=None,
    help="Number of principal components; 0: all above the noise.  [default: that of the study, else of the recipe]",
)
@click.option(
    "--windows", default=None, metavar="FILE.npz", help="Also keep the windows, or the runs of the recipe field."
)
@click.option(
    "--report",
    default=None,
    metavar="FOLDER",
    help="Folder for a report with figures. Only for the recipe field.",
)
@in_blocks
@JSON
@verb
def train(
    study_file: str,
    out: str,
    recipe: str | None,
    seed: int | None,
    hidden: int | None,
    components: int | None,
    windows: str | None,
    report: str | None,
    how: How,
    as_json: bool,
) -> None:
    """Train a network on simulated windows, and write its weights.

    The recipe field trains the network behind the field estimator; the others train the network of windows.
    """
    from dataclasses import replace

    from vsgdesign.estimator.specification import specification_of
    from vsgdesign.study.parameters.estimator import EstimatorSpec
    from vsgdesign.verbs.pipeline.estimators import train_weights_file

    study = load(study_file)
    given = {"recipe": recipe, "seed": seed, "hidden": hidden, "components": components}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    spec = replace(study.estimator or EstimatorSpec(), **changes)
    what = specification_of(spec.recipe).what
    with results_at(out, _kept(windows, what)):
        with progress(quiet=as_json) as tell:
            document = train_weights_file(study, spec, out, data=windows, report=report, progress=tell, **how)
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.estimator.training import trained_sentences

        for sentence in trained_sentences(document):
            click.echo(sentence)
        if report is not None:
            click.echo(f"report: {Path(report) / 'report.html'}")


def _kept(file: str | None, what: str, whole: bool = True) -> Callable[[], str]:
    """What an interruption says of what is kept beside a file or, if it counts when it is ``whole``, in it."""

    def kept() -> str:
        from vsgdesign.estimator.specification import kept_blocks

        if file is None or not (kept_blocks(file) or (whole and Path(file).exists())):
            return "nothing was written"
        return f"finished {what} are kept, the same command continues from them"

    return kept


BACKGROUNDS = ("clean", "measured", "dirty")
SENSORS = ("ideal", "typical", "dirty")
"""The packaged levels by name: importing them would make every verb slow to start."""

_COMPARED = (
    STUDY,
    click.option("--out", required=True, metavar="FOLDER", help="Folder for the results and the report."),
    click.option(
        "--weights",
        multiple=True,
        metavar="FILE.json",
        help="A network to compare. Repeat the option for several.",
    ),
    click.option(
        "--recipe",
        "recipes",
        multiple=True,
        metavar="NAME|FILE.toml",
        help="Train a network of this recipe and compare it. Repeat the option for several.  "
        "[default: without --weights: published, and continuous with noise]",
    ),
    _SEED,
    click.option(
        "--background",
        type=click.Choice(BACKGROUNDS),
        default=None,
        help="Packaged background of the grid, in place of that of the study.  [default: that of the study, else none]",
    ),
    click.option(
        "--sensors",
        type=click.Choice(SENSORS),
        default=None,
        help="Packaged sensors in the loop, in place of those of the study.  [default: those of the study, else white "
        "noise and 12 bits after the run]",
    ),
    WORKERS,
    JSON,
)
"""The arguments of the two verbs that compare methods."""


def _compares(function: Callable[..., None]) -> Callable[..., None]:
    """Give a verb the arguments of a comparison."""
    for argument in reversed(_COMPARED):
        function = argument(function)
    return function


@estimator.command()
@_compares
@verb
def compare(**asked: Any) -> None:
    """Compare classical methods and networks on the same windows.

    The report shows the error and its theoretical bound, how much each method disturbs the grid, and its delay.
    """
    from vsgdesign.report.estimator.page import comparison_terminal
    from vsgdesign.verbs.pipeline.estimators import report_comparison

    _report(report_comparison, comparison_terminal, **asked)


@estimator.command()
@_compares
@verb
def stress(**asked: Any) -> None:
    """Test the same methods in conditions they were not trained for.

    Frequency, phase, voltage, X/R, SCR, noise or harmonics differ from the training.
    """
    from vsgdesign.report.estimator.page import stress_terminal
    from vsgdesign.verbs.pipeline.estimators import report_stress

    _report(report_stress, stress_terminal, **asked)


def _report(
    make: Callable[..., dict[str, Any]],
    terminal: Callable[[Any], list[Block]],
    *,
    study_file: str,
    out: str,
    seed: int | None,
    background: str | None,
    sensors: str | None,
    as_json: bool,
    **networks: Any,
) -> None:
    from dataclasses import replace

    from vsgdesign.study.parameters.background import draw_background
    from vsgdesign.study.parameters.estimator import EstimatorSpec
    from vsgdesign.study.parameters.sensors import draw_sensors

    study = load(study_file)
    drawn_from = (study.estimator or EstimatorSpec()).seed if seed is None else seed
    if background is not None:
        study = replace(study, background=draw_background({}, drawn_from, background))
    if sensors is not None:
        study = replace(study, sensors=draw_sensors({}, drawn_from, sensors))
    found: list[Any] = []
    with results_at(out):
        with progress(quiet=as_json) as tell:
            document = make(study, out, seed=drawn_from, progress=tell, done=found.append, **networks)
        if as_json:
            print_json(document)
        else:
            from vsgdesign.report.page.terminal import print_terminal

            print_terminal([block for one in found for block in terminal(one)])
            for sentence in document["left_out"]:
                click.echo(sentence)
            click.echo(f"report: {Path(out) / 'report.html'}")
