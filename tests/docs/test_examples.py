"""Every command and every snippet of the pages, run in order, their shown output compared.

A page is one session: its blocks share a folder (with the repository's ``studies`` beside them) and one Python
namespace. A comment line directly above a block says what is special about it:

- ``<!-- file: NAME -->`` writes a toml block to NAME;
- ``<!-- not run: REASON -->`` skips a block.

In a console block ``$ `` begins a command; what follows, up to the next command, must be its output. ``...`` stands
for any text within a line and, alone in a line, for any lines. Spaces count as one: a column may grow. A command
that fails must be followed by ``$ echo $?``.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner

from vsgdesign.verbs.cli.program import main

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "docs" / "tutorial.md",
    ROOT / "docs" / "walk-through.md",
    ROOT / "docs" / "survival.md",
    ROOT / "docs" / "theory" / "machine-code.md",
    ROOT / "docs" / "theory" / "measures.md",
    *sorted((ROOT / "docs" / "how-to").glob("*.md")),
]
PAGES = [page for page in PAGES if page.exists()]

BLOCK = re.compile(r"(?:^<!-- (?P<note>[^\n]*) -->\n)?^```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)
NOTE = re.compile(r"(file|not run): (\S.*)")
RUN_KINDS = ("console", "python", "toml")


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    kind: str
    text: str
    line: int
    file: str | None
    skipped: bool


def blocks(page: Path) -> list[Block]:
    """All fenced blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in BLOCK.finditer(text):
        note = NOTE.fullmatch(match["note"] or "")
        assert note or not match["note"], f"{page.name}: no such comment above a block: {match['note']}"
        what, value = note.groups() if note else ("", "")
        line = text.count("\n", 0, match.start("text"))
        found.append(
            Block(match["kind"], match["text"], line, value if what == "file" else None, skipped=what == "not run")
        )
    return found


def run_command(command: str, folder: Path) -> tuple[int, str]:
    """Exit code and output. The project's own command runs in this process, anything else in a shell."""
    words = shlex.split(command)
    if words[0] == "vsgdesign" and not {"|", ">", "&&", ";"} & set(words):
        result = CliRunner().invoke(main, words[1:], prog_name="vsgdesign")
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        return result.exit_code, result.output
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=os.environ | {"PATH": path},
        text=True,
        timeout=60,
        check=False,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    return done.returncode, done.stdout


def matches(expected: str, actual: str) -> bool:
    """Whether output is as shown, with the wildcards of a page."""

    def lines(text: str) -> list[str]:
        return [re.sub(r"─+", "─", re.sub(r"\s+", " ", line)).strip() for line in text.strip().splitlines()]

    pattern = ""
    for line in lines(expected):
        pattern += r"(?:[^\n]*\n)*" if line == "..." else re.sub(r"(\\ )?(\\\.){3}", "[^\n]*", re.escape(line)) + "\n"
    return re.fullmatch(pattern, "".join(f"{line}\n" for line in lines(actual))) is not None


def run_console(block: Block, folder: Path, where: str) -> None:
    code = 0
    for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
        command, _, expected = part.partition("\n")
        while command.endswith("\\"):
            more, _, expected = expected.partition("\n")
            command = command[:-1] + more.strip()
        if command == "echo $?":
            actual, code = f"{code}\n", 0
        else:
            assert code == 0, f"{where}: failed with {code}, and no `$ echo $?` shows it"
            code, actual = run_command(command, folder)
        assert matches(expected, actual), f"{where}: $ {command}\nshown:\n{expected}\ngot:\n{actual}"
    assert code == 0, f"{where}: failed with {code}, and no `$ echo $?` shows it"


def run_python(block: Block, following: Block | None, names: dict[str, object], where: str) -> bool:
    """Run a snippet; compare what it prints with a text block that follows. Whether there was one."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile("\n" * block.line + block.text, where, "exec"), names)
    shown = following is not None and following.kind == "text" and not following.skipped
    if shown:
        assert following is not None
        assert matches(following.text, printed.getvalue()), (
            f"{where}\nshown:\n{following.text}\ngot:\n{printed.getvalue()}"
        )
    else:
        assert printed.getvalue() == "", f"{where}: prints, and no text block after it shows what"
    return shown


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_page(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "studies").symlink_to(ROOT / "studies")
    names: dict[str, object] = {"__name__": "__page__"}
    found = blocks(page)
    for block, following in zip(found, [*found[1:], None], strict=False):
        where = f"{page.name}:{block.line}"
        if block.skipped:
            continue
        if block.file is not None:
            Path(block.file).write_text(block.text, encoding="utf-8")
        if block.kind == "toml":
            tomllib.loads(block.text)
        elif block.kind == "console":
            run_console(block, tmp_path, where)
        elif block.kind == "python":
            run_python(block, following, names, where)


def test_the_figures_of_the_walk_through_can_be_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = ROOT / "studies" / "walk_through" / "make_figures.py"
    monkeypatch.setattr(sys, "argv", [str(script), str(tmp_path)])
    runpy.run_path(str(script), run_name="__main__")
    page = (ROOT / "docs" / "walk-through.md").read_text(encoding="utf-8")
    drawn = {path.name for path in tmp_path.iterdir()}
    assert drawn == set(re.findall(r"figures/(walk_through_\w+\.png)", page))
    for line in capsys.readouterr().out.splitlines()[:2]:
        model, emt = (complex(text) for text in re.findall(r"[\d.]+\+[\d.]+j", line))
        # The page prints differences of 7e-5 (A) and 4e-7 (B). With a switched bridge's ripple they pass 1e-4.
        assert abs(emt - model) < 1e-4 * abs(model), line


def test_every_block_says_what_it_is() -> None:
    """A block without a kind would be skipped by accident."""
    known = {*RUN_KINDS, "text", "bibtex", "bash", "zsh", "fish", "c", "matlab"}
    unknown = [f"{page.name}:{b.line}: ```{b.kind}" for page in PAGES for b in blocks(page) if b.kind not in known]
    assert not unknown, unknown


def test_wildcards() -> None:
    assert matches("a\n...\nb ... d", "a\nx\ny\nb  c d\n")
    assert matches("a ─── b", "a ───────── b")
    assert not matches("a\nb", "a\nx\nb")
    assert not matches("1.5 s", "1x5 s")
