"""Energy that events push into the dc link while its source takes none, or draw while it gives none.

A full battery takes nothing, an array takes nothing, and an empty source gives nothing. What an event then pushes into
the link has to find room in the capacitor. The sum is that of the power loops alone: phasors of the grid, a current of
at most its limit, and a balance of energies (:eq:`dc-pushed`, :eq:`dc-jump-by-hand`). It is made before a case runs,
and no inner loop, no sampling and no voltage of the link are in it.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.dc_control import ClampSettings, cut_of
from vsgdesign.equations.dc_source_interface import SourceLimits
from vsgdesign.equations.frames import instantaneous_power, rms_to_peak
from vsgdesign.equations.limiters import PROJECTION
from vsgdesign.equations.limiters.projection import grid_voltage_gate
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops_about_rest
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.dc_rest import bridge_power
from vsgdesign.linear.operating_point.many import ManyStates
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.segments import Segments
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.event_kinds import DC_QUANTITIES
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEP_S = 1e-3
"""Of the sum, s."""

NEAR_S = 0.1
"""A source is full or empty where its charge is so near to the end, as a time at the rated power, s."""

_AFTER = 1.0
"""Settling times after the last change for which the sum goes on."""


class _Swing(NamedTuple):
    """What moves of the power loops, (N,): the angle to the source (rad), the voltage (rms), the offset of
    :func:`power_loops_about_rest` (rad/s), the filtered powers (W, var), and the clamp's slow frequency (rad/s)."""

    delta: Array
    V: Array
    offset: Array
    P: Array
    Q: Array
    slow: Array


class _Source:
    """The energies of the source and of the capacitor, J."""

    def __init__(self, study: Study, link: DcLink, count: int) -> None:
        of = study.converter, study.filter
        self._law, self._kind = link.kind.law, link.kind
        self._constants, self._hold = link.settings(*of).source, link.clamp(*of).hold
        self._charge = np.full(count, link.values.get("charge", 1.0))
        self._whole = math.inf if link.kind.stored is None else float(link.kind.stored(self._constants))
        charge, most = link.values.get("charge", 1.0), NEAR_S * study.converter.S_rated
        rooms = ((1.0 - charge) * self._whole, charge * self._whole) if math.isfinite(self._whole) else (0.0, math.inf)
        self.takes_none, self.gives_none = (room <= most for room in rooms)
        self._spare = np.full(count, rooms[0] if self.takes_none else rooms[1])
        half, idle = 0.5 * link.C, _idle_voltage(link, study)
        self._room = half * (link.V_high**2 - idle**2 if self.takes_none else idle**2 - link.V_low**2)
        self._held, self.over = np.zeros(count), np.zeros(count)

    def can_give(self, hold: float) -> SourceLimits:
        """What the source can give so that its charge lasts for ``hold`` (s), W."""
        recharged = self._kind.recharged
        memory = {} if recharged is None else recharged(self._charge, self._constants)
        found: SourceLimits = self._law.can_give(SimpleNamespace(**memory), hold, self._constants)
        return found

    @property
    def held(self) -> SourceLimits:
        """What the clamp knows of it, W."""
        return self.can_give(self._hold)

    def take(self, p: Array, dt: float) -> None:
        """The bridge takes a power (W) for ``dt`` (s). What the source cannot take or give is the capacitor's."""
        sign = 1.0 if self.takes_none else -1.0
        moved = sign * p * dt  # positive: away from the end of the charge
        charged = 0.0 if self._kind.recharged is None else 1.0
        # What goes out comes from the capacitor first, and leaves room in the source; what comes back goes there first.
        out, back = np.maximum(moved, 0.0), np.maximum(-moved, 0.0)
        from_capacitor = np.minimum(self._held, out)
        self._held -= from_capacitor
        into_source = np.minimum(self._spare, back)
        self._spare += (out - from_capacitor) * charged - into_source
        self._held += back - into_source
        self._charge = self._charge - sign * (out - from_capacitor - into_source) / self._whole
        self.over = np.maximum(self.over, self._held / max(self._room, 1e-12))


def _idle_voltage(link: DcLink, study: Study) -> float:
    """Voltage of the link while the source gives nothing, V; V_dc where it has no such rest."""
    c, bleed = study.converter, 0.0 if link.R_bleed is None else 1.0 / link.R_bleed
    v = c.V_dc
    try:
        for _ in range(8):
            v = float(link.at_rest(-bleed * v * v, c, study.filter).v)
    except InfeasibleStudyError:
        return c.V_dc
    return v


def beyond_the_capacitor(
    study: Study,
    cases: LaneCases,
    segments: Segments,
    start: ManyStates,
    delta: Array,
    gains: tuple[PowerLoopGains, PowerLoopGains],
    settling_time: float,
) -> Mask:
    """Cases, (N,), whose events push more energy into the link, or draw more from it, than the capacitor can take or
    give while its source cannot (:eq:`dc-pushed`).

    ``start``, ``delta``: the rest before, and its angle to the source (N,), rad. ``gains``: those that are known at the
    start and, once the schedule has learnt of the events, at the end. Where the source can both give and take, there
    are none. Cases whose events change the source, and those with a network, are left out.
    """
    none = np.zeros(len(cases), dtype=bool)
    if study.dc is None or cases.networks is not None or len(cases) == 0:
        return none
    source = _Source(study, study.dc, len(cases))
    if not (source.takes_none or source.gives_none):
        return none
    changed = np.isfinite(np.stack([getattr(cases.events, name) for name in DC_QUANTITIES])).any(axis=(0, 2))
    with np.errstate(invalid="ignore", over="ignore"):
        _swing(study, cases, segments, start, delta, gains, settling_time, source)
    return ~changed & np.isfinite(source.over) & (source.over > 1.0)


def _swing(
    study: Study,
    cases: LaneCases,
    segments: Segments,
    start: ManyStates,
    delta: Array,
    gains: tuple[PowerLoopGains, PowerLoopGains],
    settling_time: float,
    source: _Source,
) -> None:
    """The power loops on phasors, from the start to the end of the last case."""
    rows, nominal = np.arange(len(cases)), study.converter.references()
    begun = tuple(np.broadcast_to(gains[0], (len(PowerLoopGains._fields), len(cases))))
    learnt = tuple(np.broadcast_to(gains[1], (len(PowerLoopGains._fields), len(cases))))
    first = np.nanmin(np.where(np.isfinite(cases.events.t_s), cases.events.t_s, np.inf), axis=1)
    known_s = first + cases.silent_s
    at, loops = np.zeros(len(cases), dtype=np.intp), _Loops(study)
    x = _Swing(delta, start.V, cases.omega_g - nominal.omega_0, start.P, start.Q, np.array(cases.omega_g, dtype=float))
    last_s = float(np.max(cases.cleared_s)) + _AFTER * settling_time
    for n in range(math.ceil(last_s / STEP_S)):
        t_s = n * STEP_S
        now = (segments.t_s <= t_s + 1e-9).sum(axis=1) - 1
        if np.any(now != at):
            before = segments.at_column(rows, at).at(segments.t_s[rows, now])
            x = x._replace(delta=x.delta - np.where(now != at, segments.phase[rows, now] - before.phase, 0.0))
            at = now
        grid = segments.at_column(rows, at).at(np.full(len(cases), t_s))
        later = t_s >= known_s
        present = PowerLoopGains(*(np.where(later, b, a) for a, b in zip(begun, learnt, strict=True)))
        x, p = loops.step(x, grid, _references(cases, nominal, t_s), present, source.held)
        source.take(p, STEP_S)


def _references(cases: LaneCases, nominal: References, t_s: float) -> References:
    """The set points at an instant, (N,)."""
    found = {"P_ref": cases.P_ref, "Q_ref": cases.Q_ref, "omega_0": nominal.omega_0, "V_n": nominal.V_n}
    for k in range(cases.events.count):
        for name in References._fields:
            given = getattr(cases.events, name)[:, k]
            if np.isfinite(given).any():
                found[name] = np.where(np.isfinite(given) & (cases.events.t_s[:, k] <= t_s), given, found[name])
    return References(**found)


class _Loops:
    """One step of the power loops on phasors."""

    def __init__(self, study: Study) -> None:
        settings, c = study.controller_settings(), study.converter
        self._study, self._i_max = study, settings.i_max_pk
        self._shares = [1.0 - (1.0 - one) ** (STEP_S / c.T_s) for one in (settings.smoothing_P, settings.smoothing_Q)]
        self._clamp: ClampSettings | None = None
        if study.dc is not None and study.dc.clamps:
            self._clamp = study.dc.clamp(c, study.filter)
            self._slow = 1.0 - (1.0 - self._clamp.smoothing) ** (STEP_S / c.T_s)
        self._pull: Any = None
        if study.limiter is PROJECTION:
            self._pull = settings.limiter
            self._i_max = settings.limiter.i_soft_pk
            self._share = 1.0 - (1.0 - self._pull.share) ** (STEP_S / c.T_s)
            self._most = self._pull.g * self._pull.largest_pull * STEP_S / c.T_s

    def step(
        self, x: _Swing, grid: Segments, refs: References, gains: PowerLoopGains, limits: SourceLimits
    ) -> tuple[_Swing, Array]:
        """The next state, and the power that the bridge takes now, W."""
        f = self._study.filter
        Z = grid.R_g + f.R_2 + 1j * grid.omega * (grid.L_g + f.L_2)
        asked, v_g = rms_to_peak(x.V) * np.exp(1j * x.delta), rms_to_peak(grid.V_g_rms)
        wanted = (asked - v_g) / Z
        size = np.abs(wanted)
        limited = size > self._i_max
        i = np.where(limited, wanted * (self._i_max / np.maximum(size, 1e-12)), wanted)
        v = v_g + Z * i
        P, Q = instantaneous_power(v.real, v.imag, i.real, i.imag)
        P_f, Q_f = (old + share * (new - old) for old, new, share in zip((x.P, x.Q), (P, Q), self._shares, strict=True))
        if self._clamp is not None:
            asked_for = refs.P_ref + gains.D_p * (refs.omega_0 - x.slow)
            refs = refs._replace(P_ref=refs.P_ref + cut_of(asked_for, limits, self._clamp.own))
        omega, _, _ = power_loops_about_rest(x.offset, x.V, P_f, Q_f, refs, gains)
        gate, turn = self._gate(v, v_g, i, grid), 0.0
        missing = refs.P_ref + gains.D_p * (refs.omega_0 - omega) - P_f
        missing_Q = refs.Q_ref + gains.D_q * (refs.V_n - x.V) - Q_f
        if self._pull is not None:
            turn = np.where(limited, np.angle(v / asked), 0.0)
            held = np.where(limited, 1.0 - gate, 0.0)  # without a voltage of the grid the loops rest
            # P does not drive the angle away from the voltage that the grid admits.
            P_f_seen = P_f + np.maximum(1.0 * (turn * missing < 0.0), held) * missing
            Q_f_seen = Q_f + held * missing_Q
        else:
            P_f_seen, Q_f_seen = P_f, Q_f
        omega, offset, V = power_loops_about_rest(x.offset, x.V, P_f_seen, Q_f_seen, refs, gains)
        after = x._replace(
            delta=x.delta + STEP_S * (omega - grid.omega),
            V=x.V + STEP_S * V,
            offset=x.offset + STEP_S * offset,
            P=P_f,
            Q=Q_f,
            slow=x.slow + (self._slow * (omega - x.slow) if self._clamp is not None else 0.0),
        )
        if self._pull is not None:
            moved, free = self._share * gate * turn, 1.0 - gains.k_P * gains.D_p
            followed = np.clip(self._pull.g * moved, -self._most, self._most) / free
            admitted = np.maximum(np.abs(v) / rms_to_peak(1.0), np.minimum(x.V, refs.V_n))
            pulled = np.where(limited, self._share * (admitted - x.V), 0.0)
            after = after._replace(delta=after.delta + moved, offset=after.offset + followed, V=after.V + pulled)
        return after, bridge_power(self._study, v, i)

    def _gate(self, v: Any, v_g: Any, i: Any, grid: Segments) -> Any:
        """How sure the limiter is that the grid has a voltage (:eq:`gate`); 1 for others."""
        if self._pull is None:
            return 1.0
        drop, behind = v - v_g, (grid.R_g + 1j * grid.omega * grid.L_g) * i
        of = self._pull.v_gate_pk, self._pull.doubt
        return grid_voltage_gate(v.real, v.imag, drop.real, drop.imag, behind.real, behind.imag, *of)
