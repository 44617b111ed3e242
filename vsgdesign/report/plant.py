"""A run of a plant: what it prints on a terminal, and its page with the answer, the network, powers and modes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.equations.frames import peak_to_rms
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.quantities import DASH, number, plain
from vsgdesign.report.drawing.style import PAGE_IN, add_axes, line_style, look, new_figure
from vsgdesign.report.drawing.time_axis import mark_events, time_unit
from vsgdesign.report.page.blocks import HEADLINE, SOURCE, Block, Box, Heading, Page, Table, Where, drawings, words
from vsgdesign.report.page.network import network_block
from vsgdesign.report.scenario.tables import DC_HEAD, DC_NOTE, dc_cut, dc_row, responses
from vsgdesign.report.stability import tables as made
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.simulation.units.scenario import PlantController, PlantRest, PlantResult
from vsgdesign.study.parameters.study import Study


def plant_blocks(result: PlantResult) -> list[Block]:
    """One table of units, one of inverters and one of modes for each controller."""
    blocks: list[Block] = []
    for one in result.controllers:
        blocks += [_units(one), *_links(one), *_inverters(one), *_islands(one), _modes(one)]
        blocks.append(words(*_reasons(one), on=Where.TERMINAL))
    return blocks


def _units(one: PlantController) -> Table:
    head = ("unit", "outcome", "P [kW]", "Q [kvar]", "V [V]", "largest current [pu]")
    rows = []
    for unit, found in zip(one.timeline.plant.units, one.units, strict=True):
        series = found.series
        peaks = (event.peak_current_pu for event in found.events)
        peak = max((one for one in peaks if one is not None), default=math.nan)
        end = (series["P_pcc"][-1] / 1e3, series["Q_pcc"][-1] / 1e3, series["V_rms"][-1])
        numbers = tuple(plain(float(value), 4) for value in end)
        shown = plain(float(peak), 3) if math.isfinite(peak) else DASH
        status = found.outcome.status if found.survival is None else found.survival.status
        status = _in_island(one, unit.name) or status
        status = status if unit.name in one.rests[-1].on_line or status == "blocked" else "off line"
        rows.append((unit.name, status, *numbers, shown))
    return Table(f"{one.spec.name}: {one.outcome.status}, at the end of the run", head, tuple(rows), on=Where.TERMINAL)


def _links(one: PlantController) -> list[Table]:
    """What each unit asked of its dc link."""
    every = list(zip(one.timeline.plant.units, one.units, strict=True))
    rows = [(unit.name, *row) for unit, found in every if (row := dc_row(found)) is not None]
    cut = [said for unit, found in every for said in dc_cut(unit.name, found)]
    title = f"{one.spec.name}: dc links of the units"
    table = Table(title, ("unit", *DC_HEAD), tuple(rows), notes=(DC_NOTE, *cut), texts=2, on=Where.TERMINAL)
    return [table] if rows else []


def _inverters(one: PlantController) -> list[Table]:
    """What the inverters give at the end of the run."""
    head = ("inverter", "P [kW]", "Q [kvar]", "f [Hz]", "largest current [pu]")
    rows = []
    for inverter, (name, series) in zip(one.timeline.plant.inverters, one.inverters, strict=True):
        rated = inverter.S_rated / (3.0 * inverter.V_rated_rms) / peak_to_rms(1.0)
        peak = max(float(np.abs(series[f"i_pcc_{phase}"]).max()) for phase in "abc") / rated
        end = (series["P_pcc"][-1] / 1e3, series["Q_pcc"][-1] / 1e3, series["omega"][-1] / (2.0 * math.pi))
        rows.append((name, *(plain(float(value), 4) for value in end), plain(peak, 3)))
    title = f"{one.spec.name}: inverters at the end of the run"
    return [Table(title, head, tuple(rows), on=Where.TERMINAL)] if rows else []


def _in_island(one: PlantController, unit: str) -> str:
    """What became of a unit where no source is connected at the end; empty where one is."""
    at_end = [own for own in one.sharing if own.unit == unit and own.t_s == one.rests[-1].t_s]
    return ("settled" if at_end[0].fault is None else "not settled") if at_end else ""


def _islands(one: PlantController) -> list[Table]:
    """How the units share the load where no source is connected."""
    head = ("from [s]", "after", "unit", "P [kW]", "its droop", "Q [kvar]", "its droop", "V [pu]", "at rest after [s]")
    rows, flagged = [], set()
    for own in one.sharing:
        if own.fault is not None:
            flagged.add(len(rows))
        powers = (plain(value / 1e3, 4) for value in (own.P, own.P_droop, own.Q, own.Q_droop))
        settled = DASH if own.settled_s is None else plain(own.settled_s, 3)
        rows.append((plain(own.t_s, 4), own.name, own.unit, *powers, plain(own.V_pu, 4), settled))
    if not rows:
        return []
    hertz = {own.name: plain(own.f_hz, 5) for own in one.sharing}
    note = "Frequency: " + ", ".join(f"{value} Hz after {name}" for name, value in hertz.items()) + "."
    bad = [f"{own.unit}, after {own.name}: {own.fault}." for own in one.sharing if own.fault is not None]
    title = f"{one.spec.name}: sharing without a source"
    return [Table(title, head, tuple(rows), notes=(note, *bad), flagged=frozenset(flagged), on=Where.TERMINAL)]


def _modes(one: PlantController) -> Table:
    head = (
        "from [s]",
        "after",
        "on line",
        "slowest mode, Re s [1/s]",
        "[Hz]",
        "damping",
        "together",
        "against each other",
        "most in it",
    )
    return Table(
        f"{one.spec.name}: modes of the whole plant at rest", head, tuple(map(_row, one.rests)), on=Where.TERMINAL
    )


def _hertz(s: complex) -> float:
    """With what a mode oscillates; 0 below 0.05 Hz, which is seldom more than rounding."""
    hertz = abs(s.imag) / (2.0 * math.pi)
    return hertz if hertz > 0.05 else 0.0


def _row(rest: PlantRest) -> tuple[str, ...]:
    start = (plain(rest.t_s, 4), rest.name, str(len(rest.on_line)))
    if not rest.modes:
        return (*start, *(DASH,) * 6)
    slowest = rest.modes[0]
    own = plain(slowest.s.real, 3), plain(_hertz(slowest.s), 3), plain(slowest.damping, 2)
    who, share = slowest.units[0]
    most = f"{who} {100.0 * share:.0f} %"
    if rest.split is None:
        return (*start, *own, DASH, DASH, most)
    both = (plain(modes[0].s.real, 3) for modes in (rest.split.common, rest.split.differential))
    return (*start, *own, *both, most)


def _reasons(one: PlantController) -> list[str]:
    """Why there is no rest, or what an outcome is."""
    obstacles = ((rest.name, rest.obstacle) for rest in one.rests if not rest.islanded or not one.sharing)
    found = [f"{name}: {obstacle}." for name, obstacle in obstacles if obstacle is not None]
    outcome = one.outcome
    return found + ([] if outcome.reason is None else [f"{one.spec.name}, {outcome.reason}."])


_PANEL_IN, _GAP_IN, _COLUMNS = 1.05, 0.14, 1500
"""Height of a panel, room between two, and points of a curve."""

_ALIKE = 0.6
"""A unit is named as the one to change where it has this share of a mode."""


def plant_page(
    result: PlantResult, figures: Sequence[WrittenFigure] = (), margins: StabilityResult | None = None
) -> Page:
    """The page. ``margins``: those of one of the units, where they are equal."""
    study = result.study
    network = network_block(study)
    of_margins: list[Block] = []
    if margins is not None:
        tables = [made.worst_table(margins, one) for one in margins.assessments]
        apart = made.differential_table(margins)
        of_margins = [Heading("Margins over the grids"), *([] if apart is None else [apart]), *tables]
    blocks: list[Block] = [
        words(f"Parameters: {study.source}" if study.source else "", style=SOURCE),
        words(_simulated(study), style=SOURCE),
        Box((words(headline(result), style=HEADLINE), words(*answers(result))), anchor="answer"),
        *([] if network is None else [network]),
        Heading("Powers and voltages"),
        *drawings(figures),
        Heading("Units and modes"),
        *(replace(block, on=Where.BOTH) for block in plant_blocks(result)),
        *impedances(result),
        Heading("Steps"),
        *steps(result),
        *of_margins,
    ]
    return Page(f"{study.title}: a plant of {len(units_of(study))} units", blocks, f"Study {study.name}, {study.hash}.")


def units_of(study: Study) -> tuple[str, ...]:
    """Names of the units of a study's plant."""
    return () if study.plant is None else tuple(one.name for one in study.plant.units)


def _simulated(study: Study) -> str:
    """How long and with which bridges."""
    bridges = "averaged bridges"
    if study.simulation.bridge == "pwm":
        bridges = "switched bridges (PWM) of the units, each with a carrier of its own"
    return f"{plain(study.simulation.duration)} s of electromagnetic-transient simulation with {bridges}."


def headline(result: PlantResult) -> str:
    """What became of the plant with each controller, and its slowest mode."""
    said = []
    for one in result.controllers:
        known = [rest for rest in one.rests if rest.modes]
        status = one.outcome.status
        end = "whether it settles is not known" if status == "not known" else f"{status} at the end"
        text = f"{one.spec.name}: {end}"
        if known:
            worst = max(known, key=lambda rest: rest.modes[0].s.real)
            rate = worst.modes[0].s.real
            grows = "the fastest growth" if rate >= 0.0 else "the slowest decay"
            text += f"; {grows} of all rests is {number(abs(rate))} 1/s, after {worst.name}"
        said.append(text + ".")
    return " ".join(said)


def answers(result: PlantResult) -> list[str]:
    """Who takes part in the slowest mode, and which unit to change."""
    return [f"{one.spec.name}: {advice(one)}" for one in result.controllers]


def advice(one: PlantController) -> str:
    """What to change for a faster slowest mode."""
    known = [rest for rest in one.rests if rest.modes]
    if not known:
        return "no rest of this run is known, so there are no modes."
    worst = max(known, key=lambda rest: rest.modes[0].s.real)
    mode, hertz = worst.modes[0], _hertz(worst.modes[0].s)
    at = f"{hertz:.3g} Hz" if hertz > 0.0 else "no oscillation"
    who = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in mode.units[:4])
    moves = "grows" if mode.s.real >= 0.0 else "decays"
    said = (
        f"the slowest mode {moves} with {number(abs(mode.s.real))} 1/s ({at}, after {worst.name}). "
        f"In it take part: {who}. "
    )
    if worst.split is not None:
        common, apart = worst.split.common[0].s.real, worst.split.differential[0].s.real
        if apart >= common:
            return said + (
                "The units swing against each other, and the grid has no part in it: change what lies between them "
                "(the reactance of their transformers, the transient reactance) or the gains, in all of them alike."
            )
        return said + "All units move together: the gains for the grid, or the grid, decide, in all of them alike."
    name, share = mode.units[0]
    if share >= _ALIKE:
        return said + f"Change {name} first: the mode is its own for the most part."
    return said + "No unit has most of it: it belongs to all of those together."


def impedances(result: PlantResult) -> list[Block]:
    """What one of the equal units sees in the common mode and in the differential one, for each number on line."""
    one = result.controllers[0]
    plant, c = one.timeline.plant, result.study.converter
    if not plant.equal or plant.elements or len(plant.units) < 2:
        return []
    rows, grids = {}, {}
    for rest in one.rests:
        grids[len(rest.on_line), one.timeline.segment_at(rest.t_s).topology.grid] = rest
    first = plant.units[0]
    for (count, grid), rest in grids.items():
        common = first.R + count * grid.R_g, c.omega_n * (first.L + count * grid.L_g)
        apart = first.R, c.omega_n * first.L
        both = [f"{100.0 * R / c.Z_base:.3g}, {100.0 * X / c.Z_base:.3g}" for R, X in (common, apart)]
        rows[rest.t_s] = (str(count), plain(rest.t_s, 4), both[0], both[1] if count > 1 else "–")
    head = ("units on line", "from [s]", "together: R, X [%]", "against each other: R, X [%]")
    note = "x_t + n Z_g and x_t alone, in per cent of one unit: one set of gains has to be right for both."
    return [Table("The two impedances of a unit", head, tuple(rows[t] for t in sorted(rows)), 0, notes=(note,))]


def steps(result: PlantResult) -> list[Block]:
    """Overshoot and settling time of every step of every unit."""
    found: list[Block] = []
    for one in result.controllers:
        units = zip(units_of(result.study), one.units, strict=True)
        named = [(name, event) for name, unit in units for event in unit.events if event.kind == "step"]
        if named:
            found.append(responses(f"{one.spec.name}: steps", "unit", named))
    return found or [words("No unit has a step of its set points.")]


_PANELS = (("P_pcc", "P [kW]", 1e3), ("Q_pcc", "Q [kvar]", 1e3), ("V_rms", "V [V]", 1.0))
_LINKS = ("v_dc", "v_dc [V]", 1.0)
"""The panel of the dc links, where a unit has one that is not ideal."""


def plant_figures(result: PlantResult) -> list[NamedFigure]:
    """P, Q and voltage of all units, one figure for each controller. The unit that is drawn last is the first one."""
    return [_figure(result.study, one) for one in result.controllers]


def _figure(study: Study, one: PlantController) -> NamedFigure:
    unit = time_unit(study.simulation.duration)
    linked = any(_LINKS[0] in found.series for found in one.units)
    panels = (*_PANELS, *((_LINKS,) if linked else ()))
    height = 0.62 + len(panels) * (_PANEL_IN + _GAP_IN)
    names = units_of(study)
    with look():
        figure = new_figure(PAGE_IN, height)
        panel, lines, texts = None, list[Any](), list[str]()
        for k, (name, label, scale) in enumerate(panels):
            bottom = 0.36 + (len(panels) - 1 - k) * (_PANEL_IN + _GAP_IN)
            panel = add_axes(figure, 0.62, bottom, PAGE_IN - 0.76, _PANEL_IN, sharex=panel)
            for j in reversed(range(len(names))):
                series = one.units[j].series
                if name not in series:
                    continue
                every = max(len(series["t_s"]) // _COLUMNS, 1)
                t_s, values = series["t_s"][::every] / unit.seconds, series[name][::every] / scale
                panel.plot(t_s, values, label=names[j], **line_style(j))
            panel.set_ylabel(label)
            panel.margins(x=0.0)
            mark_events(panel, sorted({event.t_s for event in study.events}), unit)
            panel.tick_params(labelbottom=k + 1 == len(panels))
            lines, texts = (lines, texts) if k else panel.get_legend_handles_labels()
        if panel is not None:
            panel.set_xlabel(f"Time [{unit.symbol}]")
            columns = min(len(names), 8)
            figure.legend(lines[::-1], texts[::-1], ncols=columns, loc="upper right", bbox_to_anchor=(0.985, 0.995))
    links = ", its voltage reference, and the voltage of its dc link" if linked else ", and its voltage reference"
    caption = f"Powers at the terminals of each unit{links}. Dotted lines are events."
    return NamedFigure(f"units_{one.spec.name}", f"{one.spec.name}: all units", caption, figure)
