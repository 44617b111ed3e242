"""What a version of the package offers, as sorted lines, so that two versions can be compared with ``diff``.

``python evidence/inventory.py [FOLDER]`` lists, of the package on the path and the checkout that it lies in: every verb
with its options; every field of a study, of a table and of a recipe, from the pages; suites with their tests, cases and
recipes; public names of the facade and of the runtime; classes of errors; pages and their headings; modules that the
pages import, and whether they are there; the tests of the test suite. With a FOLDER of equal.py also every file that a
verb writes, and the headings of every page.
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click

import vsgdesign
import vsgdesign.runtime
from vsgdesign import errors
from vsgdesign.verbs.cli.program import main as program

PACKAGE = Path(vsgdesign.__file__).resolve().parent
ROOT = PACKAGE.parent
IMPORT = re.compile(r"^(?:>>> )?(?:from (vsgdesign[\w.]*) import ([\w, ]+)|import (vsgdesign[\w.]*))", re.MULTILINE)
ADDRESS = re.compile(r" object at \w+")
HEADING = re.compile(r"<h([123])[^>]*>(.*?)</h\1>", re.DOTALL)


def main(folder: Path) -> None:
    """Writes inventory.txt for ``python -m evidence inventory``."""
    lines = list(inventory())
    (folder / "inventory.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{len(lines)} lines in {folder / 'inventory.txt'}")


def inventory(written: Path | None = None) -> Iterator[str]:
    """All lines, sorted within each part."""
    for part in (verbs(program, "vsgdesign"), fields(), data(), names(), kinds_of_error(), pages(), tests()):
        yield from sorted(set(part))
    if written is not None:
        yield from sorted(files(written))


def verbs(command: click.Command, name: str) -> Iterator[str]:
    """Every option with its words, type and default, and whether it may be repeated."""
    for option in command.params:
        words = "/".join([*option.opts, *option.secondary_opts])
        many = ", repeated" if option.multiple or option.nargs != 1 else ""  # type: ignore[attr-defined]
        kind = ADDRESS.sub("", f"{option.type!r}, default {option.default!r}")
        yield f"verb {name}: {words}: {kind}, required {option.required}{many}"
    for sub, child in getattr(command, "commands", {}).items():
        yield f"verb {name} {sub}"
        yield from verbs(child, f"{name} {sub}")


def fields() -> Iterator[str]:
    """Rows of the pages' tables whose first column is ``field``."""
    for page in sorted((ROOT / "docs").rglob("*.md")):
        section, inside = "", False
        for line in page.read_text(encoding="utf-8").splitlines():
            section = line.lstrip("# ") if line.startswith("#") else section
            inside = line.startswith("| field |") or (inside and line.startswith("|"))
            if inside and line.startswith("| `"):
                yield f"field {page.stem} {section}: {line.strip('| ')}"


def data() -> Iterator[str]:
    """Documents that come with the package: by folder and name, suites with their tests."""
    for path in PACKAGE.rglob("*.toml"):
        yield f"data {path.parent.name}/{path.name}"
        if path.parent.name == "suites":
            for test in tomllib.loads(path.read_text(encoding="utf-8"))["tests"]:
                yield f"suite {path.stem}: {test['name']}"


def names() -> Iterator[str]:
    """Public names of the facade and the runtime with their signatures, and the members of their classes."""
    for module in (vsgdesign, vsgdesign.runtime):
        for name in module.__all__:
            value = getattr(module, name)
            yield f"name {module.__name__}.{name}{_signature(value)}"
            for member in dir(value) if inspect.isclass(value) else ():
                if not member.startswith("_"):
                    yield f"name {module.__name__}.{name}.{member}{_signature(getattr(value, member))}"


def _signature(value: object) -> str:
    try:
        return str(inspect.signature(value)) if callable(value) else ""
    except ValueError:
        return ""


def kinds_of_error() -> Iterator[str]:
    """Classes of errors with the ones that they are."""
    for name, value in vars(errors).items():
        if inspect.isclass(value) and issubclass(value, Exception):
            yield f"error {name}: {', '.join(one.__name__ for one in value.__mro__[1:-2])}"


def pages() -> Iterator[str]:
    """Pages of the documents with their headings, and what they import."""
    for page in (*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")):
        text, name = page.read_text(encoding="utf-8"), page.relative_to(ROOT)
        yield f"page {name}"
        if name.name != "CHANGELOG.md":
            yield from (f"page {name}: {line}" for line in text.splitlines() if re.match(r"#{1,3} ", line))
        for module, imported, alone in IMPORT.findall(text):
            for one in imported.split(","):
                yield f"documented {module or alone} {one.strip()}: {_found(module or alone, one.strip())}"


def _found(module: str, name: str) -> str:
    try:
        return "there" if not name or hasattr(importlib.import_module(module), name) else "missing"
    except ImportError:
        return "missing"


def tests() -> Iterator[str]:
    """Names of all tests, wherever they are, and how often each is there."""
    found: list[str] = []
    for path in (ROOT / "tests").rglob("test_*.py"):
        found += re.findall(r"^\s*def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    yield from (f"test {name}: {found.count(name)}" for name in set(found))


def files(written: Path) -> Iterator[str]:
    """Files that the jobs of equal.py have left, and the headings of the pages among them."""
    for path in written.rglob("*"):
        name = path.relative_to(written)
        if path.is_file() and name.parts[0] not in {"files", "studies"}:
            yield f"file {name}"
            if path.suffix == ".html":
                for _, heading in HEADING.findall(path.read_text(encoding="utf-8")):
                    yield f"heading {name}: {' '.join(re.sub('<[^>]+>', ' ', heading).split())}"


if __name__ == "__main__":
    for line in inventory(Path(sys.argv[1]) if len(sys.argv) > 1 else None):
        print(line)
