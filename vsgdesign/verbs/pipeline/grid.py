"""From a network model to the grid that a converter sees at a bus: SCR and X/R with everything in and in outages."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.files import check_new, plain, write_new_text
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.errors import Fault, InfeasibleStudyError, StudyError, did_you_mean
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.study.datasheet.study_text import nodes, one_line
from vsgdesign.study.given_files import RESULT_BYTES, read_given
from vsgdesign.study.networks.model import S_BASE, Given, Network, check_network, part_of, with_sources
from vsgdesign.study.networks.thevenin import (
    STRONG,
    WEAK,
    column_at,
    first_resonance,
    has_capacitance,
    over_frequency,
    read_network,
)
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS
from vsgdesign.study.parameters.loading import merged_document
from vsgdesign.study.parameters.reader import parse_quantity

VERB = "vsgdesign grid"
N_1, NONE = "n-1", "none"
"""Outages: of each element, or of none."""
NEAR = 0.1
"""A converter is listed where it sees at least this share of a change of the voltage at the bus."""
LAST_HZ, STEP_HZ = 2000.0, 5.0
F_N = 50.0
"""Hz, where neither the file nor the person gives the nominal frequency."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What is asked of a network."""

    bus: str
    S: float
    """VA of the converter."""
    outages: str = N_1
    """:data:`N_1`, :data:`NONE`, or a file with one outage in each line: names of elements with ";" between them."""
    given: Given = field(default_factory=Given)
    loads: bool = False
    """Whether loads count as impedances."""
    f_n: float | None = None
    """Hz; None: that of the file, else 50 Hz."""


@dataclass(frozen=True)
class Case:
    """The impedance with some elements out. ``Z`` is None where no path leads to a source."""

    name: str
    out: tuple[str, ...]
    strong: bool
    """Whether the sources have their largest short-circuit power."""
    Z_pu: complex | None
    """Of :data:`vsgdesign.study.networks.model.S_BASE`."""
    scr: float
    x_over_r: float


@dataclass(frozen=True)
class Near:
    """A converter of the network, and which share of a change of the voltage at the bus it sees."""

    name: str
    bus: str
    S: float
    share: float


@dataclass(frozen=True, kw_only=True)
class GridOfNetwork:
    """What a converter sees at a bus."""

    network: Network
    asked: Asked
    bus: str
    V_n_ll_rms: float
    f_n: float
    cases: tuple[Case, ...]
    """N first."""
    near: tuple[Near, ...]
    f_hz: NDArray[np.float64]
    """Empty where nothing has a capacitance."""
    Z_pu: NDArray[np.complex128]
    resonance_hz: float | None

    @property
    def known(self) -> tuple[Case, ...]:
        """The cases in which a path leads to a source."""
        return tuple(case for case in self.cases if case.Z_pu is not None)

    @property
    def scr(self) -> tuple[float, float]:
        """The smallest and the largest SCR over all cases, on the impedance."""
        values = [case.scr for case in self.known]
        return min(values), max(values)

    @property
    def x_over_r(self) -> tuple[float, float]:
        """The smallest and the largest X/R over all cases."""
        values = [case.x_over_r for case in self.known]
        return min(values), max(values)

    @property
    def nodes(self) -> tuple[list[float], list[float]]:
        """SCR and X/R of a table that holds all cases; around a single value one fifth to either side."""
        return nodes(self.scr), nodes(self.x_over_r)

    @property
    def Z_base(self) -> float:
        """Ω of the network's per unit; nan where the file has no voltages."""
        return self.V_n_ll_rms**2 / S_BASE


def grid_of_network(path: str | Path, asked: Asked, *, progress: Progress | None = None) -> GridOfNetwork:
    """The grid at a bus of a network file. Raises StudyError with every fault of the file, the bus, the sources and the
    outages, and InfeasibleStudyError where no path leads from the bus to a source or a library is missing."""
    tell = progress or silent
    tell("read the network", 0.0)
    network = with_sources(read_network(path), asked.given)
    check_network(network)
    tell("read the network", 1.0)
    return grid_at(network, asked, progress=progress)


def grid_at(network: Network, asked: Asked, *, progress: Progress | None = None) -> GridOfNetwork:
    """The same of a network that was read, checked and has the impedances of its sources."""
    tell = progress or silent
    bus = network.bus(asked.bus)
    outages = _outages(network, asked.outages)
    sides = (WEAK,) if all(one.z is None or one.z[0] == one.z[1] for one in network.sources) else (WEAK, STRONG)
    cases, whole = [], part_of(network, bus)
    if whole is None:
        name = network.buses[bus].name
        raise InfeasibleStudyError(f'{network.file}: no path leads from "{name}" to a source.')
    count = len(outages) * len(sides)
    for k, (out, side) in enumerate(itertools.product(outages, sides)):
        tell("outages", k / count)
        cases.append(_case(network, bus, out, side, asked, several=len(sides) > 1))
    tell("outages", 1.0)
    f_n = asked.f_n or network.f_n or F_N
    part, place = whole
    f_hz, Z, resonance = _scan(part, place, f_n, asked.loads, tell)
    return GridOfNetwork(
        network=network,
        asked=asked,
        bus=network.buses[bus].name,
        V_n_ll_rms=network.buses[bus].V_n_ll_rms,
        f_n=f_n,
        cases=tuple(cases),
        near=tuple(_near(part, place, asked.loads)),
        f_hz=f_hz,
        Z_pu=Z,
        resonance_hz=resonance,
    )


def _outages(network: Network, asked: str) -> list[tuple[str, ...]]:
    known = network.elements
    if asked == NONE:
        return [()]
    if asked == N_1:
        return [(), *((name,) for name in known)]
    try:
        lines = read_given(Path(asked), RESULT_BYTES).decode().splitlines()
    except (OSError, ValueError) as error:
        advice = 'Give "n-1", "none", or a file with one outage in each line.'
        raise StudyError(network.file, [Fault("outages", f'"{asked}"', f"cannot be read ({error})", advice)]) from None
    found = [tuple(name.strip() for name in line.split(";") if name.strip()) for line in lines]
    found = [out for out in found if out and not out[0].startswith("#")]
    faults = [
        Fault("outages", f'"{name}"', "unknown", did_you_mean(name, known, "Names are those of the file."))
        for name in dict.fromkeys(itertools.chain.from_iterable(found))
        if name not in known
    ]
    if faults:
        raise StudyError(network.file, faults)
    return [(), *found]


def _case(network: Network, bus: int, out: tuple[str, ...], side: int, asked: Asked, *, several: bool) -> Case:
    name = f"without {' and '.join(out)}" if out else "N"
    name += (", strong sources" if side == STRONG else ", weak sources") if several else ""
    found = part_of(network.without(out), bus)
    if found is None:
        return Case(name, out, side == STRONG, None, math.nan, math.nan)
    part, place = found
    z = complex(column_at(part, place, source=side, loads=asked.loads)[place])
    if z.real <= 0.0 or z.imag <= 0.0:
        raise InfeasibleStudyError(
            f'{network.file}: {name}, the impedance at "{network.buses[bus].name}" is {z:.4g} pu of 100 MVA, and no R '
            "and L in series has it. Capacitances or a missing resistance make it so."
        )
    return Case(name, out, side == STRONG, z, S_BASE / (abs(z) * asked.S), z.imag / z.real)


def _scan(
    part: Network, place: int, f_n: float, loads: bool, tell: Callable[[str, float], None]
) -> tuple[NDArray[np.float64], NDArray[np.complex128], float | None]:
    if not has_capacitance(part):
        return np.empty(0), np.empty(0, dtype=complex), None
    tell("impedance over frequency", 0.0)
    f_hz = np.arange(f_n, LAST_HZ + 0.5 * STEP_HZ, STEP_HZ)
    z = over_frequency(part, place, f_hz / f_n, loads=loads)
    order = first_resonance(part, place, f_hz / f_n, z, loads=loads)
    tell("impedance over frequency", 1.0)
    return f_hz, z, None if order is None else order * f_n


def _near(part: Network, place: int, loads: bool) -> Sequence[Near]:
    """Those that see most come first (:eq:`network-share`)."""
    column = column_at(part, place, loads=loads)
    found = [
        Near(one.name, part.buses[one.bus].name, one.S, float(abs(column[one.bus] / column[place])))
        for one in part.converters
    ]
    return sorted((one for one in found if one.share >= NEAR), key=lambda one: -one.share)


def grid_document(found: GridOfNetwork) -> dict[str, Any]:
    """Everything that was found, in JSON's types."""
    ohm = found.Z_base
    return plain(
        {
            "network": {
                "file": found.network.file,
                "program": found.network.program,
                "buses": len(found.network.buses),
                "branches": len(found.network.branches),
                "loads": len(found.network.loads),
            },
            "bus": found.bus,
            "V_n_ll_rms": found.V_n_ll_rms,
            "S": found.asked.S,
            "f_n": found.f_n,
            "f_n_given": (found.asked.f_n or found.network.f_n) is not None,
            "loads": found.asked.loads,
            "sources": [
                {"name": one.name, "kind": one.kind, "bus": found.network.buses[one.bus].name}
                | {f"S_sc_{side}": S_BASE / abs(z) for side, z in zip(("max", "min"), one.z or (), strict=False)}
                | {f"x_over_r_{side}": z.imag / z.real if z.real else None for side, z in _sides(one.z)}
                for one in found.network.sources
            ],
            "scr": found.scr,
            "x_over_r": found.x_over_r,
            "nodes": dict(zip(("scr", "x_over_r"), found.nodes, strict=True)),
            "cases": [
                {"name": case.name, "out": case.out, "R": None, "X": None, "S_sc": None, "scr": None, "x_over_r": None}
                if case.Z_pu is None
                else {
                    "name": case.name,
                    "out": case.out,
                    "R": case.Z_pu.real * ohm,
                    "X": case.Z_pu.imag * ohm,
                    "S_sc": S_BASE / abs(case.Z_pu),
                    "scr": case.scr,
                    "x_over_r": case.x_over_r,
                }
                for case in found.cases
            ],
            "converters": [vars(one) for one in found.near],
            "converters_in_all": len(found.network.converters),
            "capacitance": bool(len(found.f_hz)),
            "resonance_hz": found.resonance_hz,
            "last_hz": LAST_HZ,
            "impedance": {
                "f_hz": found.f_hz.tolist(),
                "R": (found.Z_pu.real * ohm).tolist(),
                "X": (found.Z_pu.imag * ohm).tolist(),
            },
        }
    )


def _sides(z: tuple[complex, complex] | None) -> list[tuple[str, complex]]:
    return [] if z is None else list(zip(("max", "min"), z, strict=True))


def grid_study_text(found: GridOfNetwork, base: str | None = None) -> str:
    """The box as the [grid] and [specification] of a study. ``base`` names the study with everything else."""
    n, (scr, x_over_r) = found.known[0], found.nodes
    outages = sum(bool(case.out) for case in found.known)
    head = [
        f"# The grid at bus {one_line(found.bus)} of {one_line(found.network.file)}: written by `vsgdesign grid`.",
        f"# {outages} outages; SCR for {found.asked.S / 1e6:g} MVA, on the impedance.",
    ]
    if base is None:
        head.append('# The converter is missing: put base = "STUDY.toml" of your converter on the next line.')
    else:
        head.append(f"base = {json.dumps(base, ensure_ascii=False)}")
    return "\n".join(
        [
            *head,
            "",
            "[grid]                           # with everything in",
            'scr_basis = "impedance"',
            f"scr = {n.scr:.6g}",
            f"x_over_r = {n.x_over_r:.6g}",
            "",
            "[specification]                  # the nodes of a table that holds all outages",
            'scr_basis = "impedance"',
            f"scr = [{', '.join(f'{value:.6g}' for value in scr)}]",
            f"x_over_r = [{', '.join(f'{value:.6g}' for value in x_over_r)}]",
            "",
        ]
    )


def report_grid(
    path: str | Path,
    folder: str | Path,
    asked: Asked,
    *,
    study: str | Path | None = None,
    base: str | None = None,
    progress: Progress | None = None,
) -> GridOfNetwork:
    """Finds the grid at a bus and writes report.html, results.json, cases.csv and figures to ``folder``.

    ``study`` is a file for the box as a study's [grid] and [specification], which must not be there yet, and ``base``
    the study that it names. Raises ArtifactError and the errors of :func:`grid_of_network`.
    """
    from vsgdesign.report.drawing.figures import write_all
    from vsgdesign.report.network import grid_figures, grid_page
    from vsgdesign.report.page.html import print_html

    named = None if base is None else _named_base(base, study, asked)
    if study is not None:
        check_new(study)
    with staged_folder(folder, VERB, inputs=[path]) as staged:
        found = grid_of_network(path, asked, progress=progress)
        if study is not None:
            _check_limits(found)
        document = grid_document(found)
        figures = write_all(grid_figures(document), staged / "figures")
        print_html(grid_page(document, figures), staged / "report.html")
        keys = ("R", "X", "S_sc", "scr", "x_over_r")
        header = ("case", "R [ohm]", "X [ohm]", "S_sc [VA]", "SCR", "X/R")
        write_table(
            staged / "cases.csv", header, ([one["name"], *(one[key] for key in keys)] for one in document["cases"])
        )
        write_record(staged, document | {"provenance": provenance()}, VERB)
        if study is not None:
            write_new_text(study, grid_study_text(found, named))
    return found


def _check_limits(found: GridOfNetwork) -> None:
    """Raises InfeasibleStudyError where no study can have the grids."""
    for name, values, (low, high) in zip(("SCR", "X/R"), found.nodes, (SCR_LIMITS, X_OVER_R_LIMITS), strict=True):
        if values[0] < low or values[-1] > high:
            raise InfeasibleStudyError(
                f"{found.network.file}: {name} is {values[0]:.4g} to {values[-1]:.4g} at {found.bus}, and a study "
                f"takes {low:g} to {high:g}. Leave --out away, or look whether --s is in VA."
            )


def _named_base(base: str, study: str | Path | None, asked: Asked) -> str:
    """The base as the study names it, from its own folder. Raises StudyError for one that is not there, or whose
    converter has another rating than the one that is asked for."""
    document = merged_document({"base": base}, Path.cwd(), "grid")
    rating = (document.get("converter") or {}).get("S_rated")
    if rating is not None and not math.isclose(parse_quantity(rating, "VA"), asked.S, rel_tol=1e-6):
        problem = f'SCR is asked for {asked.S / 1e6:g} MVA, and the converter of "{base}" has another rating'
        raise StudyError("grid", [Fault("base", f'S_rated = "{rating}"', problem, "Give --s as this rating.")])
    if base.startswith("case:"):
        return base
    folder = Path.cwd() if study is None else Path(study).absolute().parent
    return Path(os.path.relpath(Path(base).absolute(), folder)).as_posix()
