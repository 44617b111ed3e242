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


def names(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_import_contracts_hold() -> None:
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()", "--no-cache"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stdout + run.stderr
    kept = re.search(r"Contracts: (\d+) kept, 0 broken", run.stdout)
    assert kept is not None, run.stdout
    assert int(kept.group(1)) == len(CONFIG["tool"]["importlinter"]["contracts"]) >= 3


def test_the_layers_are_the_rooms() -> None:
    present = {p.stem for p in PACKAGE.glob("*.py")} | {p.parent.name for p in PACKAGE.glob("*/__init__.py")}
    assert present - {"__init__"} == set(layers())


@pytest.mark.parametrize("path", SOURCES, ids=names)
def test_nothing_prints(path: Path) -> None:
    """Results are returned or written; only the command line talks, through click and rich."""
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    assert not [call.lineno for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"]


FACTOR = re.compile(
    r"(sqrt\(\s*[23](\.0*)?\s*\)|hypot\(\s*1(\.0*)?\s*,\s*1(\.0*)?\s*\)|[23](\.0*)?\s*\*\*\s*-?0?\.5"
    r"|\b1\.414|\b0?\.7071|\b1\.732|\b0?\.577|\b0?\.866|\b3(\.0*)?\s*/\s*2(\.0*)?\b|\b2(\.0*)?\s*/\s*3(\.0*)?\b)"
)
"""√2, √3, 3/2 and their inverses, however written."""


def code_only(path: Path) -> str:
    """A module's source without comments and texts, which may explain a factor."""
    with path.open("rb") as stream:
        tokens = [t for t in tokenize.tokenize(stream.readline) if t.type not in (tokenize.COMMENT, tokenize.STRING)]
    return " ".join(token.string for token in tokens[1:])


@pytest.mark.parametrize("path", [p for p in SOURCES if p.name != "frames.py"], ids=names)
def test_amplitude_factors_live_in_frames(path: Path) -> None:
    found = FACTOR.search(re.sub(r"\s*([().,*/])\s*", r"\1", code_only(path)))
    assert found is None, f"{found and found.group()}: use vsgdesign.frames"


@pytest.mark.parametrize(
    "text", ["sqrt(2)", "np.sqrt(3.0)", "1.4142135", "1.7320508", "2.0**0.5", "3/2", "3.0/2.0", "0.7071"]
)
def test_the_search_for_factors_finds_them(text: str) -> None:
    assert FACTOR.search(f"x={text}*y")


def test_the_top_package_imports_nothing() -> None:
    """Its names are loaded when they are used: ``import vsgdesign`` costs nothing, and the runtime stays light."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    assert not [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    code = "import sys, vsgdesign; print(sorted(m for m in sys.modules if m.startswith(('vsgdesign', 'numpy'))))"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "['vsgdesign']"


@pytest.mark.parametrize("path", SOURCES, ids=names)
def test_no_file_grows_without_bound(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 500


def test_no_machine_paths_in_what_is_tracked() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    private = re.compile(r"/(home|Users|root|work|tmp)/\w")
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        if path.suffix in {".py", ".md", ".toml", ".txt", ".cfg"} and path.is_file() and path != Path(__file__):
            assert not private.search(path.read_text(encoding="utf-8")), name
