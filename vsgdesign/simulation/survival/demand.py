"""What a disturbance asks of a converter: by when it must be at rest, and below which current."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.metrics.survival import GRACE_S, SETTLING_TIMES, ExpectedRest, SurvivalDemand
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.survival.cases import LEARNING_S, SurvivalCase
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import ControllerSpec, Study

SETTLING_TIMES_FOR_EVER = 3.0
"""The deadline in settling times for a schedule that stays stale for ever (:func:`settling_times_asked`)."""


def settling_time_of(spec: ControllerSpec, ready: Ready) -> float:
    """T of a controller: that of its table's specification, or of its closed form, s."""
    table = ready.table(spec)
    if table is not None and "settling_time" in table.specification:
        return float(table.specification["settling_time"])
    return spec.target.settling_time


def silent_s_of(spec: ControllerSpec) -> float:
    """For how long a controller is told nothing after a change of the grid, s; 0 where it is told at once or finds the
    grid by itself."""
    return 0.0 if spec.knowledge is None else spec.knowledge.silent_s


def settling_times_asked(silent_s: Any, settling_time: float) -> Any:
    """The deadline in settling times T (s) for a schedule that is silent for ``silent_s`` after a change; an array or a
    number.

    A schedule that is silent until after the longest deadline, 3 T + 0.2 s, stays stale for ever as far as a run can
    tell, and has this deadline. All others have 2 T + 0.2 s.
    """
    for_ever = np.asarray(silent_s) >= SETTLING_TIMES_FOR_EVER * settling_time + GRACE_S
    return np.where(for_ever, SETTLING_TIMES_FOR_EVER, SETTLING_TIMES)


def demand_of(
    converter: Converter,
    settling_time: float,
    *,
    silent_s: float = 0.0,
    limit_pu: float | None = None,
    cycle_s: float | None = None,
) -> SurvivalDemand:
    """What is asked of a converter whose power loops have the settling time T (s).

    ``silent_s``: for how long its schedule is told nothing after a change, s, which decides the deadline. ``limit_pu``:
    limit of its current; None: the converter's own. ``cycle_s``: period of the grid at the end, s; None: nominal.
    """
    return SurvivalDemand(
        S_rated=converter.S_rated,
        settling_time=settling_time,
        cycle_s=2.0 * math.pi / converter.omega_n if cycle_s is None else cycle_s,
        i_max_pu=converter.current_limit_pu if limit_pu is None else limit_pu,
        settling_times=float(settling_times_asked(silent_s, settling_time)),
    )


LEAST_SHARE = 0.8
"""A converter at its limit must still carry this share of the power that is asked for, or of what the grid carries with
this current where that is less. It is this project's choice; a converter that has latched up carries about half."""

_LAST_S = 0.1
"""Means at the end of a run are over this time, s."""


def held_fault(study: Study, simulation: Simulation, asked: ExpectedRest) -> str | None:
    """Why a converter at rest at its current limit has latched up; None: it does what its current allows.

    ``asked`` is the rest without a limit. A power loop that still integrates while the limiter holds the current leaves
    the limits of the voltage, or the converter carries far less than it could. In a grid whose voltage is below its
    limits the current may be reactive, so that the power is not looked at. The largest power is V_g·I − R·I² at the
    limit if the converter takes it, and about V_g·I if it sends it, at unity power factor.
    """
    c, timeline, end_s = study.converter, simulation.timeline, study.simulation.duration
    limit_pu = c.current_limit_pu
    if limit_pu is None:
        return None
    rows = max(round(_LAST_S / float(simulation.each_s[1] - simulation.each_s[0])), 1)
    V_pu, P_pu = (
        float(np.mean(simulation.each(name)[-rows:])) / base
        for name, base in (("V_rms", c.V_rated_rms), ("P", c.S_rated))
    )
    if not c.V_min_pu <= V_pu <= c.V_max_pu:
        return (
            f"held by its limiter with a voltage reference of {V_pu:.3g} pu, outside of {c.V_min_pu:g} to "
            f"{c.V_max_pu:g} pu"
        )
    source, network = timeline.source_at(end_s), timeline.network_at(end_s)
    V_g = source.V_g_rms / c.V_rated_rms
    if network.load is not None or not network.connected or V_g < c.V_min_pu:
        return None
    asked_pu = asked.P / c.S_rated
    if asked.obstacle is not None:  # then the droops ask for what was set, if the frequency is nominal
        if not math.isclose(source.omega, c.omega_n, rel_tol=1e-9):
            return None
        asked_pu = timeline.references_at(end_s).P_ref / c.S_rated
    most = V_g * limit_pu
    if asked_pu < 0.0:
        R = study.path_to_grid(timeline.grid_at(end_s), c.omega_n)[0] / c.Z_base
        i = min(limit_pu, V_g / (2.0 * R)) if R > 0.0 else limit_pu
        most = V_g * i - R * i * i
    needed = LEAST_SHARE * min(abs(asked_pu), most)
    if P_pu * math.copysign(1.0, asked_pu) >= needed:
        return None
    return (
        f"held by its limiter at P = {P_pu:.3g} pu: {asked_pu:.3g} pu is asked for, and the grid carries {most:.3g} pu "
        f"with this current; at least {LEAST_SHARE:g} of the smaller one is asked of a converter at its limit"
    )


BAND, BAND_PER_SCR = 0.03, 0.005
"""How far the means of P and Q may be from the rest, as a share of S_rated: a stiff grid's wander moves more power."""

SHARE_INSIDE = 0.95

ROOM = 0.95 / 1.2
"""Largest current of a rest that is asked for where the grid has harmonics, as a share of the limit: theirs come on top
of it."""

CYCLES = 2
"""Powers are judged by their means over so many nominal cycles."""


def field_demand(scr: float, omega_n: float) -> dict[str, Any]:
    """What differs from the demand in a clean grid. ``scr``: of the grid at the end."""
    return {
        "band": BAND + BAND_PER_SCR * scr,
        "share_inside": SHARE_INSIDE,
        "cycle_s": CYCLES * 2.0 * np.pi / omega_n,
    }


def field_cases(cases: tuple[SurvivalCase, ...], seed: int, lead_s: float = LEARNING_S) -> Iterator[SurvivalCase]:
    """The cases, each with a background and sensors of its own and with time to learn the grid before the event."""
    for k, case in enumerate(cases):
        yield replace(case, lead_s=lead_s, draw=int(np.random.SeedSequence([seed, k]).generate_state(1)[0] >> 1))


def at_asked_powers(study: Study, spec: ControllerSpec, ready: Ready) -> Study:
    """The study with references for which it begins at the powers that it asks for.

    The droops answer to the background's voltage and frequency: at 0.5 Hz beside the nominal one a droop of 5 % moves P
    by 0.2 pu. Where the grid cannot carry these powers, nothing is changed, and the case has no rest.
    """
    source, c, at = build_timeline(study).source_at(0.0), study.converter, study.simulation
    grid, wanted = study.grid, (at.P_ref, at.Q_ref)
    V_rms, _ = operating_point(*wanted, source.V_g_rms, *study.path_to_grid(grid, source.omega))
    gains = gain_law(study, spec, ready)(grid.R_g, grid.L_g, *wanted, float(V_rms))
    moved = float(gains.D_p * (source.omega - c.omega_n)), float(gains.D_q * (V_rms - c.V_rated_rms))
    if not np.isfinite(moved).all():
        return study
    events = tuple(
        replace(
            event,
            P_ref=None if event.P_ref is None else event.P_ref + moved[0],
            Q_ref=None if event.Q_ref is None else event.Q_ref + moved[1],
        )
        for event in study.events
    )
    asked = replace(at, P_ref=at.P_ref + moved[0], Q_ref=at.Q_ref + moved[1])
    return replace(study, events=events, simulation=asked)


def late_grid(study: Study, timeline: Timeline, since_s: float) -> tuple[Grid, GridSource]:
    """The grid and the source as the sensors show them, in the mean from ``since_s`` to the end of the run."""
    end_s, T_s = study.simulation.duration, study.converter.T_s
    grid, source = timeline.grid_at(end_s), timeline.source_at(end_s)
    V_rms, omega = source.V_g_rms, source.omega
    first, count = round(since_s / T_s), max(round((end_s - since_s) / T_s), 2)
    if timeline.wander is not None:
        gain, angle = timeline.wander.factors(first, count)
        V_rms *= float(gain.mean())
        omega += float(angle[-1] - angle[0]) / ((count - 1) * T_s)
    if study.sensors is not None:
        errors = 1.0 + np.array(study.sensors.gain_errors)
        of_v, of_i = float(errors[0:3].mean()), float(errors[6:9].mean())
        ratio, part = of_v / of_i, study.filter
        grid = Grid(ratio * (grid.R_g + part.R_2) - part.R_2, ratio * (grid.L_g + part.L_2) - part.L_2)
        V_rms *= of_v
    return grid, GridSource(V_rms, omega)
