"""The verb that sizes the dc side."""

from __future__ import annotations

import click

from vsgdesign.verbs.cli.common import JSON, STUDY, echo_aside, keeping, load, print_json, progress, verb


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

    from vsgdesign.study.parameters.units import UnitError, parse_quantity
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
    from vsgdesign.study.parameters.units import UnitError, parse_quantity

    name, _, value = text.partition("=")
    if name not in _UNITS:
        raise click.UsageError(f'--keep "{text}": must be power=…, capacitor=… or energy=….')
    try:
        return name, parse_quantity(value, _UNITS[name])
    except UnitError as error:
        raise click.UsageError(f'--keep "{text}": {error}') from None
