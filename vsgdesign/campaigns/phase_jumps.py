"""The current after jumps of the grid's phase, by EMT, and what would lower it: a warning before it happens."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.design.inner.designing import design_inner_loops
from vsgdesign.design.inner.grids import GridBox, asked_of, study_of
from vsgdesign.design.inner.search import short_search
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import largest_current_after_jump
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.execution.executors import Progress, one_thread, silent
from vsgdesign.simulation.lanes.cases import ACTIVE, DISTURBANCE, LaneCases, no_events
from vsgdesign.simulation.lanes.results import DIVERGED, NO_REST, OVER_LIMIT
from vsgdesign.simulation.lanes.run import run_told
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.survival.cases import LEAD_S, demand_of
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import Study

ANGLES_DEG = (20.0, 30.0, 60.0, 90.0)
SCRS = (3.0, 15.0)
COUNT = 240
"""Jumps of each pair of angle and SCR."""
SEED = 1
_SPREAD, _X_OVER_R, _P_PU, _Q_PU = 1.1, (2.0, 20.0), 0.9, 0.3
_SILENT_S = 0.02
_SHORT_S = 0.1
"""Settling time for which a run lasts, so that it ends 0.46 s after the jump. In 12,000 jumps of five converters no
peak came later."""
_WARNED_DEG = (60.0, 90.0)
_ALLOWED = 1.1
"""Up to this share of the limit a peak needs no remedy: the current loop overshoots by some per cent."""
_USEFUL = 0.97
"""A remedy helps if it leaves less than this share of the peak."""
NEW_LOOPS = "a new design of the inner loops alone"
_ALL_VOLTAGE = 3.0
_MORE_DC, _HALF, _TWICE, _REACTANCE_PU = 1.2, 0.5, 2.0, 0.05

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class JumpPeaks:
    """The largest converter currents of the jumps by one angle at one SCR, pu of the rated peak."""

    angle_deg: float
    scr: float
    runs: int
    """Jumps that begin and end at a rest of the converter."""
    p95_pu: float | None
    """Not exceeded by 95 % of them; inf if more than 5 % diverge, None without a run."""
    largest_pu: float | None
    bound_pu: float
    """By hand (:eq:`phase-jump-bound`)."""


@dataclass(frozen=True)
class Remedy:
    """Other hardware, with inner loops designed for it, and the peak that it leaves at the pair of the warning."""

    change: str
    score: float
    """t of its inner loops; 1 and more: they keep all that is asked of them (:eq:`inner-score`)."""
    told: bool
    """Whether the peak can be told: it is None if it depends on the design too much."""
    p95_pu: float | None
    """inf if more than 5 % diverge."""
    helps: bool


@dataclass(frozen=True)
class PhaseJumps:
    """What phase jumps do to a converter with its inner loops and its current limiter."""

    limiter: str
    limit_pu: float
    V_max_pu: float
    """Largest voltage of the bridge, pu of the rated one."""
    peaks: tuple[JumpPeaks, ...]
    warned: JumpPeaks | None
    """The jump by 60°, else by 90°, whose 95 % exceed the limit by a tenth, at the worse SCR; None if there is none."""
    all_voltage_pu: float | None
    """The 95 % there with a bridge that has three times the voltage: what is left is the current loop's delay."""
    remedies: tuple[Remedy, ...]

    def document(self) -> dict[str, Any]:
        """In JSON's types; a peak that diverges is None beside a count of runs."""
        return plain(self)


class Hardware(NamedTuple):
    """What decides on the first current after a jump."""

    converter: Converter
    filter: Filter
    gains: InnerLoopGains
    omega_t: float
    limiter: str
    limiter_given: tuple[tuple[str, float], ...]
    box: GridBox
    """Grids and settling time (s) for which inner loops are designed."""
    settling_time: float

    @property
    def study(self) -> Study:
        """With the closed form of the angle-damped structure, for 1 s."""
        made = study_of(self.converter, self.filter, self.gains, self.omega_t)
        return replace(made, current_limiter=self.limiter, limiter_given=self.limiter_given)


def phase_jumps(study: Study, *, remedies: bool = False, progress: Progress | None = None) -> PhaseJumps | None:
    """Runs phase jumps of four angles at two SCRs in EMT (averaged bridge): two to three seconds of CPU time.

    The power loops are those of the closed form, told the new grid 20 ms late; the limiter is that of the last
    controller of the study that has a limit. Inner loops of other hardware are designed by a short search, and by the
    full one with ``remedies``, which takes some 25 s longer. None if no controller limits its current.
    """
    own = hardware_of(study)
    return None if own is None else _found(own, remedies, progress or silent)


def hardware_of(study: Study) -> Hardware | None:
    """With the limiter of the last controller of a study that has a limit; None without one."""
    every = [study.with_limit_of(spec) for spec in study.controllers] or [study]
    for one in reversed(every):
        if one.converter.current_limit_pu is not None:
            limiter = one.current_limiter, one.limiter_given
            asked = asked_of(study)
            box = GridBox(asked.scr, asked.x_over_r, asked.scr_basis)
            return Hardware(one.converter, one.filter, one.inner_gains, one.omega_t, *limiter, box, asked.settling_time)
    return None


def _found(own: Hardware, full: bool, tell: Progress) -> PhaseJumps:
    limit, peaks = own.converter.current_limit_pu or math.inf, _peaks(own)
    found = PhaseJumps(own.limiter, limit, _headroom(own.converter), peaks, _warned(peaks, limit), None, ())
    if found.warned is None:
        return found
    pair = [(found.warned.angle_deg, found.warned.scr)]
    free = replace(own.converter, V_dc=_ALL_VOLTAGE * own.converter.V_dc)
    remedies, others, least = [], list(remedied(own)), found.warned.p95_pu or 0.0

    def near(p95: float | None) -> bool:
        return p95 is not None and p95 <= _ALLOWED * limit

    for k, (change, other) in enumerate(others):
        tell("other hardware", k / len(others))
        gains, omega_t, score = designed_again(other._replace(converter=own.converter), full)
        p95 = below_95(peaks_of(other._replace(gains=gains, omega_t=omega_t), pair))
        # Where no inner loops keep what is asked, the peak depends on their design, unless it stays near the limit.
        told = full or score >= 1.0 or (near(p95) and near(below_95(peaks_of(other, pair))))
        helps = told and p95 is not None and p95 < _USEFUL * least
        # Other hardware has to do more than new inner loops do alone.
        least = min(least, p95 or least) if told and change == NEW_LOOPS else least
        remedies.append(Remedy(change, score, told, p95 if told else None, helps))
    tell("other hardware", 1.0)
    left = below_95(peaks_of(own._replace(converter=free), pair))
    return replace(found, all_voltage_pu=left, remedies=tuple(remedies))


@lru_cache(maxsize=16)
def _peaks(own: Hardware) -> tuple[JumpPeaks, ...]:
    pairs = [(angle, scr) for angle in ANGLES_DEG for scr in SCRS]
    peaks = []
    for (angle, scr), found in zip(pairs, np.split(peaks_of(own, pairs), len(pairs)), strict=True):
        known = found[~np.isnan(found)]
        bound = bound_pu(own.converter, own.filter, angle)
        most = float(known.max()) if len(known) else None
        peaks.append(
            JumpPeaks(
                angle_deg=angle, scr=scr, runs=len(known), p95_pu=below_95(found), largest_pu=most, bound_pu=bound
            )
        )
    return tuple(peaks)


@lru_cache(maxsize=16)
def designed_again(own: Hardware, full: bool) -> tuple[InnerLoopGains, float, float]:
    """Inner gains (SI) that are designed for hardware, with ω_t (rad/s) and their t: by the full search, or by a short
    one that begins with those that it has. The dc voltage has no part in it."""
    c, f, box, settling_time = own.converter, own.filter, own.box, own.settling_time
    if full:
        found = design_inner_loops(c, f, box, settling_time=settling_time)
        return found.gains, found.omega_t, found.t
    with one_thread():
        return short_search(c, f, box, (own.gains, own.omega_t), settling_time=settling_time)


def _warned(peaks: Sequence[JumpPeaks], limit: float) -> JumpPeaks | None:
    for angle in _WARNED_DEG:
        over = [one for one in peaks if one.angle_deg == angle and (one.p95_pu or 0.0) > _ALLOWED * limit]
        if over:
            return max(over, key=lambda one: one.p95_pu or 0.0)
    return None


def remedied(own: Hardware) -> Iterator[tuple[str, Hardware]]:
    """Other hardware in words, with inner loops that are scaled to it as the filter is; first the same hardware, whose
    inner loops may be designed anew."""
    g, f, c = own.gains, own.filter, own.converter
    yield NEW_LOOPS, own
    voltage = g._replace(K_pv=_HALF * g.K_pv, K_iv=_HALF * g.K_iv)
    current = g._replace(K_pc=_TWICE * g.K_pc, K_ic=_TWICE * g.K_ic)
    yield "half the capacitor", own._replace(filter=replace(f, C=_HALF * f.C), gains=voltage)
    yield f"{round(100 * (_MORE_DC - 1))} % more dc voltage", own._replace(converter=replace(c, V_dc=_MORE_DC * c.V_dc))
    more = replace(f, L_1=_TWICE * f.L_1, R_1=_TWICE * f.R_1)
    yield "twice the converter-side inductance", own._replace(filter=more, gains=current)
    outer = replace(f, L_2=f.L_2 + _REACTANCE_PU * c.Z_base / c.omega_n)
    yield f"{_REACTANCE_PU:g} pu more of grid-side reactance", own._replace(filter=outer)


def bound_pu(converter: Converter, filter_: Filter, angle_deg: float) -> float:
    """The bound by hand of a study's converter (:eq:`phase-jump-bound`), pu; inf without a limit."""
    c = converter
    limit = math.inf if c.current_limit_pu is None else c.current_limit_pu
    turn = c.omega_n * (c.delay_samples + 1) * c.T_s
    X_1 = c.omega_n * filter_.L_1 / c.Z_base
    return float(largest_current_after_jump(limit, math.radians(angle_deg), turn, X_1))


def _headroom(c: Converter) -> float:
    return float(c.v_max_pk / rms_to_peak(c.V_rated_rms))


def peaks_of(own: Hardware, pairs: list[tuple[float, float]], each: int = COUNT, seed: int = SEED) -> Array:
    """The largest current of each jump, pair (angle in °, SCR) after pair, pu; NaN without a rest, inf if it diverges.

    ``each`` jumps of a pair are drawn evenly with ``seed``.
    """
    study, c = own.study, own.converter
    study = study.with_limit_of(study.controllers[0])
    even = qmc.LatinHypercube(4, seed=seed).random(each)
    signs = np.where(np.arange(each) % 2, 1.0, -1.0)
    count = each * len(pairs)
    events = no_events(count)
    events.t_s[:] = LEAD_S
    events.phase_jump[:, 0] = np.concatenate([math.radians(angle) * signs for angle, _ in pairs])
    least, most = _X_OVER_R
    grids = [
        Place(scr * _SPREAD ** (2.0 * a - 1.0), least * (most / least) ** b, "impedance").grid(c)
        for _, scr in pairs
        for a, b, *_ in even
    ]
    P, Q = ((2.0 * even[:, k] - 1.0) * share * c.S_rated for k, share in ((2, _P_PU), (3, _Q_PU)))
    none = np.zeros(count)
    cases = LaneCases(
        R_g=np.array([grid.R_g for grid in grids]),
        L_g=np.array([grid.L_g for grid in grids]),
        V_g_rms=np.full(count, c.V_rated_rms),
        omega_g=np.full(count, c.omega_n),
        P_ref=np.tile(P, len(pairs)),
        Q_ref=np.tile(Q, len(pairs)),
        events=events,
        error_R=none,
        error_X=none,
        silent_s=np.full(count, _SILENT_S),
        cleared_s=np.full(count, LEAD_S),
        kind=np.full(count, DISTURBANCE, dtype=np.int8),
        signal=np.full(count, ACTIVE, dtype=np.int8),
    )
    told = telling(study, study.controllers[0], NOTHING, cases)
    found = run_told(study, told, cases, demand_of(c, _SHORT_S), strict=False)
    largest = np.fmax(found.first_peak_pu, found.peak_pu)
    largest[np.isin(found.status, (NO_REST, OVER_LIMIT))] = np.nan
    largest[found.status == DIVERGED] = np.inf
    return largest


def below_95(found: Array) -> float | None:
    """The smallest current that 95 % of the jumps do not exceed."""
    known = np.sort(found[~np.isnan(found)])
    return float(known[math.ceil(0.95 * len(known)) - 1]) if len(known) else None
