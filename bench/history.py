"""The history of the benchmarks: ``python -m bench.history [FILE.json ...]``.

Adds a record for each output of ``python -m bench --json``, then writes docs/benchmark-history.md and its figure from
all records of this folder.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from statistics import geometric_mean
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]
RECORDS = Path(__file__).parent / "records"
PAGE = ROOT / "docs" / "benchmark-history.md"
FIGURE = ROOT / "docs" / "figures" / "benchmark_history.svg"
CONDITIONS = ("measured", "vsgdesign", "python", "numpy", "machine", "cores", "vectors", "load before")
"""What a record says beside its commit."""
HEAD = """\
# Benchmark history

This page shows results of `python -m bench` (`make bench`) that were kept. `python -m bench.history` writes it from the
records in [`bench/records`](../bench/README.md#history), and a test holds it equal. Each column is one version; the
first table says on which day and class of machine it was measured. A figure is the best of the repeats, because other
work on a machine only makes it worse. "Contended" means that the machine had other work for more than half of its
cores: then only differences of more than a factor of two are due to a version. RT means simulated seconds per second.

![Each group of benchmarks over the versions, relative to the first that has it](figures/benchmark_history.svg)
"""


def add(path: Path) -> Path:
    """Keeps the output of a run as the record of its commit."""
    document = json.loads(path.read_text(encoding="utf-8"))
    told = document["environment"]
    kept = {name: told[name] for name in ("committed", "commit", *CONDITIONS)}
    rows = [{name: row[name] for name in ("group", "what", "unit", "figure")} for row in document["rows"]]
    lines = ",\n  ".join(json.dumps(row, ensure_ascii=False) for row in rows)
    text = f'{{\n "schema": 1,\n "environment": {json.dumps(kept)},\n "rows": [\n  {lines}\n ]\n}}\n'
    RECORDS.mkdir(exist_ok=True)
    place = RECORDS / f"{told['committed']}-{told['commit']}.json"
    place.write_text(text, encoding="utf-8", newline="\n")
    return place


def records() -> list[dict[str, Any]]:
    """All records, the oldest version first."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(RECORDS.glob("*.json"))]


def contended(told: dict[str, str]) -> bool:
    """Whether the machine had other work."""
    return float(told["load before"]) > 0.5 * int(told["cores"])


def best(row: dict[str, Any]) -> float:
    """The best of the repeats: RT is better when larger, everything else when smaller."""
    return row["figure"]["high" if row["unit"] == "RT" else "low"]


def series(kept: Sequence[dict[str, Any]]) -> dict[tuple[str, str], list[float | None]]:
    """The best figure of each benchmark in each record, by what it measures and its unit."""
    rows = [{(row["what"], row["unit"]): best(row) for row in record["rows"]} for record in kept]
    return {key: [one.get(key) for one in rows] for key in dict.fromkeys(key for one in rows for key in one)}


def rendered(kept: Sequence[dict[str, Any]]) -> str:
    """The text of the page."""
    told = [record["environment"] for record in kept]
    titles = [f"{one['committed'][:10]} {one['commit']}" for one in told]

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cells)} |\n"

    conditions = [*CONDITIONS, "contended"]
    values = [[*(str(one[name]) for name in CONDITIONS), "yes" if contended(one) else "no"] for one in told]
    parts = [HEAD, "\n## Conditions\n\n", line(["", *titles]), line(["---"] * (1 + len(titles)))]
    parts += [line([name, *(one[k] for one in values)]) for k, name in enumerate(conditions)]
    parts += ["\n## Figures\n\n", line(["what", "unit", *titles]), line(["---"] * (2 + len(titles)))]
    for (what, unit), found in series(kept).items():
        parts.append(line([what, unit, *("" if value is None else f"{value:.3g}" for value in found)]))
    return "".join(parts)


def drawing(kept: Sequence[dict[str, Any]]) -> Figure:
    """How many times better each group is than in the first record: the geometric mean over its figures."""
    from matplotlib.figure import Figure

    from vsgdesign.report.drawing.style import COLOURS

    titles = ["{committed:.10}\n{commit}".format_map(record["environment"]) for record in kept]
    groups = {(row["what"], row["unit"]): row["group"] for record in kept for row in record["rows"]}
    better: dict[str, list[list[float]]] = {group: [[] for _ in kept] for group in groups.values()}
    for key, found in series(kept).items():
        first = next((value for value in found if value), None)
        for k, value in enumerate(found):
            if first and value:
                better[groups[key]][k].append(value / first if key[1] == "RT" else first / value)
    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    axes = figure.subplots()
    for marker, colour, (group, ratios) in zip(cycle("os^vDPX*"), cycle(COLOURS), better.items(), strict=False):
        there = [(k, geometric_mean(one)) for k, one in enumerate(ratios) if one]
        axes.plot(*zip(*there, strict=True), marker=marker, color=colour, linewidth=1.2, label=group)
    axes.set_yscale("log", base=2)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.45), max(high, 2.2))  # no small change fills the figure
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xticks(range(len(titles)), titles)
    axes.set_ylabel("times as good as at first")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", frameon=False)
    return figure


def main() -> None:
    """Add, then write."""
    from vsgdesign.report.drawing.figures import svg_text

    for name in sys.argv[1:]:
        print(add(Path(name)))
    kept = records()
    PAGE.write_text(rendered(kept), encoding="utf-8", newline="\n")
    FIGURE.write_text(svg_text(drawing(kept)), encoding="utf-8", newline="\n")
    print(PAGE)


if __name__ == "__main__":
    main()
