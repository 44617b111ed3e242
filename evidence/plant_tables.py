"""Gain tables of three other converters for one to four units behind 3 %, as that of ``studies/plant`` in per unit.

The inner loops of two are those of ``studies/survival`` with another transient reactance; those of the third are
designed for units (:func:`vsgdesign.design.inner.design_inner_loops` with ``decay_apart``). A table is built with its
proof of both modes, or found again in the folder. With its gains, at its nodes and with three powers, the units against
each other are looked at behind other transformers, too.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._tables import leave, table
from evidence.plant_apart import STUDIES, X_T, behind
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.gain_table_file import read_table_file, write_table_file
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.design.table import build_table
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.full_order import Cell, steady_cells
from vsgdesign.linear.stability.modes_of_units import differential_modes
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.one_unit import as_unit

Array = NDArray[np.float64]

FOR_UNITS = """K_pv = 1.5305
K_iv = 730.15
K_pc = 1.7356
K_ic = 122.87
current_feedforward = 0.65049
transient_resistance_pu = 0.00714
transient_reactance_pu = 0.2526
transient_corner = "33.95 Hz"
"""
"""The design of plant_apart for the 50 kVA converter."""

SURVIVAL = (STUDIES / "survival").as_posix() + "/"
CONVERTERS: dict[str, tuple[str, str]] = {
    "5 kVA, LC": (SURVIVAL + "study.toml", 'transient_reactance_pu = 0.2\ntransient_corner = "20 Hz"\n'),
    "50 kVA, LC": ("case:sized_50kva_208v_60hz", FOR_UNITS),
    "1 MVA, LCL": (SURVIVAL + "utility.toml", 'transient_reactance_pu = 0.3\ntransient_corner = "12 Hz"\n'),
}
"""Where each comes from, and what its inner loops have besides."""

TEXT = """
base = "{base}"
events = []
study = {{ name = "{name}" }}
converter = {{ current_limit_pu = 1.2, current_limiter = "projection" }}
grid = {{ scr_basis = "impedance", scr = 1.5, x_over_r = 5 }}
plant = {{ units = [1, 4], reactance = 0.03, resistance = 0.006 }}
simulation = {{ duration = "3 s", P_ref = "0 W", Q_ref = "0 var" }}
controllers = [{{ name = "table", kind = "scheduled", schedule = "table", update_period = "20 ms" }}]

[power_loops]
structure = "angle_damped"
tau_P = "5 ms"
tau_Q = "5 ms"
P_droop = "5 %"
Q_droop = "5 %"
settling_time = "1 s"

[inner_loops]
{inner}
[specification]
settling_time = "1.3 s"
overshoot = "5 %"
disk_margin = 0.8
damping_ratio = 0.4
P = ["-{P} W", "{P} W"]
Q = ["-{Q} var", "{Q} var"]
error = "20 %"
scr = [1.5, 2, 3, 5, 10, 20]
x_over_r = [1, 2, 5, 20]
"""
RATED = {"5 kVA, LC": 5e3, "50 kVA, LC": 50e3, "1 MVA, LCL": 1e6}
LOOKED = (0.0, 0.01, *X_T)
"""x_t, pu."""
POWERS_PU = (-0.9, 0.0, 0.9)


def unit_of(name: str) -> Study:
    """One unit of the plant of a converter."""
    (base, inner), S = CONVERTERS[name], RATED[name]
    word = "plant_" + name.partition(",")[0].replace(" ", "").lower()
    return as_unit(study_from_text(TEXT.format(base=base, name=word, inner=inner, P=0.9 * S, Q=0.3 * S)), "this table")


def table_of(study: Study, file: Path) -> GainTable:
    """The table of a unit, built where the file is not there."""
    if file.exists():
        return read_table_file(file)
    built = build_table(study, study.controllers[0], file.with_suffix(".cells")).table
    write_table_file(built, file)
    return built


def apart(study: Study, found: GainTable) -> dict[float, float]:
    """The slowest decay between units (1/s) by x_t (pu), with the gains at the nodes and the powers of x_t = 0.03."""
    spec, c = study.controllers[0], study.converter
    law = gain_law(study, spec, NOTHING.with_table(spec.name, found))
    nodes = [Place(scr, x, found.base.scr_basis).grid(c) for scr in found.scr.tolist() for x in found.x_over_r.tolist()]
    grids = [grid for grid in nodes for _ in POWERS_PU]
    R_g, L_g = (np.array([getattr(grid, name) for grid in grids]) for name in ("R_g", "L_g"))
    P = np.tile(c.S_rated * np.array(POWERS_PU), len(nodes))
    Q, V = np.zeros(len(P)), np.full(len(P), c.V_rated_rms)
    gains, known = PowerLoopGains(*[P] * 8), np.arange(len(P))
    for _ in range(3):
        gains = PowerLoopGains(*(np.broadcast_to(value, P.shape) for value in law(R_g, L_g, P, Q, V)))
        each = [PowerLoopGains(*row) for row in np.stack(gains, axis=1).tolist()]
        rests = steady_cells(study, [Cell(g, own, p, 0.0) for g, own, p in zip(grids, each, P.tolist(), strict=True)])
        known = np.array([k for k, fault in enumerate(rests.faults) if fault is None], dtype=np.intp)
        if rests.states is None:
            raise RuntimeError("no node has a rest")
        Q[known], V[known] = np.asarray(rests.states.Q)[known], np.asarray(rests.states.V)[known]
    some = PowerLoopGains(*(value[known] for value in gains))
    bare = replace(study, filter=behind(study, -X_T[1]))
    decays = {}
    for x_t in LOOKED:
        own = replace(study, filter=behind(bare, x_t))
        if own.filter.L_2 > 1e-9:
            s = differential_modes(own, some, P[known], Q[known], V[known], c.omega_n)
            decays[x_t] = -float(np.nan_to_num(s.real, nan=np.inf).max())
    return decays


def proof_in_words(found: GainTable) -> str:
    """The decay that is proved of both modes."""
    record: Any = None if found.certificate is None else found.certificate.document
    if record is None or not record["certified"]:
        return "no"
    own = record["differential"]
    return f"{record['decay']:.2f} 1/s, " + (f"{own['decay']:.2f} 1/s" if own["certified"] else "no")


def main(folder: Path) -> None:
    rows, cells = [], []
    for name in CONVERTERS:
        study = unit_of(name)
        found = table_of(study, folder / f"{study.name}.json")
        decays = apart(study, found)
        met, between = int((found.status == "met").sum()), found.between or {}
        worst = float(np.nanmin(found.margins["worst_differential_decay_1_s"]))
        row = {"converter": name, "met": met, "of": found.status.size, "worst": worst, "decays": decays}
        rows.append(row | {"between": between})
        cells.append(
            (
                name,
                f"{study.inner_gains.X_t / study.converter.Z_base:.2f} pu above {study.omega_t / (2.0 * np.pi):.3g} Hz",
                f"{met} of {found.status.size}",
                f"{worst:.2f} 1/s",
                *(f"{decays[x_t]:.1f} 1/s" if x_t in decays else "–" for x_t in LOOKED),
                proof_in_words(found),
            )
        )
    head = (
        "converter", "transient reactance", "nodes kept", "worst decay, with errors",
        *(f"x_t {x_t:g}" for x_t in LOOKED),
        "proved, together and against each other",
    )  # fmt: skip
    leave(folder, "plant_tables", json.loads(json.dumps(rows, default=str)), table(head, cells))
