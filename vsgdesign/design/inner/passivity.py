"""With which other networks the inner loops cannot oscillate: the band in which the output admittance is passive, and
the worst capacitance at the PCC.

Both are scanned on some grids and operating points, at some frequencies and capacitances. They are no proof.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.inner.grids import GridBox, angle_damped_target, lattice, study_of
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.circuit_of_units import Topology
from vsgdesign.linear.operating_point.flow_of_units import UnitAsked, situation_of
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.operating_point.rest_of_units import rest_of_units
from vsgdesign.linear.stability.loops import output_admittance, passivity_index
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.runtime.closed_form import closed_form_schedule
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.power_plant import NEUTRAL, Element, PowerPlant, Unit
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
