"""With what else the inner loops cannot oscillate: with other networks, from the band in which the output admittance is
passive, and the worst capacitance at the PCC; and between equal units at one node, each on its R_2 and L_2 alone
(:eq:`plant-split`).

Band and capacitance are scanned on some grids and operating points, at some frequencies and capacitances. They are no
proof.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.inner.frozen import Plants, law_matrix, modes, plants
from vsgdesign.design.inner.grids import (
    CHECKED,
    POWERS_PU,
    GridBox,
    GridPoint,
    angle_damped_target,
    axis,
    closed_form_cells,
    lattice,
    sampling_ratio,
    study_of,
)
from vsgdesign.design.inner.promises import DAMPING, PromiseReached, controller_settings
from vsgdesign.design.inner.search import closed_form_starts
from vsgdesign.equations.controller import ControllerSettings
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.circuit_of_units import Topology
from vsgdesign.linear.operating_point.flow_of_units import UnitAsked, situation_of
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order, steady_cells
from vsgdesign.linear.operating_point.rest_of_units import rest_of_units
from vsgdesign.linear.stability.loops import output_admittance, passivity_index
from vsgdesign.linear.stability.modes_of_units import differential_modes
from vsgdesign.metrics.modes import least_damping, to_continuous
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.power_plant import NEUTRAL, Element, PowerPlant, Unit
from vsgdesign.study.parameters.specification import decaying_time
from vsgdesign.study.parameters.study import Study

SCANNED = 0.35
"""End of the scan, share of the sampling frequency: above it, the components at the other frequencies of a sampled
bridge, which the admittance leaves out, are as large as those that it has."""

LEAST_SERIES_PU = 0.02
"""Series reactance between the capacitor and whatever else has a capacitance there, pu, below which a warning is
given."""

_POINTS, _LOWEST_HZ = 200, 1.0
_CHECKED = (3, 2)
_POWERS_PU = (0.5, 1.0)
_CAPACITANCES_PU = tuple(np.geomspace(3e-4, 0.5, 9).tolist())
_SMALL_SERIES_PU = (0.001, 0.005, LEAST_SERIES_PU)
"""Of a connection, where the filter has less: two capacitors without any reactance between them are one, which no
real connection makes of them."""
_FAST = 2.0 * math.pi * 100.0
"""Modes above this, rad/s, are those that a capacitance makes."""


@dataclass(frozen=True)
class WorstCapacitance:
    """The capacitance at the PCC with the fastest growing, or slowest decaying, oscillation above 100 Hz."""

    C_pu: float
    series_pu: float
    """Reactance between the filter's capacitor and it."""
    scr: float
    x_over_r: float
    real: float
    """1/s; positive: it grows."""
    hertz: float
    """As the samples show it: above half of the sampling frequency it is that much lower."""


@dataclass(frozen=True)
class PassiveBand:
    """Where the output admittance is passive at all scanned operating points."""

    from_hz: float | None
    """In the frame of the source; None: it is not passive at the end of the scan."""
    to_hz: float
    """End of the scan."""
    scr: float
    x_over_r: float
    P_pu: float
    """Where the band begins at the highest frequency."""
    cells: int
    """Grids and powers that were scanned."""
    series_pu: float
    """Reactance of the filter between its capacitor and the PCC, pu."""
    worst: WorstCapacitance | None
    """None where no operating point exists."""

    @property
    def warns(self) -> bool:
        """Whether a capacitance may lie too near to that of the filter."""
        return self.series_pu < LEAST_SERIES_PU


def passive_band(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox,
    *,
    settling_time: float = 1.0,
) -> PassiveBand:
    """Scans the output admittance (:eq:`passivity`) on six grids of the box at half and full power, and the modes with
    capacitances at the PCC on the strongest and the weakest one."""
    target = angle_damped_target(settling_time, converter.omega_n)
    study = study_of(converter, filter_, gains, omega_t, box, target=target)
    cells, where = [], []
    for scr, x_over_r in lattice(box, *_CHECKED):
        grid = Place(scr, x_over_r, box.basis).grid(converter)
        for share in _POWERS_PU:
            own = _power_gains(study, grid, share * converter.S_rated)
            if own is not None:
                cells.append(Cell(grid, own, share * converter.S_rated, 0.0))
                where.append((scr, x_over_r, share))
    model = linearise_full_order(study, cells)
    end = SCANNED / converter.T_s
    hertz = np.geomspace(_LOWEST_HZ, end, _POINTS)
    begins, worst = _LOWEST_HZ, (math.nan, math.nan, math.nan)
    for k, place in enumerate(where[i] for i in model.index):
        first = _passive_from(passivity_index(output_admittance(model, k, 2.0 * math.pi * hertz)), hertz)
        if not first < begins:
            begins, worst = first, place
    places = [Place(scr, box.x_over_r[1], box.basis) for scr in box.scr]
    return PassiveBand(
        from_hz=begins if math.isfinite(begins) and len(model.index) else None,
        to_hz=end,
        scr=worst[0],
        x_over_r=worst[1],
        P_pu=worst[2],
        cells=len(model.index),
        series_pu=converter.omega_n * filter_.L_2 / converter.Z_base,
        worst=_worst_capacitance(study, places),
    )


def _passive_from(index: NDArray[np.float64], hertz: NDArray[np.float64]) -> float:
    """The frequency from which on the index is never negative; infinite where it is negative at the end."""
    negative = np.flatnonzero(index < 0.0)
    if len(negative) == 0:
        return float(hertz[0])
    return float(hertz[negative[-1] + 1]) if negative[-1] + 1 < len(hertz) else math.inf


def _power_gains(study: Study, grid: Grid, P: float) -> PowerLoopGains | None:
    """The closed form for a grid; None where there is none."""
    found = closed_form_schedule(study, study.target, P, 0.0).gains_over(np.array([grid.R_g]), np.array([grid.L_g]))
    values = PowerLoopGains(*(float(np.ravel(value)[0]) for value in found))
    return values if all(map(math.isfinite, values)) else None


def _worst_capacitance(study: Study, places: Sequence[Place]) -> WorstCapacitance | None:
    """Over capacitances at the PCC, on some grids at half of the rated power."""
    c, f, found = study.converter, study.filter, list[WorstCapacitance]()
    own_pu = c.omega_n * f.L_2 / c.Z_base
    series = (own_pu,) if own_pu >= LEAST_SERIES_PU else (x for x in _SMALL_SERIES_PU if x > own_pu)
    for series_pu, place in itertools.product(series, places):
        with_series = replace(study, filter=replace(f, L_2=series_pu * c.Z_base / c.omega_n))
        grid = place.grid(c)
        gains = _power_gains(with_series, grid, 0.5 * c.S_rated)
        for C_pu in _CAPACITANCES_PU if gains is not None else ():
            s = None if gains is None else _oscillation(with_series, grid, gains, C_pu)
            if s is not None:
                hertz = abs(s.imag) / (2.0 * math.pi)
                found.append(WorstCapacitance(C_pu, series_pu, place.scr, place.x_over_r, s.real, hertz))
    return max(found, key=lambda one: one.real, default=None)


def _oscillation(study: Study, grid: Grid, gains: PowerLoopGains, C_pu: float) -> complex | None:
    """The fastest growing, or slowest decaying, oscillation above 100 Hz, 1/s, with a capacitance at the PCC; None
    where there is no operating point."""
    c, P = study.converter, 0.5 * study.converter.S_rated
    beside = Element("C", "C", "pcc", NEUTRAL, C=C_pu / (c.omega_n * c.Z_base))
    unit = Unit(name="unit", node="pcc", P_ref=P, Q_ref=0.0)
    plant = PowerPlant(nodes=("pcc",), elements=(beside,), sources=(), units=(unit,), pcc="pcc")
    asked = UnitAsked(study, gains, c.references(P, 0.0), grid)
    topology = Topology(grid, frozenset())
    try:
        rest = rest_of_units(situation_of(replace(study, plant=plant), topology, (asked,), c.omega_n, c.V_rated_rms))
    except InfeasibleStudyError:
        return None
    s = to_continuous(np.linalg.eigvals(rest.A), rest.model.clock.period)
    return complex(max(s[np.abs(s.imag) > _FAST], key=lambda one: one.real))


Array = NDArray[np.float64]

FASTER = 0.5
"""The closed form that inner loops are judged with settles within so much of the time after which a mode of the asked
decay leaves 2 % (:eq:`inner-apart`). With inner loops that take nothing away its
units decay with 1.4 times what is asked. A table has gains that are as high where the estimate is wrong, so that less
would leave it no room."""

SEARCHED = slice(None, None, 2)
"""Of the lattice of a check: where a search begins."""


@dataclass(frozen=True, kw_only=True)
class ApartBench:
    """What inner loops are judged on between units: a filter alone, and closed-form power loops at N rests.

    Inner gains change neither these power loops nor P, Q and V at rest (:eq:`operating-point`).
    """

    study: Study
    """With any inner gains."""
    settings: ControllerSettings
    still: Plants
    """The circuit of the filter alone."""
    decay: float
    """That is asked for, 1/s."""
    where: tuple[GridPoint, ...]
    """SCR and X/R of each rest."""
    gains: PowerLoopGains
    """Of the closed form, (N,) each."""
    P: Array
    Q: Array
    V_rms: Array
    searched: NDArray[np.intp]
    """The rests that a search looks at."""

    def damping(self, gains: InnerLoopGains, omega_t: Array) -> Array:
        """The least damping ratio (M,) of M gain sets (arrays, SI) with the power loops held still."""
        return least_damping(modes(law_matrix(gains, omega_t, self.settings), self.still))[:, 0]

    def decays(self, gains: InnerLoopGains, omega_t: float, at: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The decay (N,) of the units against each other at rests, 1/s; −∞ where a unit alone has none."""
        study, own = (
            replace(self.study, inner_gains=gains, omega_t=omega_t),
            PowerLoopGains(*(g[at] for g in self.gains)),
        )
        s = differential_modes(study, own, self.P[at], self.Q[at], self.V_rms[at], study.converter.omega_n)
        return -np.nan_to_num(s.real, nan=math.inf)

    def scores(self, gains: InnerLoopGains, omega_t: Array, of: Array) -> Array:
        """What this promise leaves of the scores ``of`` (M,) of M gain sets (arrays, SI): where it is kept, all.

        A set that is unstable by itself keeps its score, and so does one that is not among the better half anyhow.
        """
        found, seen = of.copy(), []
        damped = self.damping(gains, omega_t) / DAMPING
        for k in np.argsort(-of, kind="stable").tolist():
            if not of[k] > 0.0 or (2 * len(seen) >= len(of) and of[k] <= np.median(seen)):
                break
            own = InnerLoopGains(*(float(value[k]) for value in gains))
            if damped[k] > 0.0 and len(self.P):
                decays = self.decays(own, float(omega_t[k]), self.searched)
                damped[k] = min(damped[k], float(decays.min()) / self.decay)
            found[k] = of[k] if damped[k] >= 1.0 else min(of[k], damped[k])
            seen.append(found[k])
        return found

    def joined(self, gains: InnerLoopGains, omega_t: float) -> ApartBench:
        """The bench of a search that looks at the worst rest of a gain set (SI), too."""
        if not len(self.P):
            return self
        return replace(self, searched=np.union1d(self.searched, [np.argmin(self.decays(gains, omega_t))]))


def apart_bench(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox,
    *,
    decay: float,
) -> ApartBench:
    """The bench of the grids of a box that carry the powers of a check.

    R_2 and L_2 of ``filter_`` contain the transformer of a unit. ``gains`` (SI) and ``omega_t`` (rad/s): any with which
    there are rests. ``decay`` (1/s) is asked for, and decides the closed form (:data:`FASTER`).
    """
    f, settings = filter_, controller_settings(converter, filter_)
    alone = FilterGrid(f.L_1, f.R_1, f.C, f.R_c, f.L_2, f.R_2, 0.0, 0.0)
    target = angle_damped_target(FASTER * decaying_time(decay), converter.omega_n)
    study = study_of(converter, filter_, gains, omega_t, box, target=target)
    cells, where = closed_form_cells(study, target, lattice(box, *CHECKED), box.basis, POWERS_PU)
    rests = steady_cells(study, cells)
    known = [k for k, fault in enumerate(rests.faults) if fault is None]
    coarse = {(a, b) for a in axis(box.scr, CHECKED[0])[SEARCHED] for b in axis(box.x_over_r, CHECKED[1])[SEARCHED]}
    P, Q, V_rms = np.empty((3, 0))
    if rests.states is not None:
        P, Q, V_rms = (np.asarray(one)[known] for one in (rests.states.P, rests.states.Q, rests.states.V))
    return ApartBench(
        study=study,
        settings=settings,
        still=plants([alone], settings, converter.delay_samples, converter.omega_n),
        decay=decay,
        where=tuple(where[k][:2] for k in known),
        gains=PowerLoopGains(*np.reshape([cells[k].gains for k in known], (len(known), -1)).T),
        P=P,
        Q=Q,
        V_rms=V_rms,
        searched=np.array([k for k, one in enumerate(known) if where[one][:2] in coarse], dtype=np.intp),
    )


_STARTS = (0.2, 0.4), (0.3, 0.24)
"""X_t over Z_b and ω_t over ω_n of starts; the second is for slow samplers."""


def searched_apart(
    converter: Converter, filter_: Filter, box: GridBox, decay: float
) -> tuple[ApartBench | None, list[tuple[InnerLoopGains, float]]]:
    """The bench of a search, and starts (gains in SI, ω_t in rad/s) with the transient reactances that are worth trying
    between units; nothing where no ``decay`` (1/s) is asked for."""
    if not decay > 0.0:
        return None, []
    first, omega_t = closed_form_starts(converter, filter_, sampling_ratio(converter, filter_, box))[0]
    bench = apart_bench(converter, filter_, first, omega_t, box, decay=decay)
    Z_base, omega_n = converter.Z_base, converter.omega_n
    return bench, [(first._replace(X_t=X_t * Z_base), corner * omega_n) for X_t, corner in _STARTS]


def check_apart(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox,
    *,
    decay: float,
) -> tuple[PromiseReached, PromiseReached]:
    """What inner loops keep between equal units: the damping ratio with the power loops held still, which no grid has a
    say in, and the slowest decay, of which ``decay`` (1/s) is asked, with closed-form power loops (:data:`FASTER`) for
    the grids and powers of :func:`vsgdesign.design.inner.check_full_order`."""
    bench = apart_bench(converter, filter_, gains, omega_t, box, decay=decay)
    damping = float(bench.damping(InnerLoopGains(*(np.array([one]) for one in gains)), np.array([omega_t]))[0])
    reached, scr, x_over_r = math.nan, math.nan, math.nan
    if len(bench.P):
        decays = bench.decays(gains, omega_t)
        worst = int(np.argmin(decays))
        reached, (scr, x_over_r) = float(decays[worst]), bench.where[worst]
    return (
        PromiseReached("damping_apart", damping, DAMPING, damping / DAMPING, math.nan, math.nan),
        PromiseReached("decay_apart", reached, bench.decay, reached / bench.decay, scr, x_over_r),
    )
