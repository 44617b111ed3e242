"""The network of a plant as a drawing of one line: nodes, branches, units, inverters, loads, shunts and sources."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.sketch import END, MIDDLE, Area, Sketch, Stroke, Words
from vsgdesign.report.drawing.style import COLOURS
from vsgdesign.report.page.blocks import Sketches
from vsgdesign.study.parameters.power_plant import NEUTRAL, Element, Inverter, PowerPlant, Source, Unit
from vsgdesign.study.parameters.study import Study

_ROW, _COLUMN, _TOP, _LEFT = 34.0, 236.0, 30.0, 176.0
"""Distance of two rows and of two nodes in a line, px, and where the node of the grid is."""

_REACH, _SIZE = 92.0, 9.0
"""From a node to what is connected there, and half of its size."""

_GAP = 0.4
"""Between two nodes below each other, in rows."""

_LINE, _DIM = "#1A1A1A", "#555555"
_UNIT, _OTHER, _LOAD, _SOURCE = COLOURS[0], COLOURS[1], COLOURS[2], COLOURS[7]


@dataclass
class _Drawing:
    """A drawing that is being made."""

    study: Study
    plant: PowerPlant
    sketch: Sketch
    row: float = 0.0
    seen: set[str] = field(default_factory=set)
    places: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Of each node."""
    behind: dict[str, list[tuple[Element, str]]] = field(default_factory=dict)
    """The branches that lead to nodes for the first time, with these nodes, by the node where they begin."""


def network_block(study: Study) -> Sketches | None:
    """The drawing with its title and caption, for a page; None for a study of one converter."""
    if study.plant is None:
        return None
    caption = (
        "A bar is a node, a circle is a unit, a square another converter, a triangle a load or a shunt, and a ring a "
        "source. R and X in per cent of the converter of the study. A broken line begins with its breaker open."
    )
    return Sketches("Network", caption, [network_sketch(study)], kind="network", least=1.0)


def network_sketch(study: Study) -> Sketch:
    """The drawing of a plant. It begins at the grid on the left, and every node is to the right of the one that feeds
    it. Raises ValueError for a study of one converter."""
    plant = study.plant
    if plant is None:
        raise ValueError("the study has no plant")
    label = f"Network with {len(plant.nodes)} nodes and {len(plant.converters)} converters"
    made = _Drawing(study, plant, Sketch(0.0, 0.0, label), behind=_tree(plant))
    top = _node(made, plant.pcc, 0)
    _grid(made, top)
    for name in plant.nodes:  # what no branch leads to from the grid
        if name not in made.seen:
            _node(made, name, 0)
    for one in _branches(plant):
        if all(one is not other for listed in made.behind.values() for other, _ in listed):
            _closing(made, one)
    xs = [place[0] for place in made.places.values()]
    made.sketch.width, made.sketch.height = max(xs) + _COLUMN + 90.0, _TOP + made.row * _ROW + 6.0
    return made.sketch


def _branches(plant: PowerPlant) -> list[Element]:
    return [one for one in plant.elements if NEUTRAL not in (one.start, one.end)]


def _tree(plant: PowerPlant) -> dict[str, list[tuple[Element, str]]]:
    """The shortest ways from the grid to every node; a branch that begins open is taken where there is no other."""
    found: dict[str, list[tuple[Element, str]]] = {}
    reached = [plant.pcc]
    for begins_open in (False, True):
        for node in reached:  # grows as it goes
            for one in _branches(plant):
                there = one.end if one.start == node else one.start
                if node in (one.start, one.end) and there not in reached and (one.group in plant.opened) <= begins_open:
                    found.setdefault(node, []).append((one, there))
                    reached.append(there)
    return found


def _node(made: _Drawing, name: str, depth: int) -> float:
    """Draws a node with everything that is connected to it, and behind its branches the next ones. Returns where its
    bar begins."""
    made.seen.add(name)
    x, first, plant = _LEFT + depth * _COLUMN, made.row, made.plant
    made.places[name] = x, _y(first)
    others: list[Unit | Inverter | Source] = [*plant.units, *plant.inverters, *plant.sources]
    for one in others:
        if one.node == name:
            _connected(made, x, one)
    for group in dict.fromkeys(one.group for one in plant.elements if _only_at(one, name)):
        _load(made, x, group)
    for one, there in made.behind.get(name, []):
        y = _y(made.row)
        _wire(made, (x, y), (x + _COLUMN, y), one.group)
        made.sketch.parts.append(Words(x + 0.5 * _COLUMN, y - 5.0, _branch_words(made, one), 10.0, MIDDLE, _DIM))
        _node(made, there, depth + 1)
        made.row += _GAP
    made.row -= _GAP if name in made.behind else 0.0
    if made.row == first:
        made.row += 1
    bottom = _y(made.row - 1)
    top = made.places[name][1]
    made.sketch.line((x, top - 11.0), (x, bottom + 11.0), _LINE, 3.0)
    made.sketch.parts.append(Words(x, top - 15.0, name, 10.0, MIDDLE, _LINE, bold=True))
    return top


def _only_at(one: Element, node: str) -> bool:
    """Whether an element leads from a node to the neutral, and is no half of the capacitance of a cable."""
    here = NEUTRAL in (one.start, one.end) and node in (one.start, one.end)
    return here and one.name != f"{one.group}.{node}"


def _y(row: float) -> float:
    return _TOP + 12.0 + row * _ROW


def _wire(made: _Drawing, start: tuple[float, float], end: tuple[float, float], name: str) -> None:
    made.sketch.line(start, end, _LINE, 1.2, (3.0, 3.0) if name in made.plant.opened else ())


def _connected(made: _Drawing, x: float, one: Unit | Inverter | Source) -> None:
    """A converter or a source with its own path."""
    y, at = _y(made.row), x + _REACH
    made.row += 1
    _wire(made, (x, y), (at - _SIZE, y), one.name)
    path = _impedance(made, one.R, one.L)
    if path:
        made.sketch.parts.append(Words(x + 0.5 * (_REACH - _SIZE), y - 4.0, path, 9.0, MIDDLE, _DIM))
    made.sketch.parts.append(_symbol(at, y, one))
    made.sketch.parts.append(Words(at + _SIZE + 5.0, y + 4.0, _words(one), 10.0))


def _symbol(x: float, y: float, one: Unit | Inverter | Source) -> Area:
    if isinstance(one, Inverter):
        corners = [(x - _SIZE, y - _SIZE), (x + _SIZE, y - _SIZE), (x + _SIZE, y + _SIZE), (x - _SIZE, y + _SIZE)]
        return Area(np.array(corners), _OTHER)
    circle = _circle(x, y, _SIZE)
    return Area(circle, _UNIT) if isinstance(one, Unit) else Area(circle, "#FFFFFF", _SOURCE)


def _circle(x: float, y: float, radius: float) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * math.pi, 25)[:-1]
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)


def _words(one: Unit | Inverter | Source) -> str:
    if isinstance(one, Source):
        return one.name
    P = one.P_ref if isinstance(one, Unit) else one.asked.P_ref
    return f"{one.name}, {plain(P / 1e3, 4)} kW"


def _load(made: _Drawing, x: float, group: str) -> None:
    y, at = _y(made.row), x + _REACH
    made.row += 1
    _wire(made, (x, y), (at - _SIZE, y), group)
    made.sketch.parts.append(Area(np.array([(at - _SIZE, y - _SIZE), (at - _SIZE, y + _SIZE), (at + _SIZE, y)]), _LOAD))
    made.sketch.parts.append(Words(at + _SIZE + 5.0, y + 4.0, group, 10.0))


def _grid(made: _Drawing, y: float) -> None:
    """The grid behind its impedance."""
    x = made.places[made.plant.pcc][0]
    at, grid = x - 128.0, made.study.grid
    _wire(made, (at + _SIZE, y), (x, y), "grid")
    made.sketch.parts.append(Area(_circle(at, y, _SIZE), "#FFFFFF", _SOURCE))
    made.sketch.parts.append(Words(at - _SIZE - 4.0, y + 4.0, "grid", 10.0, END))
    path = _impedance(made, grid.R_g, grid.L_g)
    made.sketch.parts.append(Words(x - 58.0, y - 4.0, path, 9.0, MIDDLE, _DIM))


def _branch_words(made: _Drawing, one: Element) -> str:
    path = _impedance(made, one.R, one.L)
    return f"{one.group} {path}".rstrip()


def _impedance(made: _Drawing, R: float, L: float) -> str:
    """R and X at nominal frequency, per cent of the study's converter."""
    c = made.study.converter
    parts = (("R", R / c.Z_base), ("X", c.omega_n * L / c.Z_base))
    return ", ".join(f"{name} {plain(100.0 * value, 2)} %" for name, value in parts if value > 0.0)


def _closing(made: _Drawing, one: Element) -> None:
    """A branch between two nodes that are drawn already: it closes a ring."""
    (x, y), (x_2, y_2) = made.places[one.start], made.places[one.end]
    left = min(x, x_2) - 26.0
    points = [(x, y + 11.0), (left, y + 11.0), (left, y_2 + 11.0), (x_2, y_2 + 11.0)]
    dashes = (3.0, 3.0) if one.group in made.plant.opened else ()
    made.sketch.parts.append(Stroke(np.array(points), _LINE, 1.2, dashes))
    made.sketch.parts.append(Words(left - 4.0, 0.5 * (y + y_2) + 15.0, _branch_words(made, one), 9.0, END, _DIM))
