"""docs/architecture.md: its table names every room, and its figures are those that the script draws."""

from __future__ import annotations

import runpy
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architecture.md"
FIGURES = ROOT / "docs" / "figures"
DRAWN = runpy.run_path(str(FIGURES / "draw_architecture.py"))


def test_the_table_names_every_room_from_top_to_bottom() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    rooms = [room.strip() for layer in layers for room in layer.split("|")]
    rows = [line.split("|")[1] for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    named = [name.strip(" `") for row in rows for name in row.split(",")]
    # Rooms of one layer may stand in any order, and in rows of their own.
    assert sorted(named) == sorted(rooms)
    level = {room.strip(): k for k, layer in enumerate(layers) for room in layer.split("|")}
    assert [level[name] for name in named] == sorted(level[name] for name in named)


@pytest.mark.parametrize("name", ["control_loop", "scheduler_guards", "files"])
def test_figures_are_as_drawn(name: str) -> None:
    committed = (FIGURES / f"{name}.svg").read_text(encoding="utf-8")
    assert committed == DRAWN[name](), "draw again: python docs/figures/draw_architecture.py"
    root = ElementTree.fromstring(committed)
    _, _, width, height = (float(number) for number in root.attrib["viewBox"].split())
    for text in root.iter("{http://www.w3.org/2000/svg}text"):
        assert 0.0 < float(text.attrib["x"]) < width
        assert 0.0 < float(text.attrib["y"]) < height


def test_the_guards_are_those_of_the_page_on_the_runtime() -> None:
    page = (ROOT / "docs" / "theory" / "runtime.md").read_text(encoding="utf-8")
    for guard, _, _ in DRAWN["GUARDS"]:
        number, _, name = guard.partition(" ")
        assert f"\n{number}. **{name}.**" in page
