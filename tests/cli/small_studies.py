"""Small study files and a runner that every test of the command line shares."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from vsgdesign.verbs.cli.program import main

SMALL = """
base = "case:hoang2025_5kva"

[study]
name = "small"

[simulation]
duration = "0.3 s"
P_ref = "2 kW"
Q_ref = "1 kvar"

[[controllers]]
name = "fixed"
kind = "fixed"

[[controllers]]
name = "scheduled"
kind = "scheduled"

[[events]]
time = "0.1 s"
P_ref = "2.5 kW"

[[events]]
time = "0.2 s"
grid = { scr = 8 }
"""


def study_file(folder: Path, text: str = SMALL, **replaced: str) -> Path:
    """``small.toml`` in a folder; ``replaced`` gives lines of the text a new right-hand side."""
    for field, value in replaced.items():
        lines = text.splitlines()
        assert any(line.startswith(f"{field} = ") for line in lines), field
        text = "\n".join(f"{field} = {value}" if line.startswith(f"{field} = ") else line for line in lines)
    path = folder / "small.toml"
    path.write_text(text, encoding="utf-8")
    return path


def call(*arguments: str | Path) -> Result:
    """The command line in this process, standard output and standard error apart."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def failure(code: int, *arguments: str | Path) -> str:
    """Standard error of a call that must end with this code, without output and without a traceback."""
    result = call(*arguments)
    assert result.exit_code == code, result.output
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    return result.stderr


def as_json(*arguments: str | Path) -> dict[str, Any]:
    """The document that a call with --json prints; nothing else may be on standard output."""
    result = call(*arguments, "--json")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""

    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(result.stdout, parse_constant=refuse)
