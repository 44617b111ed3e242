"""The verb that writes a study from a datasheet, which it reads from a file or asks for on the terminal."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vsgdesign.verbs.cli.common import JSON, Interrupted, print_json, results_at, verb

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
    from vsgdesign.verbs.pipeline.new import checked_text, new_document, new_lines

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
