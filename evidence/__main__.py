"""``python -m evidence [NAME …]``: measures again what the documents claim, and prints it as tables.

Each name is a module of this folder with a function ``main(folder)`` that prints its tables and leaves its rows as JSON
in the folder. ``make evidence`` runs all of them.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import sys
import time
from pathlib import Path

import evidence


def names() -> list[str]:
    """Everything that can be measured."""
    return [module.name for module in pkgutil.iter_modules(evidence.__path__) if not module.name.startswith("_")]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m evidence", description=evidence.__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"what to measure: {', '.join(names())}")
    parser.add_argument("--out", default="out/evidence", help="folder for the rows as JSON")
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
        importlib.import_module(f"evidence.{name}").main(folder)
        print(f"({name}: {time.perf_counter() - begin:.0f} s)\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
