"""The verb that takes the grid from a network model."""

from __future__ import annotations

import re
from pathlib import Path

import click

from vsgdesign.verbs.cli.common import JSON, print_json, progress, results_at, verb


@click.command()
@click.argument("network", metavar="NETWORK", type=click.Path())
@click.option("--bus", required=True, metavar="NAME", help="The bus at which the converter is.")
@click.option("--s", "S", required=True, metavar="VA", help='Rating of the converter, such as "5 MVA".')
@click.option(
    "--outages",
    default="n-1",
    show_default=True,
    metavar="n-1|none|FILE",
    help='Outages: of each element, none, or a file with one in each line; ";" between elements that are out together.',
)
@click.option("--source-s", default=None, metavar="VA", help="Short-circuit power behind each slack bus.")
@click.option("--source-x-over-r", default=None, metavar="X/R", help="X/R behind each slack bus.")
@click.option("--machine-x", default=None, metavar="PU", help="Sub-transient reactance of each machine, of its rating.")
@click.option("--machine-x-over-r", default=None, metavar="X/R", help="X/R of each machine.")
@click.option(
    "--source",
    "sources",
    multiple=True,
    metavar="NAME=VA,X/R|none|FILE.csv",
    help='One source by its name, such as "G 1 = 2 GVA, 10", or none of it, or a file of them. May be repeated.',
)
@click.option("--loads/--no-loads", default=False, show_default=True, help="Let loads count as impedances.")
@click.option("--frequency", default=None, metavar="Hz", help="Nominal frequency.  [default: the file's, else 50 Hz]")
@click.option("--base", default=None, metavar="STUDY.toml|case:NAME", help="Study with the converter, for --out.")
@click.option(
    "--out",
    default=None,
    metavar="STUDY.toml",
    type=click.Path(),
    help="Also write the grids as a study. Never replaced.",
)
@click.option("--report", default=None, metavar="DIR", help="Folder for the page.  [default: out/NETWORK-BUS]")
@JSON
@verb
def grid(
    network: str,
    bus: str,
    S: str,
    outages: str,
    source_s: str | None,
    source_x_over_r: str | None,
    machine_x: str | None,
    machine_x_over_r: str | None,
    sources: tuple[str, ...],
    loads: bool,
    frequency: str | None,
    base: str | None,
    out: str | None,
    report: str | None,
    as_json: bool,
) -> None:
    """Take SCR and X/R at a bus from a network model.

    NETWORK is a file of pandapower (.json), or one that pypowsybl reads (CGMES, PSS/E, PowerFactory, MATPOWER ...). The
    impedance is that of the network's Y matrix, with everything in and in every outage. With --out the grids are the
    [grid] and [specification] of a study. What the file does not say of a source is asked for by its name.
    """
    from vsgdesign.verbs.pipeline.grid import grid_document, report_grid
    from vsgdesign.verbs.pipeline.grid_asked import asked_of

    asked = asked_of(
        bus=bus,
        S=S,
        outages=outages,
        source=(source_s, source_x_over_r),
        machine=(machine_x, machine_x_over_r),
        named=_named(sources),
        loads=loads,
        frequency=frequency,
    )
    folder = Path("out") / re.sub(r"[^\w.-]+", "_", f"{Path(network).stem}-{bus}") if report is None else Path(report)
    with results_at(folder):
        with progress(quiet=as_json) as tell:
            found = report_grid(network, folder, asked, study=out, base=base, progress=tell)
        if as_json:
            print_json(grid_document(found))
            return
        from vsgdesign.report.network import grid_page
        from vsgdesign.report.page.terminal import print_terminal

        print_terminal(grid_page(grid_document(found)).blocks)
        if out is not None:
            click.echo(f"study: {out}")
        click.echo(f"report: {folder / 'report.html'}")


def _named(sources: tuple[str, ...]) -> dict[str, tuple[str, str] | None]:
    """Sources by name: short-circuit power and X/R, or none. A file has one in each line, with commas."""
    found: dict[str, tuple[str, str] | None] = {}
    lines: list[str] = []
    for text in sources:
        if text.lower().endswith(".csv"):
            lines += _lines(text)
        else:
            lines.append(text)
    for text in lines:
        name, is_there, told = (part.strip() for part in text.rpartition("="))
        S_sc, comma, ratio = (part.strip() for part in told.partition(","))
        if not is_there or not name or (told != "none" and not comma):
            raise click.BadParameter(f'"{text}" is not NAME=VA,X/R or NAME=none.', param_hint="--source")
        found[name] = None if told == "none" else (S_sc, ratio)
    return found


def _lines(path: str) -> list[str]:
    """The lines of a file of sources, as the option takes them."""
    from vsgdesign.study.given_files import RESULT_BYTES, read_given

    try:
        lines = read_given(Path(path), RESULT_BYTES).decode().splitlines()
    except (OSError, ValueError) as error:
        raise click.BadParameter(f'"{path}" cannot be read ({error}).', param_hint="--source") from None
    return [line.replace(",", "=", 1) for line in lines if line.strip() and not line.startswith("#")]
