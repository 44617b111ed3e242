"""Disturbances of the grid through another tool's grid-forming control: motulator's disturbance observer (DO-GFM).

This control has no inertia and no droop, so it shows what is possible without them. It runs in motulator's own
simulation, with the gains that motulator chooses by itself, and its records go through the judge that judges ours.
motulator is no dependency. Install it beside vsgdesign to run this (``pip install motulator``; its present versions
need Python 3.12).
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import itertools
import math
import os
import statistics
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from evidence._field_converters import after
from evidence._tables import leave, table
from vsgdesign.equations.frames import instantaneous_power, rms_to_peak
from vsgdesign.metrics.survival import (
    GRACE_S,
    SETTLING_TIMES,
    ExpectedRest,
    Survival,
    SurvivalRecord,
    judge_survival,
)
from vsgdesign.simulation.survival.cases import GridKnowledge, GridState, SurvivalCase, demand_of
from vsgdesign.simulation.survival.sets import fixed_set
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.event import BASIS
from vsgdesign.study.parameters.grid import Place

LIMIT_PU = 1.2
"""Limit of the current, of the rated peak."""

SETTLING_S = 0.2
"""T of the judge, s: the control settles in about 0.1 s, and 2 T + 0.2 s are 0.6 s."""

DEADLINE_S = SETTLING_TIMES * SETTLING_S + GRACE_S

LEAD_S = 0.4
"""How long it comes to rest before a disturbance, s: motulator starts without current."""

SAMPLING_S = 125e-6
"""motulator's default sampling period, s."""


@dataclass(frozen=True)
class Plant:
    """A packaged converter with an L filter in place of its own, since DO-GFM is made for one."""

    case: str
    L_f_pu: float
    what: str


PLANTS = (
    Plant("hoang2025_5kva", 0.15, "5 kVA, filter of motulator's example"),
    Plant("lab_12kva_lcl", 0.1473, "12.5 kVA, its own L_1 + L_2"),
)

ANY = """
base = "case:{}"
simulation = {{ duration = "1 s", P_ref = 0, Q_ref = 0 }}
controllers = [{{ name = "any", kind = "scheduled" }}]
"""
"""A study of a packaged case, for its converter."""

EVERY = 7
"""Every seventh case runs, since a case takes two seconds. The set repeats itself after two and after five cases."""


def cases() -> tuple[SurvivalCase, ...]:
    """The fixed set, as far as the control can run it and each disturbance once.

    It has no schedule that could be stale or wrong, it holds a voltage instead of Q, and its rest off the nominal
    frequency is not known.
    """
    found = dict.fromkeys(replace(case, knowledge=GridKnowledge()) for case in fixed_set() if _runs(case))
    return tuple(found)[::EVERY]


def _runs(case: SurvivalCase) -> bool:
    nominal = case.start.Q_pu == 0.0 and case.start.df_hz == 0.0
    steps = all(change.df_hz is None and change.over == 0.0 and not change.Q_ref for change in case.changes)
    return nominal and steps and not case.for_ever and case.knowledge.exact


def last_state(case: SurvivalCase) -> GridState:
    """The grid and the references after a case."""
    state = case.start
    for change in case.changes:
        state = after(state, change)
        state = state if change.P_ref is None else replace(state, P_pu=change.P_ref)
    return state


def rest_at(state: GridState, c: Converter, X_f: float) -> ExpectedRest:
    """The rest on a grid, at its source: the control holds P and the length of the voltage before its filter.

    X_f in Ω. Both are held at the same place, since the filter has no resistance.
    """
    grid = Place(state.scr, state.x_over_r, BASIS).grid(c)
    V, V_g, Z = c.V_rated_rms, state.V_g_pu * c.V_rated_rms, complex(grid.R_g, X_f + c.omega_n * grid.L_g)
    # P = 3 (V² R + V V_g |Z| sin(delta − beta)) / |Z|², with beta = arctan(R/X)
    share = (state.P_pu * c.S_rated * abs(Z) ** 2 / 3.0 - V * V * Z.real) / (V * V_g * abs(Z))
    if abs(share) > 1.0:
        return ExpectedRest.none("the grid cannot carry P at rated voltage")
    delta = math.asin(share) + math.atan2(Z.real, Z.imag)
    e_g = rms_to_peak(V_g)
    i = (rms_to_peak(V) * complex(math.cos(delta), math.sin(delta)) - e_g) / Z
    P, Q = instantaneous_power(e_g, 0.0, i.real, i.imag)
    return ExpectedRest(P=float(P), Q=float(Q), delta=delta, i_s_pu=abs(i) / c.I_rated_pk)


def run(plant: Plant, case: SurvivalCase) -> Survival:
    """One case through motulator's DO-GFM, judged."""
    from motulator.grid import control, model  # pyright: ignore[reportMissingImports]

    c = study_from_text(ANY.format(plant.case)).converter
    u, omega, I_max = rms_to_peak(c.V_rated_rms), c.omega_n, LIMIT_PU * c.I_rated_pk
    L_f = plant.L_f_pu * c.Z_base / omega
    demand = demand_of(c, SETTLING_S, limit_pu=LIMIT_PU)
    rest = rest_at(last_state(case), c, omega * L_f)
    for one in (rest_at(case.start, c, omega * L_f), rest):
        refused = one.refused(LIMIT_PU)
        if refused is not None:
            return Survival(status=refused[0], reason=refused[1])
    grid = Place(case.start.scr, case.start.x_over_r, BASIS).grid(c)
    ac_filter = model.LFilter(L_f=L_f, R_f=0.0, L_g=grid.L_g, R_g=grid.R_g)
    source = model.ThreePhaseSource(w_g=omega, e_g=case.start.V_g_pu * u, phi=0.0)
    system = model.GridConverterSystem(model.VoltageSourceConverter(u_dc=c.V_dc), ac_filter, source)
    given = control.ObserverBasedGridFormingControllerCfg(i_max=I_max, L=L_f, u_nom=u, w_nom=omega, T_s=SAMPLING_S)
    controller = control.GridConverterControlSystem(control.ObserverBasedGridFormingController(given))
    controller.set_ac_voltage_ref(u)
    controller.set_power_ref(case.start.P_pu * c.S_rated)
    simulation = model.Simulation(system, controller, show_progress=False)
    instants, sources = [], [(source.e_g, source.phi)]
    for change in case.changes:
        simulation.simulate(LEAD_S + change.t_s - 0.5 * SAMPLING_S)  # up to the sample after this time
        instants.append(controller.t)
        if change.place is not None:
            grid = change.place.grid(c)
            ac_filter.L_g, ac_filter.R_g = grid.L_g, grid.R_g
        if change.V_g_rms is not None:
            source.e_g = change.V_g_rms * u
        if change.P_ref is not None:
            controller.set_power_ref(change.P_ref * c.S_rated)
        source.phi += math.radians(change.phase_deg)
        sources.append((source.e_g, source.phi))
    result = simulation.simulate(instants[-1] + demand.needed_s + SAMPLING_S)
    seen, t = result.ctrl.fbk, result.ctrl.t
    e_g, phi = np.array(sources)[np.searchsorted(instants, t - 1e-9)].T
    rows = np.searchsorted(result.mdl.t, t - 1e-9)
    v_g = e_g * result.mdl.ac_source.exp_j_theta_g[rows] * np.exp(1j * phi)
    frame = np.exp(1j * seen.theta_c)
    i = frame * seen.i_c
    P, Q = instantaneous_power(v_g.real, v_g.imag, i.real, i.imag)
    record = SurvivalRecord(
        t_s=t,
        P=P,
        Q=Q,
        delta=np.angle(frame * seen.v_c * np.conj(v_g)),
        i_s_pu=np.abs(i) / c.I_rated_pk,
        limited=(np.abs(result.ctrl.ref.i_c) > (1.0 - 1e-9) * I_max).astype(float),
    )
    return judge_survival(record, instants, instants[-1], rest, demand)


def main(folder: Path) -> None:
    """Prints one table for each plant and writes a row for each case to motulator_events.json."""
    if importlib.util.find_spec("motulator") is None:
        print("motulator is not installed, so its events are not run: pip install motulator (Python 3.12 or later).")
        return
    version, wanted = importlib.metadata.version("motulator"), cases()
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(max_workers=os.cpu_count()) as pool:
        for plant in PLANTS:
            found = list(pool.map(run, itertools.repeat(plant), wanted, chunksize=4))
            print(f"\nmotulator {version}, DO-GFM, {plant.what} ({plant.L_f_pu:g} pu), limit {LIMIT_PU:g} pu\n")
            head = ("events", "survived", "at rest in time", "left out", "i_s to 5 ms", "after 5 ms", "recovery")
            by: dict[str, list[Survival]] = {}
            for case, one in zip(wanted, found, strict=True):
                by.setdefault(case.group, []).append(one)
            print("\n".join(table(head, (_cells(*group) for group in by.items()))))
            rows += [
                {"plant": plant.what, "L_f_pu": plant.L_f_pu, "group": case.group, "case": case.name, **vars(one)}
                for case, one in zip(wanted, found, strict=True)
            ]
    record = {"motulator": version, "limit_pu": LIMIT_PU, "settling_time": SETTLING_S, "rows": rows}
    leave(folder, "motulator_events", record)


def _cells(group: str, found: list[Survival]) -> tuple[str, ...]:
    """A row of the table. A run that slipped and came to rest in time counts in the second column only."""
    judged = [one for one in found if one.judged]
    recoveries = [one.recovery_s for one in judged if one.recovery_s is not None]
    first, later = (
        max((value for one in judged if (value := getattr(one, name)) is not None), default=math.nan)
        for name in ("first_peak_pu", "peak_pu")
    )
    in_time = sum(one.recovery_s is not None and one.recovery_s <= DEADLINE_S for one in judged)
    survived = f"{sum(one.survived for one in judged)} of {len(judged)}"
    recovery = f"{statistics.median(recoveries):.2f} s, {max(recoveries):.2f} s"
    peaks = (f"{first:.2f} pu", f"{later:.2f} pu")
    return group, survived, f"{in_time}", f"{len(found) - len(judged)}", *peaks, recovery
