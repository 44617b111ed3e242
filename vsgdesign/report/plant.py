"""What a run of a plant prints on a terminal: outcomes of the units, and the modes at each rest."""

from __future__ import annotations

import math

import numpy as np

from vsgdesign.equations.frames import peak_to_rms
from vsgdesign.report.drawing.quantities import DASH, plain
from vsgdesign.report.page.blocks import Block, Table, Where, words
from vsgdesign.report.scenario.tables import DC_HEAD, DC_NOTE, dc_cut, dc_row
from vsgdesign.simulation.units.scenario import PlantController, PlantRest, PlantResult


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
        "slowest mode [1/s]",
        "[Hz]",
        "damping",
        "together",
        "against each other",
        "most in it",
    )
    return Table(
        f"{one.spec.name}: modes of the whole plant at rest", head, tuple(map(_row, one.rests)), on=Where.TERMINAL
    )


def _row(rest: PlantRest) -> tuple[str, ...]:
    start = (plain(rest.t_s, 4), rest.name, str(len(rest.on_line)))
    if not rest.modes:
        return (*start, *(DASH,) * 6)
    slowest = rest.modes[0]
    own = plain(slowest.s.real, 3), plain(abs(slowest.s.imag) / (2.0 * math.pi), 3), plain(slowest.damping, 2)
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
