"""``python -m bench``: every benchmark of this folder as one table.

A module of this folder takes part by having BENCHMARKS: names to functions that return rows.
"""

from __future__ import annotations

import argparse
import importlib
import json
import pkgutil
import sys
from collections.abc import Callable
from dataclasses import asdict

import bench
from bench.timing import Row, environment


def benchmarks() -> dict[str, Callable[[], list[Row]]]:
    """Every benchmark by name, in the order of the files."""
    found: dict[str, Callable[[], list[Row]]] = {}
    for module in pkgutil.iter_modules(bench.__path__):
        if not module.name.startswith("_"):
            found |= getattr(importlib.import_module(f"bench.{module.name}"), "BENCHMARKS", {})
    return found


def number(value: float | None) -> str:
    """Three significant digits, without an exponent."""
    if value is None:
        return ""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def table(rows: list[Row]) -> str:
    """The rows as Markdown, which reads as plain text too."""
    headings = (
        "what",
        "ours",
        "low",
        "high",
        "unit",
        "n",
        "anchor",
        "ratio",
        "target",
        "whose anchor",
        "what limits it",
    )
    lines: list[tuple[str, ...]] = [headings]
    for row in rows:
        verdict = "" if row.on_target is None else (" ok" if row.on_target else " missed")
        ratio = "" if row.ratio is None else f"{number(row.ratio)} x"
        lines.append(
            (
                row.what,
                *(number(value) for value in (row.figure.value, row.figure.low, row.figure.high)),
                row.unit,
                str(row.figure.repeats),
                number(row.anchor),
                ratio,
                number(row.target) + verdict,
                row.whose,
                row.limit,
            )
        )
    widths = [max(len(line[k]) for line in lines) for k in range(len(headings))]
    text = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines
    ]
    text.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(text)


def main() -> None:
    """Run, then print."""
    every = benchmarks()
    parser = argparse.ArgumentParser(prog="python -m bench", description="Medians of repeats, single-threaded.")
    parser.add_argument("--only", metavar="NAME", action="append", choices=list(every), help=", ".join(every))
    parser.add_argument("--json", action="store_true", help="print JSON")
    chosen = parser.parse_args()
    conditions = environment()
    rows = []
    for name in chosen.only or every:
        print(f"{name} …", file=sys.stderr)
        rows += every[name]()
    if chosen.json:
        documents = [asdict(row) | {"ratio": row.ratio, "on_target": row.on_target} for row in rows]
        print(json.dumps({"environment": conditions, "rows": documents}, indent=1))
        return
    print(", ".join(f"{name} {value}" for name, value in conditions.items()))
    print("Medians of n repeats. RT: simulated seconds per second. Models and steps differ between an anchor and us:")
    print("a ratio is a hint, and says how many times better ours is.\n")
    print(table(rows))


if __name__ == "__main__":
    main()
