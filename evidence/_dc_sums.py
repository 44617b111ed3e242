"""A sum by hand of what events push into a dc link whose source is full, or draw from one that is empty.

It is a guard beside the simulation, which tells what was beyond a source: what is told there should be refused here as
well. A full battery takes nothing, an array takes nothing, and an empty source gives nothing. What an event then pushes
into the link has to find room in the capacitor. The sum has the grid's current, and of the controller all but the
current loop, in steps h of 1 ms. With R and L from the capacitor of the filter to the source of the grid, whose voltage
is v_0, and with voltages that are constant within a step,

    i_g = E i_g⁻ + (1 − E) (v − v_0)/(R + jωL),  E = exp(−(R/L + jω) h),  so that v = v_g + Z i_g
    with Z = (R + jωL)/(1 − E) and v_g = v_0 − Z E i_g⁻

in the frame of the controller. Its current follows from what the voltage loop asks for,

    w = K_pv (√2 V − v − Z_t (i_g − i_f)) + ξ_v + K_ff i_g + jω_0 C_f v = w_0 + A i_s,  i_s = μ w = μ w_0/(1 − μA)

where μ is 1 within the limit of the current, and otherwise between 0 and 1 so that |i_s| = I_max. A case is refused
where max v² > V_high² − 2 W_L/C, or where v leaves V_low in the same way. W_L = ¾ (L_1 + L_2 + L_g) I_max² is what the
inductors store at the current limit: the sum has no oscillation of the filter.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.codegen.records import numbers_of, record_like
from vsgdesign.equations.controller import ControllerState, power_stage
from vsgdesign.equations.dc_control import clamp_of_sample
from vsgdesign.equations.dc_link import BridgePower, DcState, link_step
from vsgdesign.equations.frames import SPACE_VECTOR_POWER, instantaneous_power, rms_to_peak
from vsgdesign.equations.inner_loops import transient_impedance, voltage_integrators, voltage_loop
from vsgdesign.equations.limiter_interface import GridEstimate, LimiterView
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.dc_rest import bridge_power, power_of_plant
from vsgdesign.linear.operating_point.many import ManyStates
from vsgdesign.simulation.lanes.cases import LaneCases, segments_of
from vsgdesign.simulation.lanes.rests import rests_of
from vsgdesign.simulation.lanes.results import LaneResults
from vsgdesign.simulation.lanes.telling import Telling, telling
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.simulation.timeline import Segments
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

STEP_S = 1e-3
"""Of the sum, s."""

AFTER = 1.0
"""Settling times after the last change for which the sum goes on."""


class Swing(NamedTuple):
    """What moves, (N,): the controller, whose angle is that to the source, the frequency of the clamp, rad/s, by how
    much it changes P_ref, W, the link, and the current of the grid in the controller's frame, A peak."""

    state: ControllerState
    slow: Array
    cut: Any
    link: DcState
    i_g: Complex


def refused(study: Study, spec: ControllerSpec, cases: LaneCases) -> Mask:
    """The cases, (N,), whose events push more energy into the link, or draw more from it, than the capacitor can take
    or give, by this sum. The source is full or empty. The controller is told its grid."""
    own, cases = study.with_limit_of(spec), cases.in_study(study)
    none = np.zeros(len(cases), dtype=bool)
    if own.dc is None or len(cases) == 0:
        return none
    demand, segments = demand_of(own.converter, settling_time_of(spec, NOTHING)), segments_of(cases)
    told = telling(own, spec, NOTHING, cases)
    rests, first = rests_of(own, cases, segments, told, demand, LaneResults.of_none(len(cases)))
    with np.errstate(all="ignore"):
        links = links_at_rest(own, rests.start)
        if links is None:
            return none
        start = rests.start
        i_g = (start.plant[4] + 1j * start.plant[5]) * np.exp(-1j * start.controller.theta)
        omega = np.array(cases.omega_g, dtype=float)
        begin = Swing(start.controller._replace(theta=rests.delta_start), omega, 0.0, links, i_g)
        apart = 2.0 * stored_in_coils(own, cases) / own.dc.C  # V²
        down, up = links.v**2 - own.dc.V_low**2, own.dc.V_high**2 - links.v**2
        present, loops = _Present(own, cases, told, first), PhasorLoops(own)
        lowest, highest = _swung(own, cases, segments, begin, present, loops, demand.settling_time)
        fallen, risen = links.v**2 - lowest**2, highest**2 - links.v**2
        # Where an event moves less than that, the link stays where it rests, however near to a limit that is.
        low = fallen + np.where(fallen > apart, apart, 0.0) > down
        high = risen + np.where(risen > apart, apart, 0.0) > up
    return low | high


def stored_in_coils(study: Study, cases: LaneCases) -> Array:
    """What the inductors of filter and grid store at the current limit, J (N,): the sum has no oscillation of the
    filter, which may move this energy into the link or out of it."""
    f, most = study.filter, study.controller_settings().i_max_pk
    L_g = np.fmax(cases.L_g, np.nanmax(np.where(np.isfinite(cases.events.L_g), cases.events.L_g, 0.0), axis=1))
    within = min(most, 2.0 * study.converter.I_rated_pk)  # without a limit, twice the rated current
    return np.asarray(0.5 * SPACE_VECTOR_POWER * (f.L_1 + f.L_2 + L_g) * within**2)


def _swung(
    study: Study,
    cases: LaneCases,
    segments: Segments,
    x: Swing,
    present: _Present,
    loops: PhasorLoops,
    settling_time: float,
) -> tuple[Array, Array]:
    """Least and largest voltage of the links up to the end of the last case, V. The clock of each case is such that its
    first event falls on a step; others act at the nearest one."""
    rows, nominal = np.arange(len(cases)), study.converter.references()
    at, first_s = np.zeros(len(cases), dtype=np.intp), _first_event_s(cases)
    late_s = np.where(np.isfinite(first_s), np.ceil(first_s / STEP_S) * STEP_S - first_s, 0.0)
    lowest = highest = np.asarray(x.link.v)
    last_s = float(np.max(cases.cleared_s)) + AFTER * settling_time
    for n in range(math.ceil(last_s / STEP_S)):
        t_s = n * STEP_S - late_s
        now = np.maximum((segments.t_s <= (t_s + 0.5 * STEP_S)[:, None]).sum(axis=1) - 1, 0)
        if np.any(now != at):
            before = segments.at_column(rows, at).at(segments.t_s[rows, now])
            jump = np.where(now != at, segments.phase[rows, now] - before.phase, 0.0)
            x, at = x._replace(state=x.state._replace(theta=x.state.theta - jump)), now
        grid, refs = segments.at_column(rows, at).at(t_s), _references(cases, nominal, t_s)
        x = x._replace(state=present.move_to(n * STEP_S, x.state, refs._replace(P_ref=refs.P_ref + x.cut)))
        x = loops.step(x, grid, refs, present.gains, present.estimate)
        # A link that has collapsed has no numbers any more, and those of before count.
        lowest, highest = np.fmin(lowest, x.link.v), np.fmax(highest, x.link.v)
    return lowest, highest


def _first_event_s(cases: LaneCases) -> Array:
    """When the first event of each case begins, s (N,); inf without one."""
    found: Array = np.nanmin(np.where(np.isfinite(cases.events.t_s), cases.events.t_s, np.inf), axis=1)
    return found


class _Present:
    """The gains of the cases over time, and the grids that they are for."""

    def __init__(self, study: Study, cases: LaneCases, told: Telling, first: PowerLoopGains) -> None:
        shape = len(PowerLoopGains._fields), len(cases)
        self.gains, self._at, self._T_s = (
            PowerLoopGains(*np.broadcast_to(np.stack(first), shape)),
            0,
            study.converter.T_s,
        )
        self._told, self._changes, self.estimate = told, told.changes, GridEstimate(*told.estimate())

    def move_to(self, t_s: float, state: ControllerState, refs: References) -> ControllerState:
        """Gains and grids of this instant; the state with the transfer to them (:eq:`gain-transfer`)."""
        before, sample, changes = self._at, round(t_s / self._T_s), self._changes
        self._at, old = sample, self.gains
        now = np.flatnonzero((changes.sample > before) & (changes.sample <= sample))
        if now.size:
            lane, (R_g, L_g) = changes.lane[now], (np.array(one) for one in self.estimate)
            R_g[lane], L_g[lane] = changes.R_g[now], changes.L_g[now]
            columns = [np.array(one) for one in old]
            for column, values in zip(columns, changes.gains, strict=True):
                column[lane] = values[now]
            self.gains, self.estimate = PowerLoopGains(*columns), GridEstimate(R_g, L_g)
        every = self._told.update_samples
        if every and sample // every > before // every:
            answer = self._told.update(sample // every * every, state.P_f, state.Q_f, state.V)
            if answer is not None:
                self.gains, self.estimate = answer, GridEstimate(*self._told.estimate())
        if self.gains is old:
            return state
        return state._replace(omega_i=gain_transfer(state.omega_i, refs, old, self.gains))


def links_at_rest(study: Study, start: ManyStates) -> DcState | None:
    """The links before the first event: arrays (N,), NaN where there is no rest; None where no case has one."""
    rows: dict[int, list[float]] = {}
    like = None
    for k, p in enumerate(np.asarray(power_of_plant(study, start.plant)).tolist()):
        if start.fault[k] == 0 and math.isfinite(p) and study.dc is not None:
            try:
                like = study.dc.at_rest(p, study.converter, study.filter)
            except InfeasibleStudyError:
                continue
            rows[k] = numbers_of(like)
    if like is None:
        return None
    table = np.full((len(numbers_of(like)), len(start)), np.nan)
    for k, numbers in rows.items():
        table[:, k] = numbers
    columns: Any = iter(table)
    found: DcState = record_like(like, columns)
    return found


def _references(cases: LaneCases, nominal: References, t_s: Array) -> References:
    """The set points at an instant of each case, (N,)."""
    found = {"P_ref": cases.P_ref, "Q_ref": cases.Q_ref, "omega_0": nominal.omega_0, "V_n": nominal.V_n}
    for k in range(cases.events.count):
        for name in References._fields:
            given = getattr(cases.events, name)[:, k]
            if np.isfinite(given).any():
                found[name] = np.where(np.isfinite(given) & (cases.events.t_s[:, k] <= t_s), given, found[name])
    return References(**found)


class PhasorLoops:
    """The controller without its current loop, the grid's current, and the link, in steps of STEP_S."""

    def __init__(self, study: Study) -> None:
        c = study.converter
        c = replace(c, f_sw=1.0 / (STEP_S * c.samples_per_carrier))
        study = replace(study, converter=c)
        if study.dc is None:
            raise ValueError("the dc link is ideal.")
        self._study, self._law = study, study.limiter.law
        self._settings, self._inner = study.controller_settings(), study.inner_gains
        self._link, self._source = study.dc.settings(c, study.filter), study.dc.kind.law
        self._clamp = study.dc.clamp(c, study.filter) if study.dc.clamps else None

    def step(self, x: Swing, grid: Segments, refs: References, gains: PowerLoopGains, estimate: GridEstimate) -> Swing:
        """What follows after STEP_S."""
        state, s, inner = x.state, self._settings, self._inner
        slow, cut = x.slow, 0.0
        if self._clamp is not None:
            limits = self._source.can_give(x.link.memory, self._clamp.hold, self._link.source)
            of = self._clamp.own, self._clamp.smoothing
            P_ref, slow, cut = clamp_of_sample(
                slow, state.omega_i, state.V, state.P_f, state.Q_f, refs, gains, limits, *of
            )
            refs = refs._replace(P_ref=P_ref)
        v_g = rms_to_peak(grid.V_g_rms) * np.exp(-1j * state.theta)
        circuit = self._circuit(grid, v_g, x.i_g)
        v, i_g = circuit.at(self._held(state, circuit))
        drop_d, drop_q, i_f_d, i_f_q = transient_impedance(
            i_g.real, i_g.imag, state.i_f_d, state.i_f_q, inner, s.smoothing_t
        )
        e_d, e_q, i_want_d, i_want_q = voltage_loop(
            rms_to_peak(state.V), drop_d, drop_q, v.real, v.imag, i_g.real, i_g.imag, state.xi_vd, state.xi_vq, inner,
            s.omega_C,
        )  # fmt: skip
        i_s = i_g + 1j * circuit.omega_C * v
        P, Q = instantaneous_power(v.real, v.imag, i_g.real, i_g.imag)
        view = LimiterView(
            v.real, v.imag, i_s.real, i_s.imag, i_g.real, i_g.imag, e_d, e_q, i_want_d, i_want_q,
            state.V, state.omega_i, P, Q, inner.K_pv, 0.0,
        )  # fmt: skip
        sample = self._law.limit(state.limiter, view, estimate, refs, gains, s)
        xi_vd, xi_vq = voltage_integrators(
            sample.e_d,
            sample.e_q,
            sample.i_ref_d - i_want_d,
            sample.i_ref_q - i_want_q,
            state.xi_vd,
            state.xi_vq,
            inner,
            s.T_s,
        )
        omega, P_f, Q_f, wanted = power_stage(state, sample.P, sample.Q, refs, gains, s)
        steps, remembered = self._law.move(state.limiter, sample, view, omega, wanted, s)
        after = state._replace(
            theta=state.theta + (steps.theta - s.T_s * grid.omega),
            omega_i=state.omega_i + steps.omega_i,
            V=state.V + steps.V,
            P_f=P_f,
            Q_f=Q_f,
            xi_vd=xi_vd,
            xi_vq=xi_vq,
            i_f_d=i_f_d,
            i_f_q=i_f_q,
            limiter=remembered,
        )
        i_s = sample.i_ref_d + 1j * sample.i_ref_q
        v, i_g = circuit.at(i_s)
        p = bridge_power(self._study, v, i_s)
        link = link_step(x.link, BridgePower(p, p, p, p), x.link.needs, self._link, self._source)
        return Swing(after, slow, cut, link, i_g)

    def _circuit(self, grid: Segments, v_g: Complex, i_g: Complex) -> _Circuit:
        """What the current has at the end of a step whose voltages are constant."""
        f = self._study.filter
        R, L = grid.R_g + f.R_2, grid.L_g + f.L_2
        left = np.exp(-(R / L + 1j * grid.omega) * self._settings.T_s)
        Z = (R + 1j * grid.omega * L) / (1.0 - left)
        return _Circuit(Z, v_g - left * Z * i_g, grid.omega * f.C)

    def _held(self, state: ControllerState, circuit: _Circuit) -> Complex:
        """The converter current that the voltage loop asks for once it flows, within its limit, A peak
        (:eq:`voltage-loop`, :eq:`transient-impedance`)."""
        inner, s = self._inner, self._settings
        Z_t = inner.R_t + 1j * inner.X_t
        own = inner.K_ff - inner.K_pv * Z_t
        known = inner.K_pv * (rms_to_peak(state.V) + Z_t * (state.i_f_d + 1j * state.i_f_q))
        known = known + state.xi_vd + 1j * state.xi_vq
        per_v = 1j * s.omega_C - inner.K_pv - own * 1j * circuit.omega_C
        v_0, v_1 = circuit.at(0.0)[0], circuit.per_current
        asked, fed_back = known + per_v * v_0, own + per_v * v_1
        return limited_current(asked, fed_back, s.i_max_pk)


def limited_current(asked: Complex, fed_back: Complex, most: float) -> Complex:
    """The current i = min(1, most/|w|) w of a loop that asks for w = ``asked`` + ``fed_back`` i, A (N,)."""
    free = asked / (1.0 - fed_back)
    if not math.isfinite(most):
        return free
    turned = most * fed_back.real
    root = np.sqrt(np.maximum(turned**2 + np.abs(asked) ** 2 - (most * np.abs(fed_back)) ** 2, 0.0))
    share = np.where(np.abs(free) > most, most / np.where(turned + root > 0.0, turned + root, most), 1.0)
    return np.asarray(share * asked / (1.0 - share * fed_back), dtype=complex)


class _Circuit(NamedTuple):
    """Grid and filter behind the converter's current: impedance to the source (Ω), its voltage (V peak), and ωC (S)."""

    Z: Complex
    v_g: Complex
    omega_C: Array

    @property
    def per_current(self) -> Complex:
        """Voltage at the capacitor per converter current, Ω."""
        return self.Z / (1.0 + 1j * self.omega_C * self.Z)

    def at(self, i_s: Any) -> tuple[Complex, Complex]:
        """Voltage at the capacitor and grid current for a converter current: V and A, peak."""
        v = (self.v_g + self.Z * i_s) / (1.0 + 1j * self.omega_C * self.Z)
        return v, i_s - 1j * self.omega_C * v
