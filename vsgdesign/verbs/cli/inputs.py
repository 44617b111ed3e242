"""The verbs that begin a study: from a converter's datasheet, and from the model of its network."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vsgdesign.verbs.cli.common import JSON, Interrupted, print_json, progress, results_at, verb

if TYPE_CHECKING:
    from vsgdesign.study.datasheet import Sheet


_BACK = ("back", "<")


@click.command(context_settings={"allow_extra_args": True})  # new says itself to which option one belongs
@click.option(
    "--from",
    "sheet_file",
    default=None,
    metavar="FILE|case:NAME",
    type=click.Path(),
    help="A datasheet in .csv or .toml format, or a converter of the package.  [default: ask on the terminal]",
)
@click.option(
    "--out",
    default="study.toml",
    show_default=True,
    metavar="FILE.toml",
    type=click.Path(),
    help="The study to write. An existing file is never overwritten.",
)
@click.option(
    "--impedance",
    "impedance_file",
    default=None,
    metavar="FILE.csv",
    type=click.Path(),
    help="The grid's impedance as it was measured over frequency, in place of `scr` and `x_over_r`.",
)
@JSON
@verb
def new(sheet_file: str | None, out: str, impedance_file: str | None, as_json: bool) -> None:
    """Write a study from a converter's datasheet.

    The datasheet gives ratings, filter, sampling, current limit and grids. The inner loops and the gain table are
    left to be designed by `vsgdesign run`. Values that the datasheet does not give are assumed, listed here, and
    written into the study.
    """
    from vsgdesign.artifacts.files import check_new, write_new_text
    from vsgdesign.study.datasheet import read_sheet
    from vsgdesign.verbs.pipeline.inputs import checked_text, new_document, new_lines

    if loose := click.get_current_context().args:
        raise click.UsageError(f"{shlex.join(loose)} belongs to an option. {_what_to_type(loose[0])}")
    path = check_new(out)
    if sheet_file is not None:
        sheet, origin = read_sheet(sheet_file), Path(sheet_file).name
    elif not sys.stdin.isatty():
        raise click.UsageError(f"There is no terminal to ask on. {_what_to_type('FILE.csv')}")
    else:
        try:
            sheet, origin = _asked(), "answers on the terminal"
        except click.Abort:  # Ctrl-C or Ctrl-D at a prompt
            click.echo(err=True)
            raise Interrupted("nothing was written") from None
    converter, text = checked_text(sheet, origin, impedance_file)
    with results_at(path):
        write_new_text(path, text)
        if as_json:
            print_json(new_document(converter, path))
        else:
            for line in new_lines(converter, path):
                click.echo(line)


def _what_to_type(file: str) -> str:
    """How a study is begun: with a datasheet, with a converter of the package, or by answers."""
    from vsgdesign.study.parameters import case_names

    ways = (
        (f"vsgdesign new --from {shlex.quote(file)}", 'a datasheet: a row "rating, 250, kVA" for each field, or TOML'),
        ("vsgdesign new --from case:NAME", "a converter of the package"),
        (f"vsgdesign new --out {shlex.quote(str(Path(file).with_suffix('.toml')))}", "answers on the terminal"),
    )
    said = "\n".join(f"  {command}\n      {what}" for command, what in ways)
    return f"Type one of\n{said}\nNAME is one of {', '.join(case_names())}."


def _asked() -> Sheet:
    """A datasheet from answers. Each answer is checked immediately; ``back`` returns to the previous question."""
    from vsgdesign.study.datasheet.reading import Entry
    from vsgdesign.study.datasheet.resolving import answer_faults, answered_sheet, entry_of, next_question

    click.echo(
        "Answer from the datasheet, with units. Enter accepts the value in brackets, back returns, Ctrl-C ends.\n"
    )
    answers: list[Entry] = []
    asked: list[str] = []
    while (field := next_question(answers, asked)) is not None:
        offered = f"[{field.missing}]" if field.missing else f"(such as {field.example})"
        text = click.prompt(f"{field.question} {offered}", default="", show_default=False).strip()
        if text.casefold() in _BACK:
            if asked:
                last = asked.pop()
                answers = [entry for entry in answers if entry_of_field(entry.key) != last]
            continue
        if not text and not field.missing:
            click.echo(f"  It must be given, for example {field.example}.")
            continue
        left_out = text.casefold() in ("", "none", "no", "-") and field.name != "delay"
        if text and not left_out:
            answer = entry_of(field, text)
            faults = answer_faults(answers, answer)
            if faults:
                for fault in faults:
                    click.echo(f"  {fault}")
                continue
            answers.append(answer)
        asked.append(field.name)
    click.echo()
    return answered_sheet(answers)


def entry_of_field(key: str) -> str:
    """The question to which an answer belongs."""
    return "scr" if key in ("short_circuit_power", "grid_impedance") else key


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
    from vsgdesign.verbs.pipeline.inputs import asked_of

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
