"""Islands: whether the units of a plant without a source share its load as their droops say, and rest in time
(:eq:`plant-sharing`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vsgdesign.equations.dc_control import clamped_rest
from vsgdesign.equations.frames import peak_to_rms
from vsgdesign.metrics.step_response import SETTLING_BAND, cycle_mean, settling_time
from vsgdesign.simulation.survival.verdicts import ISLAND_F
from vsgdesign.simulation.units.run import PlantRun, UnitRun

if TYPE_CHECKING:
    from vsgdesign.simulation.units.scenario import PlantRest

SHARED = 0.01
"""By how much the power of a unit may differ from what its droop says, as a share of its rating."""

_LAST_CYCLES = 5
"""Means are over so many nominal cycles."""


@dataclass(frozen=True, kw_only=True)
class Sharing:
    """A unit at the end of a stretch in which no source is connected."""

    unit: str
    t_s: float
    """When the stretch begins, s."""
    name: str
    """What happens then."""
    P: float
    Q: float
    """Means at its control point at the end, W and var."""
    P_droop: float
    """What its droop says of P at the frequency of the island, W. Where its controller clamps it, no more than the
    source of its dc link can give."""
    Q_droop: float
    """What its droop says of Q at its voltage reference, var."""
    f_hz: float
    """Of the island: the mean over its units."""
    V_pu: float
    """The voltage at its capacitor, pu of rated."""
    settled_s: float | None
    """From when on its powers are within 2 % of the rating of where they end; None: they still move."""
    fault: str | None
    """Why the island is not as it should be; None: all is well."""


def sharing_of(run: PlantRun, rests: Sequence[PlantRest], settling_time_s: float) -> tuple[Sharing, ...]:
    """What each unit on line gives at the end of each stretch without a source. A unit should rest within
    2 T + 0.2 s, T being the settling time of its power loops."""
    found = []
    for rest in rests:
        if rest.islanded and not run.divergence:
            rows = np.flatnonzero((run.t_s >= rest.t_s - 1e-9) & (run.t_s <= rest.end_s))
            found += _of_stretch(run, rest, rows, settling_time_s)
    return tuple(found)


def _of_stretch(run: PlantRun, rest: PlantRest, rows: np.ndarray, settling_time_s: float) -> list[Sharing]:
    on_line = [(k, one) for k, one in enumerate(run.units) if one.name in rest.on_line]
    if len(rows) < 2 or not on_line:
        return []
    dt = float(run.t_s[1] - run.t_s[0])
    cycle = max(round(2.0 * math.pi / on_line[0][1].study.converter.omega_n / dt), 1)
    last = rows[-_LAST_CYCLES * cycle :]
    omega = float(np.mean([one.column("omega")[last].mean() for _, one in on_line]))
    return [_of_unit(run, k, one, rest, (rows, last), cycle, omega, settling_time_s) for k, one in on_line]


def _of_unit(
    run: PlantRun,
    k: int,
    unit: UnitRun,
    rest: PlantRest,
    rows_last: tuple[np.ndarray, np.ndarray],
    cycle: int,
    omega: float,
    settling_time_s: float,
) -> Sharing:
    (rows, last), c = rows_last, unit.study.converter
    gains = [one.gains for one in unit.gain_changes if one.t_s < rest.end_s or one.t_s == 0.0][-1]
    refs = run.timeline.timelines[k].references_at(rest.t_s)
    P, Q, V = (float(unit.column(name)[last].mean()) for name in ("P", "Q", "V_rms"))
    P_droop = refs.P_ref + gains.D_p * (refs.omega_0 - omega)
    link = run.timeline.timelines[k].link_at(rest.t_s)
    if link is not None and link.clamps:
        limits, own = link.can_give(c, unit.study.filter), link.clamp(c, unit.study.filter).own
        P_droop = float(clamped_rest(P_droop, limits, own))
    Q_droop = refs.Q_ref + gains.D_q * (refs.V_n - V)
    away = np.zeros(len(rows))
    for name, end in (("P", P), ("Q", Q)):
        away = np.maximum(away, np.abs(cycle_mean(unit.column(name)[rows], cycle) - end) / c.S_rated)
    settled = settling_time(run.t_s[rows] - rest.t_s, away, SETTLING_BAND)
    v_c = np.hypot(unit.column("v_c_alpha")[last], unit.column("v_c_beta")[last]).mean()
    f_hz, f_n, V_pu = omega / (2.0 * math.pi), c.omega_n / (2.0 * math.pi), peak_to_rms(float(v_c)) / c.V_rated_rms
    deadline = 2.0 * settling_time_s + 0.2
    fault = None
    if settled is None or settled > deadline:
        fault = f"its powers are not at rest {deadline:.3g} s after {rest.name}"
        if rest.end_s - rest.t_s < deadline:
            fault = (
                f"the {rest.end_s - rest.t_s:.3g} s after {rest.name} are less than the {deadline:.3g} s that it has"
            )
    elif abs(f_hz - f_n) > ISLAND_F * f_n:
        fault = f"the island has {f_hz:.4g} Hz, more than {100.0 * ISLAND_F:g} % beside {f_n:g} Hz"
    elif not c.V_min_pu <= V_pu <= c.V_max_pu:
        fault = f"its voltage is {V_pu:.3g} pu, outside of {c.V_min_pu:g} to {c.V_max_pu:g} pu"
    elif abs(P - P_droop) > SHARED * c.S_rated or abs(Q - Q_droop) > SHARED * c.S_rated:
        fault = (
            f"it gives {P / 1e3:.4g} kW and {Q / 1e3:.4g} kvar, where its droops say {P_droop / 1e3:.4g} kW and "
            f"{Q_droop / 1e3:.4g} kvar"
        )
    return Sharing(
        unit=unit.name,
        t_s=rest.t_s,
        name=rest.name,
        P=P,
        Q=Q,
        P_droop=float(P_droop),
        Q_droop=float(Q_droop),
        f_hz=f_hz,
        V_pu=V_pu,
        settled_s=settled,
        fault=fault,
    )
