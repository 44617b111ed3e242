"""The box of grids that inner loops are designed for, and the circuits on a lattice over it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsgdesign.equations.grid import SCR_BASES, FilterGrid
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.placing import settling_margin
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import ANGLE_DAMPED
from vsgdesign.errors import Fault, StudyError
from vsgdesign.linear.operating_point.full_order import Cell
from vsgdesign.linear.operating_point.plant import state_matrices
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.grid import GridSource, Place
from vsgdesign.study.parameters.inner_loops import Reading, request_of
from vsgdesign.study.parameters.specification import Gates, StabilitySpec
from vsgdesign.study.parameters.study import (
    ClosedFormTarget,
    ControllerSpec,
    InnerLoopRequest,
    SimulationSpec,
    Study,
)

GridPoint = tuple[float, float]
"""SCR and X/R."""


@dataclass(frozen=True)
class GridBox:
    """Least and largest SCR and X/R of the grids to serve, and what the SCR is taken on.

    Raises StudyError with every fault: a limit that is not a positive finite number, limits in the wrong order,
    an unknown basis.
    """

    scr: tuple[float, float] = (1.3, 20.0)
    x_over_r: tuple[float, float] = (0.3, 20.0)
    basis: str = "impedance"
    """``impedance`` or ``reactance`` (:eq:`scr`)."""

    def __post_init__(self) -> None:
        faults = []
        for name in ("scr", "x_over_r"):
            low, high = getattr(self, name)
            if not all(math.isfinite(value) and value > 0.0 for value in (low, high)):
                faults.append(Fault(name, f"({low}, {high})", "both limits must be positive numbers"))
            elif low > high:
                faults.append(Fault(name, f"({low}, {high})", "the least comes first", "Exchange the two limits."))
        if self.basis not in SCR_BASES:
            faults.append(Fault("basis", f'"{self.basis}"', f"must be one of {', '.join(SCR_BASES)}"))
        if faults:
            raise StudyError("box of grids", faults)


def asked_of(study: Study) -> InnerLoopRequest:
    """The grids and the settling time for which inner loops are designed, or would be where gains are given."""
    return study.inner_request or request_of(
        Reading(None, math.nan), study.converter, study.filter, study.scr_basis, study.target, study.specification
    )


def axis(limits: tuple[float, float], count: int) -> tuple[float, ...]:
    """``count`` values between two limits, evenly in the logarithm, both limits exact; one where they are equal."""
    low, high = limits
    if low == high or count == 1:
        return (high,)
    between = np.geomspace(low, high, count)[1:-1]
    return (low, *(float(value) for value in between), high)


def lattice(box: GridBox, scr: int, x_over_r: int) -> tuple[GridPoint, ...]:
    """``scr`` × ``x_over_r`` grids over the box, X/R running fastest."""
    return tuple((s, x) for s in axis(box.scr, scr) for x in axis(box.x_over_r, x_over_r))


def corners(box: GridBox) -> tuple[GridPoint, ...]:
    """The box's corners: four grids, fewer where a limit pair is equal."""
    return lattice(box, 2, 2)


def circuits(
    converter: Converter, filter_: Filter, points: Sequence[GridPoint], basis: str, *, L_1: float = 1.0, C: float = 1.0
) -> list[FilterGrid]:
    """The circuit of each grid, with L_1 and C off by the factors ``L_1`` and ``C``."""
    f = replace(filter_, L_1=L_1 * filter_.L_1, C=C * filter_.C)
    grids = [Place(scr, x_over_r, basis).grid(converter) for scr, x_over_r in points]
    return [FilterGrid(f.L_1, f.R_1, f.C, f.R_c, f.L_2, f.R_2, g.R_g, g.L_g) for g in grids]


def sampling_ratio(converter: Converter, filter_: Filter, box: GridBox) -> float:
    """Sampling frequency over the box's highest resonance: what decides how well the inner loops can be damped."""
    resonance = highest_resonance(converter, filter_, box)
    return 2.0 * math.pi / (converter.T_s * resonance) if resonance > 0.0 else math.inf


def highest_resonance(converter: Converter, filter_: Filter, box: GridBox) -> float:
    """Highest natural frequency of filter and grid among the box's corners, rad/s; 0 where nothing rings."""
    return max(
        float(np.abs(np.linalg.eigvals(state_matrices(circuit)[0]).imag).max())
        for circuit in circuits(converter, filter_, corners(box), box.basis)
    )


POWER_FILTER = 5e-3
"""s, of the power loops that the gains are checked with."""


def angle_damped_target(settling_time: float, omega_n: float) -> ClosedFormTarget:
    """The angle-damped closed form, without coupling, at the present references (:eq:`angle-damped-gains`)."""
    target = ClosedFormTarget(
        settling_time=settling_time,
        damping_ratio=1.0,
        droop_ratio=0.01,
        P=0.0,
        Q=0.0,
        structure=ANGLE_DAMPED.name,
        follow_references=True,
    )
    return target.placed(2.0 * math.pi / omega_n, settling_margin(0.0))


def study_of(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox | None = None,
    *,
    target: ClosedFormTarget | None = None,
    tau: float = POWER_FILTER,
) -> Study:
    """A study with one controller on the box's strongest, least resistive grid and a nominal source.

    ``gains`` in SI, ``omega_t`` in rad/s, ``tau`` in s. Its hash is empty: it is no file's.
    """
    box = box or GridBox()
    target = target or angle_damped_target(1.0, converter.omega_n)
    c = converter
    return Study(
        name="inner_loops",
        title="inner loops",
        source="",
        converter=c,
        filter=filter_,
        inner_gains=gains,
        grid=Place(box.scr[1], box.x_over_r[1], box.basis).grid(c),
        grid_source=GridSource(c.V_rated_rms, c.omega_n),
        scr_basis=box.basis,
        target=target,
        tau_P=tau,
        tau_Q=tau,
        omega_t=omega_t,
        controllers=(ControllerSpec(name="scheduled", kind="scheduled", target=target),),
        simulation=SimulationSpec(
            duration=1.0,
            bridge="averaged",
            start="steady_state",
            log_interval=c.T_s,
            csv_interval=0.0,
            P_ref=0.0,
            Q_ref=0.0,
        ),
        events=(),
        stability=StabilitySpec(scr=(1.0,), x_over_r=(1.0,), P=(0.0,), Q=(0.0,), errors=(0.0,), gates=Gates()),
        hash="",
    )


CHECKED = (7, 7)
"""SCR × X/R of a check with closed power loops."""
POWERS_PU = (-0.5, 0.1, 0.7)
"""Active powers of such a check over the rated one, reactive power zero."""


def closed_form_cells(
    study: Study, target: ClosedFormTarget, points: Sequence[GridPoint], basis: str, powers_pu: Sequence[float]
) -> tuple[list[Cell], list[tuple[float, float, float]]]:
    """Cells with closed-form power loops that know the grid, and SCR, X/R and P (W) of each."""
    grids = [Place(scr, x_over_r, basis).grid(study.converter) for scr, x_over_r in points]
    R_g, L_g = np.array([grid.R_g for grid in grids]), np.array([grid.L_g for grid in grids])
    powers = [share * study.converter.S_rated for share in powers_pu]
    found = [closed_form_schedule(study, target, P, 0.0).gains_over(R_g, L_g) for P in powers]
    cells, where = [], []
    for k, point in enumerate(points):
        for P, gains in zip(powers, found, strict=True):
            own = PowerLoopGains(*(float(np.broadcast_to(value, R_g.shape)[k]) for value in gains))
            if all(map(math.isfinite, own)):
                cells.append(Cell(grids[k], own, P, 0.0))
                where.append((*point, P))
    return cells, where
