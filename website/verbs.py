"""Writes docs/verbs.md, the reference of all verbs and options, from the program: ``python -m website.verbs``."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator

import click

from vsgdesign.verbs.cli.program import main as program
from website.staging import ROOT

PAGE = ROOT / "docs" / "verbs.md"
GUIDES = {
    "certify": "[certificate](theory/certificate.md)",
    "cite": "[results](how-to/results.md)",
    "compare": "[comparison](comparison.md)",
    "comply": "[grid-code tests](how-to/comply.md)",
    "design": "[tutorial](tutorial.md)",
    "diff": "[results](how-to/results.md)",
    "estimator compare": "[compare estimators](how-to/compare-estimators.md)",
    "estimator stress": "[compare estimators](how-to/compare-estimators.md)",
    "estimator train": "[estimator](how-to/estimator.md)",
    "estimator windows": "[windows](how-to/windows.md)",
    "explore": "[explore](how-to/explore.md)",
    "export all": "[all kinds](how-to/export-other-tools.md)",
    "export c": "[integrate C](how-to/integrate-c.md)",
    "export dll": "[DLL](how-to/export-dll.md)",
    "export firmware": "[firmware](how-to/export-firmware.md)",
    "export fmu": "[FMU](how-to/export-fmu.md)",
    "export modelica": "[Modelica](how-to/export-other-tools.md)",
    "export onnx": "[integrate C](how-to/integrate-c.md)",
    "export plecs": "[PLECS](how-to/export-other-tools.md)",
    "export simulink": "[Simulink](how-to/export-other-tools.md)",
    "export sunspec": "[SunSpec](how-to/export-other-tools.md)",
    "grid": "[the grid from a network](how-to/grid-from-network.md)",
    "inner": "[inner loops](how-to/inner-loops.md)",
    "margins": "[margins and maps](how-to/margins-and-maps.md)",
    "new": "[own converter](how-to/own-converter.md)",
    "pil": "[firmware](how-to/export-firmware.md)",
    "report": "[margins and maps](how-to/margins-and-maps.md)",
    "run": "[tutorial](tutorial.md)",
    "simulate": "[results](how-to/results.md)",
    "survive": "[survival](survival.md)",
    "table build": "[design a table](how-to/design-a-table.md)",
    "table check": "[gain table](how-to/gain-table.md)",
    "table compare": "[gain table](how-to/gain-table.md)",
    "table report": "[gain table](how-to/gain-table.md)",
    "table show": "[gain table](how-to/gain-table.md)",
    "validate": "[study file](study-file.md)",
    "size": "[the dc side](how-to/size-the-dc-side.md)",
    "verify": "[how sure are you?](how-to/verify.md)",
}
"""The page that shows each verb at work."""

HEAD = """\
# Verbs and options

This page lists every verb of the command line with all its options. It is written by the program itself
(`python -m website.verbs`), and says the same as `vsgdesign VERB --help`. The page [command
line](how-to/command-line.md) explains exit codes, JSON output and completion. Every verb also has `-h` and `--help`,
and `vsgdesign --version` prints the version.
"""
DEFAULT = re.compile(r"\s*\[default: (.*)\]$", re.DOTALL)


def verbs(group: click.Group = program, path: str = "") -> Iterator[tuple[str, click.Command]]:
    """Every verb that does something, with its full name, in alphabetical order."""
    for name in sorted(group.commands):
        command = group.commands[name]
        if isinstance(command, click.Group):
            yield from verbs(command, f"{path}{name} ")
        else:
            yield path + name, command


def rendered() -> str:
    """The text of the page."""
    known = dict(verbs())
    rows = [
        f"| [`{name}`](#{name.replace(' ', '-')}) | {_paragraphs(verb)[0]} | {GUIDES[name]} |"
        for name, verb in known.items()
    ]
    parts = [HEAD, "| verb | what it does | shown at work in |\n| --- | --- | --- |\n" + "\n".join(rows) + "\n"]
    parts += [_section(name, verb) for name, verb in known.items()]
    return "\n".join(parts)


def _section(name: str, verb: click.Command) -> str:
    arguments = [_metavar(one) for one in verb.params if isinstance(one, click.Argument)]
    usage = " ".join(["vsgdesign", name, *arguments])
    text = "\n\n".join(_paragraphs(verb))
    options = "\n".join(_row(one) for one in verb.params if isinstance(one, click.Option))
    return f"## {name}\n\n`{usage}`\n\n{text}\n\n| option | meaning | default |\n| --- | --- | --- |\n{options}\n"


def _paragraphs(verb: click.Command) -> list[str]:
    paragraphs = inspect.cleandoc(verb.help or "").split("\n\n")
    return [_escaped(" ".join(paragraph.split())) for paragraph in paragraphs]


def _row(option: click.Option) -> str:
    name = ", ".join([*option.opts, *option.secondary_opts])
    value = "" if option.is_flag else f" {_metavar(option)}"
    meaning = " ".join((option.help or "").split())
    given = DEFAULT.search(meaning)
    if given:
        default = given[1]
    elif option.show_default is True:
        default = str(option.default)
        default = option.opts[0].lstrip("-") if option.secondary_opts and option.default else default
    elif option.required:
        default = "must be given"
    else:
        default = ""
    cells = (f"`{name}{value}`", DEFAULT.sub("", meaning), default)
    return "| " + " | ".join(_escaped(cell) for cell in cells) + " |"


def _metavar(parameter: click.Parameter) -> str:
    text = parameter.make_metavar(click.Context(click.Command("vsgdesign")))
    return {"INTEGER RANGE": "N", "INTEGER": "N", "FLOAT RANGE": "VALUE", "FLOAT": "VALUE"}.get(text, text)


def _escaped(text: str) -> str:
    """With bars that do not end a cell of a table."""
    return text.replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(rendered(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")
