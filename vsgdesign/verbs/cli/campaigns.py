"""The verbs of campaigns: random cases, disturbances, suites of grid-code tests, and the size of the dc side that they
ask for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from vsgdesign.verbs.cli.common import (
    COMTRADE,
    EXIT_IMPOSSIBLE,
    EXPLORER,
    FILE,
    JSON,
    STUDY,
    STUDY_OF_TABLE,
    Real,
    check_study_of,
    echo_aside,
    in_blocks,
    keeping,
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
    check_study_of(file, study_file)
    if merge and sharded:
        raise click.UsageError("--shard runs a part, --merge puts parts together: give one of them")
    if merge and any(value is not None for value in of_runs):
        raise click.UsageError("--controller, --runs, --seed and --cluster are those of the shards that --merge reads")


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


@click.command()
@STUDY
@click.option("--out", default=None, metavar="DIR", help="Folder for the results.  [default: out/NAME-dc-side]")
@click.option("--controller", default=None, metavar="NAME", help="Of which controller.  [default: the last one]")
@click.option(
    "--capacitor",
    default=None,
    metavar="QUANTITY",
    help='The capacitor with which the least power is found, such as "2 mF".  [default: that of [dc], or 10 ms of the '
    "rating]",
)
@click.option(
    "--source",
    type=click.Choice(["converter", "battery"]),
    default=None,
    help="Behind a dc–dc stage, or a battery directly on the link.  [default: that of [dc], else converter]",
)
@click.option(
    "--keep",
    "kept",
    multiple=True,
    metavar="SIZE=QUANTITY",
    help='A size that is given and not searched for: "power=9 kW", "capacitor=2 mF" or "energy=20000 J". May be '
    "repeated.",
)
@click.option(
    "--suite",
    "suites",
    multiple=True,
    metavar="NAME|FILE.toml",
    help="Size for the grid-code tests of a suite in place of the study's events. May be repeated.",
)
@JSON
@verb
def size(
    study_file: str,
    out: str | None,
    controller: str | None,
    capacitor: str | None,
    source: str | None,
    kept: tuple[str, ...],
    suites: tuple[str, ...],
    as_json: bool,
) -> None:
    """Size the dc side: power of the source, capacitor and energy.

    The study's events, or the tests of a suite, are survived with the sizes, and full simulations with 5 % less of each
    show what is lost then. The order is: least power, with 10 % more the least capacitor, then the
    least energy.
    """
    from pathlib import Path

    from vsgdesign.study.parameters.reader import UnitError, parse_quantity
    from vsgdesign.verbs.pipeline.sizing import WORK, size_study

    try:
        C = None if capacitor is None else parse_quantity(capacitor, "F")
    except UnitError as error:
        raise click.UsageError(f'--capacitor "{capacitor}": {error}') from None
    keep = dict(_kept(one) for one in kept)
    study = load(study_file, left_tables=True)
    folder = Path("out") / f"{study.name}-{WORK}" if out is None else Path(out)
    with keeping(folder):
        with progress(quiet=as_json) as tell:
            document = size_study(
                study,
                folder,
                controller=controller,
                C=C,
                source=source,
                keep=keep,
                suites=suites,
                progress=tell,
                say=echo_aside,
            )
        if as_json:
            print_json(document)
            return
        from vsgdesign.report.page.terminal import print_terminal
        from vsgdesign.report.sizing import sizing_blocks

        print_terminal(sizing_blocks(document))
        click.echo(f"results: {folder / 'report.html'}")


_UNITS = {"power": "W", "capacitor": "F", "energy": "J"}


def _kept(text: str) -> tuple[str, float]:
    """A size that is given, from the command line."""
    from vsgdesign.study.parameters.reader import UnitError, parse_quantity

    name, _, value = text.partition("=")
    if name not in _UNITS:
        raise click.UsageError(f'--keep "{text}": must be power=…, capacitor=… or energy=….')
    try:
        return name, parse_quantity(value, _UNITS[name])
    except UnitError as error:
        raise click.UsageError(f'--keep "{text}": {error}') from None
