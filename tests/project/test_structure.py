"""The house rules that a machine can check: rooms, imports, where the factors live, who prints."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tokenize
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "vsgdesign"
SOURCES = sorted(PACKAGE.rglob("*.py"))
CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def layers() -> list[str]:
    """Every room that the layer contract names."""
    contracts = CONFIG["tool"]["importlinter"]["contracts"]
    contract = next(contract for contract in contracts if contract["type"] == "layers")
    assert contract["exhaustive"] is True
    return [room.strip() for layer in contract["layers"] for room in layer.split("|")]


def test_the_layers_are_the_rooms() -> None:
    present = {p.stem for p in PACKAGE.glob("*.py")} | {p.parent.name for p in PACKAGE.glob("*/__init__.py")}
    assert present - {"__init__", "__main__"} == set(layers())


def test_the_linters_are_asked_for_what_was_once_tested_here() -> None:
    """``make lint`` checks the import contracts, and with T20 that the library does not print."""
    lint = re.findall(r"^\t\$\(BIN\)/(\S+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert {"ruff", "lint-imports", "pyright"} <= set(lint)
    rules = CONFIG["tool"]["ruff"]["lint"]
    assert "T20" in rules["select"]
    silent = [pattern for pattern, ignored in rules["per-file-ignores"].items() if "T20" in ignored]
    assert not [pattern for pattern in silent if pattern.startswith("vsgdesign")]
    texts = {path: path.read_text(encoding="utf-8") for path in SOURCES}
    assert not [str(path) for path, text in texts.items() if re.search(r"noqa: .*T20|ruff: noqa", text)]


FACTOR = re.compile(
    r"(sqrt\(\s*[23](\.0*)?\s*\)|hypot\(\s*1(\.0*)?\s*,\s*1(\.0*)?\s*\)|[23](\.0*)?\s*\*\*\s*-?0?\.5"
    r"|\b1\.414|\b0?\.7071|\b1\.732|\b0?\.577|\b0?\.866|\b3(\.0*)?\s*/\s*2(\.0*)?\b|\b2(\.0*)?\s*/\s*3(\.0*)?\b)"
)
"""√2, √3, 3/2 and their inverses, however written."""


_GAP = r"(?:\s|\\|#.*\n)*"
HINT = re.compile(
    rf"sqrt{_GAP}\({_GAP}[23]|hypot{_GAP}\({_GAP}1|\*\*{_GAP}-?0?\.5|1\.414|\.7071|1\.732|\.577|\.866"
    rf"|3[.0]*{_GAP}/{_GAP}2|2[.0]*{_GAP}/{_GAP}3"
)
"""What a text has if :data:`FACTOR` finds something in its code: only such texts are taken apart, which takes long."""


def code_only(path: Path) -> str:
    """A module's source without comments and texts, which may explain a factor."""
    with path.open("rb") as stream:
        tokens = [t for t in tokenize.tokenize(stream.readline) if t.type not in (tokenize.COMMENT, tokenize.STRING)]
    return " ".join(token.string for token in tokens[1:])


def test_amplitude_factors_live_in_frames() -> None:
    paths = [path for path in SOURCES if HINT.search(path.read_text(encoding="utf-8"))]
    codes = {path: re.sub(r"\s*([().,*/])\s*", r"\1", code_only(path)) for path in paths}
    found = {str(path): factor.group() for path, code in codes.items() if (factor := FACTOR.search(code))}
    assert found.keys() <= {str(PACKAGE / "equations" / "frames.py")}, f"{found}: use vsgdesign.equations.frames"


@pytest.mark.parametrize(
    "text", ["sqrt(2)", "np.sqrt(3.0)", "1.4142135", "1.7320508", "2.0**0.5", "3/2", "3.0/2.0", "0.7071"]
)
def test_the_search_for_factors_finds_them(text: str) -> None:
    assert FACTOR.search(f"x={text}*y")
    assert HINT.search(f"x = {text} * y")
    over_lines = text.replace("/", " # why\n    / ")
    assert HINT.search(f"x = {over_lines} * y")


def test_the_top_package_imports_nothing() -> None:
    """Its names are loaded when they are used: ``import vsgdesign`` costs nothing, and the runtime stays light."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    assert not [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    code = "import sys, vsgdesign; print(sorted(m for m in sys.modules if m.startswith(('vsgdesign', 'numpy'))))"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "['vsgdesign']"


def test_no_file_grows_without_bound() -> None:
    lengths = {str(path): len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES}
    assert {path: lines for path, lines in lengths.items() if lines > 500} == {}


def test_no_machine_paths_in_what_is_tracked() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    private = re.compile(r"/(home|Users|root|work|tmp)/\w")
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".txt", ".cfg"} and path.is_file() and path != Path(__file__):
            assert not private.search(path.read_text(encoding="utf-8")), name
