"""Disturbances in a grid that is never at rest: what is asked of a converter there, and where it should come to rest.

The study has a background or sensors. The rest is then that of the equations with the mean voltage and frequency that
the grid really had in the end, and with the mean gains of the sensors, because the converter controls what these say.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.source import GridSource
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.survival.cases import LEARNING_S, SurvivalCase
from vsgdesign.simulation.timeline import Timeline, build_timeline

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
