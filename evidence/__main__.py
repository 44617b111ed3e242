"""``python -m evidence [NAME …]``: measures again what the documents claim, and prints it as tables.

Each name is a module of this folder with a function ``main(folder)`` that prints its tables and leaves its rows as JSON
in the folder. ``make evidence`` runs all of them. Some leave their tables as NAME.md, too: ``--paste`` puts these into
the page of docs that has a place for them, and the files of ``SHIPS`` of a module into the package.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import shutil
import sys
import time
from pathlib import Path

import evidence

DOCS = Path(__file__).resolve().parents[1] / "docs"


def names() -> list[str]:
    """Everything that can be measured."""
    return [module.name for module in pkgutil.iter_modules(evidence.__path__) if not module.name.startswith("_")]


def paste(name: str, text: str, docs: Path) -> list[Path]:
    """Puts a text between the marks of its name in every page that has them. Returns the pages."""
    begin, end = f"<!-- evidence: {name} -->\n", "<!-- end of evidence -->"
    pages = []
    for page in sorted(docs.rglob("*.md")):
        before, found, rest = page.read_text(encoding="utf-8").partition(begin)
        _, closed, after = rest.partition(end)
        if found and closed:
            page.write_text(f"{before}{begin}\n{text.strip()}\n\n{end}{after}", encoding="utf-8")
            pages.append(page)
    return pages


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m evidence", description=evidence.__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"what to measure: {', '.join(names())}")
    parser.add_argument("--out", default="out/evidence", help="folder for the rows as JSON")
    parser.add_argument("--paste", action="store_true", help="put the tables into docs, the files into the package")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(names()))
    if unknown:
        print(f"unknown: {', '.join(unknown)}; there are {', '.join(names())}", file=sys.stderr)
        return 2
    folder = Path(arguments.out)
    folder.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or names():
        begin = time.perf_counter()
        print(f"## {name}", flush=True)
        module = importlib.import_module(f"evidence.{name}")
        module.main(folder)
        tables = folder / f"{name}.md"
        if arguments.paste and tables.exists():
            for page in paste(name, tables.read_text(encoding="utf-8"), DOCS):
                print(f"written: {page}")
        for file, place in getattr(module, "SHIPS", {}).items() if arguments.paste else ():
            shutil.copyfile(folder / file, place)
            print(f"written: {place}")
        print(f"({name}: {time.perf_counter() - begin:.0f} s)\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
