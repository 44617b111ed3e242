"""Random disturbances of a converter whose schedule is driven by the field estimator, in a dirty grid.

The kinds are those of the survival set, each with random grids, powers, sizes and instants. Every draw rests with room
for harmonics before and after the disturbance.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from evidence._field_converters import ROOM_PU, Converter, resting_currents
from evidence._field_draws import SCR, X_OVER_R, FieldDraw, Surroundings, log_uniform, uniform
from vsgdesign.simulation.survival.cases import GridState
from vsgdesign.study.parameters.event import Event

EVENT_S = 1.6
"""Earliest instant of a disturbance, s."""

AFTER_S = 2.8
"""Length of a run after its clearing, s: 2 s until it must be at rest, and 0.8 s in which this is judged."""

_ATTEMPTS = 2_000


@dataclass(frozen=True)
class Disturbance:
    """Changes with times after the beginning of the disturbance, and whether every state in between is asked to have a
    rest."""

    changes: tuple[Event, ...]
    rests_between: bool = True


class NoDrawError(Exception):
    """What was drawn does not serve: the next attempt."""


Kind = Callable[[np.random.Generator, GridState], Disturbance]


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _other(rng: np.random.Generator, start: GridState) -> float:
    """A short-circuit ratio that differs by a factor of 1.5 or more."""
    scr = log_uniform(rng, *SCR)
    if max(scr / start.scr, start.scr / scr) < 1.5:
        raise NoDrawError
    return scr


def _jump(rng: np.random.Generator, start: GridState) -> Disturbance:
    return Disturbance((Event.of_pu(0.0, scr=_other(rng, start), x_over_r=start.x_over_r),))


def _jump_of_both(rng: np.random.Generator, start: GridState) -> Disturbance:
    return Disturbance((Event.of_pu(0.0, scr=_other(rng, start), x_over_r=log_uniform(rng, *X_OVER_R)),))


def _phase(rng: np.random.Generator, _: GridState) -> Disturbance:
    return Disturbance((Event.of_pu(0.0, phase_deg=_sign(rng) * uniform(rng, 5.0, 60.0)),))


def _dip_to(rng: np.random.Generator, start: GridState) -> float:
    return round(start.V_g_pu * uniform(rng, 0.05, 0.7), 5)


def _dip(rng: np.random.Generator, start: GridState) -> Disturbance:
    length = uniform(rng, 0.15, 0.5)
    begun, over = Event.of_pu(0.0, V_g_pu=_dip_to(rng, start)), Event.of_pu(length, V_g_pu=start.V_g_pu)
    return Disturbance((begun, over), rests_between=False)


def _dip_and_jump(rng: np.random.Generator, start: GridState) -> Disturbance:
    scr, phase = _other(rng, start), uniform(rng, -15.0, 15.0)
    begun = Event.of_pu(0.0, V_g_pu=_dip_to(rng, start))
    over = Event.of_pu(uniform(rng, 0.1, 0.3), V_g_pu=start.V_g_pu, scr=scr, x_over_r=start.x_over_r, phase_deg=phase)
    return Disturbance((begun, over), rests_between=False)


def _ramp(rng: np.random.Generator, start: GridState) -> Disturbance:
    by = _sign(rng) * uniform(rng, 0.5, 2.0)
    away = Event.of_pu(0.0, df_hz=round(start.df_hz + by, 5), over_s=1.0)
    return Disturbance((away, Event.of_pu(1.8, df_hz=start.df_hz, over_s=1.0)))


def _frequency(rng: np.random.Generator, start: GridState) -> Disturbance:
    by = _sign(rng) * uniform(rng, 0.1, 0.5)
    return Disturbance((Event.of_pu(0.0, df_hz=round(start.df_hz + by, 5)),))


def _power(rng: np.random.Generator, start: GridState) -> Disturbance:
    step = -uniform(rng, 0.2, 1.2) if start.P_pu > 0.0 else uniform(rng, 0.2, 1.2)
    return Disturbance((Event.of_pu(0.0, P_pu=step),))


def _overload(rng: np.random.Generator, start: GridState) -> Disturbance:
    sign = 1.0 if start.P_pu > 0.0 else -1.0
    over, back = Event.of_pu(0.0, P_pu=sign * uniform(rng, 0.5, 1.0)), Event.of_pu(1.0, P_pu=0.0)
    return Disturbance((over, back), rests_between=False)


def _there_and_back(rng: np.random.Generator, start: GridState) -> Disturbance:
    scr = _other(rng, start)
    there = Event.of_pu(0.0, scr=scr, x_over_r=start.x_over_r)
    back = Event.of_pu(uniform(rng, 0.06, 0.3), scr=start.scr, x_over_r=start.x_over_r)
    return Disturbance((there, back))


def _three_dips(rng: np.random.Generator, start: GridState) -> Disturbance:
    apart, to = uniform(rng, 0.3, 0.4), _dip_to(rng, start)
    changes = []
    for k in range(3):
        changes.append(Event.of_pu(round(apart * k, 5), V_g_pu=to))
        changes.append(Event.of_pu(round(apart * k + 0.15, 5), V_g_pu=start.V_g_pu))
    return Disturbance(tuple(changes), rests_between=False)


def _all_at_once(rng: np.random.Generator, start: GridState) -> Disturbance:
    scr = _other(rng, start)
    phase, by = _sign(rng) * uniform(rng, 5.0, 20.0), _sign(rng) * uniform(rng, 0.1, 0.3)
    df = round(start.df_hz + by, 5)
    return Disturbance((Event.of_pu(0.0, scr=scr, x_over_r=start.x_over_r, phase_deg=phase, df_hz=df),))


KINDS: dict[str, tuple[int, Kind]] = {
    "jump of SCR": (5, _jump),
    "jump of SCR and X/R": (3, _jump_of_both),
    "phase": (3, _phase),
    "dip": (4, _dip),
    "dip, then another SCR": (5, _dip_and_jump),
    "ramp of frequency": (1, _ramp),
    "step of frequency": (1, _frequency),
    "power": (1, _power),
    "overload": (1, _overload),
    "there and back": (1, _there_and_back),
    "three dips": (1, _three_dips),
    "SCR, phase and frequency": (1, _all_at_once),
}
"""Each kind with its share of the draws."""

_TURNS = tuple(name for name, (share, _) in KINDS.items() for _ in range(share))


def survival_draw(converter: Converter, seed: int) -> FieldDraw:
    """The disturbance of a seed: the first of its draws that rests with room for harmonics before and after.

    Consecutive seeds take turns in the kinds.
    """
    group = _TURNS[seed % len(_TURNS)]
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([zlib.crc32(f"{converter.name}, survival".encode()), seed, attempt])
        start = GridState(
            scr=log_uniform(rng, *SCR),
            x_over_r=log_uniform(rng, *X_OVER_R),
            P_pu=uniform(rng, -0.9, 0.9),
            Q_pu=uniform(rng, -0.1, 0.1),
            V_g_pu=uniform(rng, 0.9, 1.1),
            df_hz=uniform(rng, -0.5, 0.5),
        )
        at_s = round(EVENT_S + 0.02 * float(rng.random()), 6)
        try:
            found = KINDS[group][1](rng, start)
        except NoDrawError:
            continue
        currents = resting_currents(converter, start, found.changes, each=found.rests_between)
        if currents is None or max(currents) > ROOM_PU:
            continue
        changes = tuple(replace(one, t_s=round(at_s + one.t_s, 6)) for one in found.changes)
        return FieldDraw(
            group=group,
            converter=converter.name,
            seed=seed,
            start=start,
            changes=changes,
            duration_s=round(max(one.end_s for one in changes) + AFTER_S, 6),
            surroundings=Surroundings(seed=int(rng.integers(1 << 31))),
        )
    raise ValueError(f"{converter.name}, seed {seed}: no draw in {_ATTEMPTS} attempts rests with room for harmonics.")
