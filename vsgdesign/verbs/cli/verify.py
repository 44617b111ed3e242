"""The verb that verifies a controller in random cases."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from vsgdesign.verbs.cli.common import (
    EXPLORER,
    FILE,
    JSON,
    STUDY_OF_TABLE,
    Real,
    in_blocks,
    kept_words,
    load,
    print_json,
    progress,
    results_at,
    verb,
)

if TYPE_CHECKING:
    from vsgdesign.campaigns.verification.blocks import Shard
    from vsgdesign.execution.executors import How


def _shard(_context: click.Context, _parameter: click.Parameter, text: str | None) -> Shard | None:
    if text is None:
        return None
    from vsgdesign.campaigns.verification.blocks import Shard

    try:
        return Shard.read(text)
    except ValueError as error:
        raise click.BadParameter(f"{error}.") from None


@click.command()
@FILE
@STUDY_OF_TABLE
@click.option("--controller", default=None, metavar="NAME", help="The controller to verify.  [default: the last one]")
@click.option(
    "--runs", type=click.IntRange(1), default=None, metavar="N", help="Number of random cases.  [default: the study's]"
)
@click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=None, help="Seed of the random cases.  [default: the study's]"
)
@click.option(
    "--confidence",
    type=Real(0.5, 0.999999),
    default=None,
    help="Confidence with which each bound holds.  [default: the study's]",
)
@click.option(
    "--bridge", type=click.Choice(["averaged", "pwm"]), default="averaged", show_default=True, help="Bridge model."
)
@click.option("--strict", is_flag=True, help="Give the same bytes on every x86 processor. This is slower.")
@click.option(
    "--search",
    type=click.IntRange(0),
    default=None,
    metavar="N",
    help="Number of further runs that search for worse cases. They do not count in the shares.  "
    "[default: 5 % of the runs]",
)
@in_blocks
@click.option(
    "--shard",
    callback=_shard,
    default=None,
    metavar="i/N",
    help="Simulate only part i of N. --merge puts the parts together.",
)
@click.option(
    "--merge",
    multiple=True,
    metavar="DIR",
    type=click.Path(),
    help="Read the parts in this folder instead of simulating. May be repeated.",
)
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME-verification]")
@EXPLORER
@JSON
@verb
def verify(
    file: str,
    study_file: str | None,
    controller: str | None,
    runs: int | None,
    seed: int | None,
    confidence: float | None,
    bridge: str,
    strict: bool,
    search: int | None,
    how: How,
    shard: Shard | None,
    merge: tuple[str, ...],
    out: str | None,
    explorer: bool,
    as_json: bool,
) -> None:
    """Simulate random cases, and bound the share of failures.

    The study's [verification] says what is drawn. The bound is exact, and the worst cases are written as study files.
    An interrupted or killed verification continues with the same command and gives the same counts.
    """
    from pathlib import Path

    from vsgdesign.verbs.pipeline.verify import WORK, Asked, merge_shards, verify_study, with_table

    _check_options(file, study_file, shard is not None, merge, (controller, runs, seed, how.get("cluster")))
    study = load(file if study_file is None else study_file, left_tables=study_file is None, plants="whole")
    if study_file is not None:
        study, controller = with_table(study, file, controller)
    name = f"{study.name}-verification" + ("" if shard is None else f"/shard-{shard.number}-of-{shard.of}")
    folder = Path("out") / name if out is None else Path(out)
    asked = Asked(
        controller=controller,
        runs=runs,
        seed=seed,
        confidence=confidence,
        bridge=bridge,
        strict=strict,
        search=search,
        explorer=explorer,
    )
    with results_at(folder, lambda: kept_words(folder, WORK, "run")):
        with progress(quiet=as_json) as tell:
            if merge:
                document = merge_shards(study, merge, folder, asked, workers=how.get("workers"), progress=tell)
            else:
                document = verify_study(study, folder, asked, shard=shard, progress=tell, **how)
        if as_json:
            print_json(document)
        elif shard is not None:
            click.echo(f"shard {shard}: {document['judged']:,} of {document['runs']:,} runs were judged; {folder}")
        else:
            from vsgdesign.report.page.terminal import print_terminal
            from vsgdesign.report.verification.page import verification_page

            print_terminal(verification_page(document).blocks)
            click.echo(f"report: {folder / 'report.html'}")


def _check_options(
    file: str,
    study_file: str | None,
    sharded: bool,
    merge: tuple[str, ...],
    of_runs: tuple[object, ...],
) -> None:
    if study_file is None and file.lower().endswith(".json"):
        problem = (
            f"{file} is no study. If it is a gain table, --study names the study with whose converter it is verified"
        )
        raise click.UsageError(problem)
    if merge and sharded:
        raise click.UsageError("--shard runs a part, --merge puts parts together: give one of them")
    if merge and any(value is not None for value in of_runs):
        raise click.UsageError("--controller, --runs, --seed and --cluster are those of the shards that --merge reads")
