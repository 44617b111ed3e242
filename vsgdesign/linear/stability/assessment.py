"""Everything that a stability report of one controller needs, computed in one place, and as rows for CSV files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import damping_of
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.linear.model.coupled import CoupledModel
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.loci import Mode, ModeSensitivity, mode_sensitivities, modes, stability_limit, track
from vsgdesign.linear.stability.loops import (
    FullOrderLoop,
    generalised_nyquist,
    network_frequency_perturbation,
    output_admittance,
    passivity_index,
)
from vsgdesign.linear.stability.maps import (
    MODELS,
    OUTSIDE,
    GainLaw,
    MarginMap,
    cells_under,
    estimate_error_map,
    full_order_cells,
    grid_arrays,
    judged_map,
    margin_map,
    only_asked,
    reduced_cells,
    stale_schedule_matrix,
)
from vsgdesign.linear.stability.margins import MarginTable, frequency_grid, full_order_margins, reduced_margins
from vsgdesign.linear.stability.step_responses import reduced_step_metrics
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.metrics.step_response import ResponseMetrics
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

_VIEW_POINTS = 600
_LOCUS_POINTS = 60
_BETWEEN_POINTS = 300


@dataclass(frozen=True, kw_only=True)
class FrequencyView:
    """One cell over frequency: the data of Bode, Nichols, NFP and impedance plots."""

    omega: Array
    L_P: Complex
    L_Q: Complex
    """The loops at the measured powers, each with the other closed."""
    admittance: Complex
    """(F, 2, 2), S, dq, peak over peak."""
    passivity: Array
    nyquist: Complex
    """(F, 2) eigenvalues of Z_g Y."""
    nfp: Complex
    """ΔP/Δω_g, per unit over per unit."""


@dataclass(frozen=True, kw_only=True)
class FocusCell:
    """One grid of the scenario, analysed in detail with both models."""

    label: str
    grid: Grid
    P: float
    Q: float
    reduced: CoupledModel
    full_order: FullOrderModel
    reduced_table: MarginTable
    full_order_table: MarginTable
    modes: tuple[Mode, ...]
    sensitivities: tuple[ModeSensitivity, ...]
    """States that take part in the least stable mode."""
    view: FrequencyView
    gains: PowerLoopGains
    """The gains in the steady state of the cell."""
    outside: str | None
    """The limit of the converter that the steady state exceeds; None if it exceeds none."""


@dataclass(frozen=True)
class Locus:
    """Full-order eigenvalues along a parameter: (K, n), tracked; NaN rows where there is no steady state."""

    parameter: str
    values: Array
    eigenvalues: Complex


@dataclass(frozen=True, kw_only=True)
class ControllerAssessment:
    """All maps and detailed cells of one controller."""

    spec: ControllerSpec
    reduced: MarginMap
    full_order: MarginMap
    step_P: tuple[ResponseMetrics | None, ...]
    step_Q: tuple[ResponseMetrics | None, ...]
    """P_ref to P and Q_ref to Q of the reduced model, for each row of its table; None if unstable."""
    stale: MarginMap | None
    """True SCR × the gains' SCR, full order; None for fixed gains."""
    estimate_error: MarginMap | None
    """SCR × X/R of the study × errors, full order; None for fixed gains."""
    between: MarginTable
    between_grids: Array
    """Margins of the full-order model at random grids between the map's nodes, (N, 2): SCR, X/R, for those within the
    converter's limits that are asked for.
    """
    focus: tuple[FocusCell, ...]
    loci: tuple[Locus, ...]
    x_over_r_limit: tuple[tuple[float, float | None], ...]
    """For each SCR of the study's grids, the X/R at which the reduced model loses stability; None if there is none."""


def assess(
    study: Study, spec: ControllerSpec, ready: Ready = NOTHING, progress: Progress | None = None
) -> ControllerAssessment:
    """Assess one controller over the study's [stability] axes and at its grids.

    ``ready`` contains the controller's gain table, if it uses one. ``progress`` is called with a description of the
    present work and the share that is done. Raises NoOperatingPointError if fixed gains cannot be designed, and
    InfeasibleStudyError if the table is missing.
    """
    tell, study = progress or silent, study.with_limit_of(spec)
    axes, law = study.stability, gain_law(study, spec, ready)
    P, Q = axes.P[0], axes.Q[0]
    ratio = study.grid.x_over_r(study.converter.omega_n)
    tell(spec.name, 0.0)
    reduced, full = (
        judged_map(study, margin_map(study, law, axes.scr, axes.x_over_r, axes.P, axes.Q, model)) for model in MODELS
    )
    model = reduced_cells(study, reduced.cells)
    step_P = tuple(reduced_step_metrics(model, "P_ref", "P"))
    step_Q = tuple(reduced_step_metrics(model, "Q_ref", "Q"))
    tell(spec.name, 0.4)
    scheduled = spec.kind == "scheduled"
    stale = stale_schedule_matrix(study, law, axes.scr, ratio, P, Q, "full_order") if scheduled else None
    tell(spec.name, 0.55)
    errors = estimate_error_map(study, law, axes.scr, [ratio], axes.errors, P, Q, "full_order") if scheduled else None
    tell(spec.name, 0.7)
    between_grids, between = _between_nodes(study, law, P, Q)
    tell(spec.name, 0.8)
    focus = _focus_cells(study, law, P, Q)
    tell(spec.name, 0.9)
    scr = study.grid.scr(study.converter, study.scr_basis)
    loci = (
        _locus(study, law, "SCR", np.geomspace(axes.scr[0], axes.scr[-1], _LOCUS_POINTS), ratio, P, Q),
        _locus(study, law, "X/R", np.geomspace(axes.x_over_r[0], axes.x_over_r[-1], _LOCUS_POINTS), scr, P, Q),
    )
    limits = tuple((f.grid.scr(study.converter, study.scr_basis), _limit(study, law, f.grid, P, Q)) for f in focus)
    tell(spec.name, 1.0)
    return ControllerAssessment(
        spec=spec,
        reduced=reduced,
        full_order=full,
        step_P=step_P,
        step_Q=step_Q,
        stale=stale,
        estimate_error=errors,
        between=between,
        between_grids=between_grids,
        focus=focus,
        loci=loci,
        x_over_r_limit=limits,
    )


def _limit(study: Study, law: GainLaw, grid: Grid, P: float, Q: float) -> float | None:
    try:
        return stability_limit(study, law, grid.scr(study.converter, study.scr_basis), P, Q)
    except InfeasibleStudyError:
        return None


def _between_nodes(study: Study, law: GainLaw, P: float, Q: float) -> tuple[Array, MarginTable]:
    """Random grids, log-uniform over the box of the axes, because a map may hide something between its nodes."""
    axes = study.stability
    rng = np.random.default_rng(0)
    low = np.log([axes.scr[0], axes.x_over_r[0]])
    high = np.log([axes.scr[-1], axes.x_over_r[-1]])
    points = np.exp(rng.uniform(low, high, (_BETWEEN_POINTS, 2)))
    grids = [grid_arrays(study, p[:1], p[1:]) for p in points]
    R_g = np.array([g[0][0, 0] for g in grids])
    L_g = np.array([g[1][0, 0] for g in grids])
    cells = only_asked(study, cells_under(study, law, R_g, L_g, P, Q))
    within = np.flatnonzero(cells.inside)
    points, cells = points[within], cells.take(within)
    model = full_order_cells(study, cells)
    return points[np.flatnonzero(cells.good)[model.index]], full_order_margins(model)


def _focus_cells(study: Study, law: GainLaw, P: float, Q: float) -> tuple[FocusCell, ...]:
    """Every distinct grid of the scenario that carries (P, Q) and has gains."""
    found = []
    grids = dict.fromkeys([study.grid, *(event.grid for event in study.events if event.grid is not None)])
    for grid in grids:
        cells = cells_under(study, law, grid.R_g, grid.L_g, P, Q)
        if not cells.good.all():
            continue
        reduced, full = reduced_cells(study, cells), full_order_cells(study, cells)
        if len(full.index) == 0:
            continue
        found_modes = modes(full.states, full.A[0], full.T_s)
        label = _label(study, grid, taken=[cell.label for cell in found])
        found.append(
            FocusCell(
                label=label,
                grid=grid,
                P=P,
                Q=Q,
                reduced=reduced,
                full_order=full,
                reduced_table=reduced_margins(reduced),
                full_order_table=full_order_margins(full),
                modes=found_modes,
                sensitivities=mode_sensitivities(full, 0, found_modes[0].s),
                view=_frequency_view(study, full),
                gains=PowerLoopGains(*(float(value[0]) for value in cells.gains)),
                outside=cells.outside[0],
            )
        )
    return tuple(found)


def _label(study: Study, grid: Grid, taken: list[str]) -> str:
    """SCR and X/R with three digits, or with as many as are needed to distinguish the grid from those before."""
    place = grid.place(study.converter, study.scr_basis)
    scr, ratio = place.scr, place.x_over_r
    labels = (f"SCR {scr:.{digits}g}, X/R {ratio:.{digits}g}" for digits in range(3, 17))
    return next((label for label in labels if label not in taken), f"SCR {scr!r}, X/R {ratio!r}")


def _frequency_view(study: Study, model: FullOrderModel) -> FrequencyView:
    omega = frequency_grid(model.T_s, _VIEW_POINTS)
    omega = omega[omega > 2.0 * np.pi * 0.01]
    S = FullOrderLoop(model).on(omega)[0]
    Y = output_admittance(model, 0, omega)
    return FrequencyView(
        omega=omega,
        L_P=1.0 / S[:, 0, 0] - 1.0,
        L_Q=1.0 / S[:, 1, 1] - 1.0,
        admittance=Y,
        passivity=passivity_index(Y),
        nyquist=generalised_nyquist(model, 0, omega),
        nfp=network_frequency_perturbation(model, 0, omega, study.converter.S_rated, study.converter.omega_n),
    )


def _locus(study: Study, law: GainLaw, parameter: str, values: Array, other: float, P: float, Q: float) -> Locus:
    """Eigenvalues over SCR at a fixed X/R, or over X/R at a fixed SCR."""
    if parameter == "SCR":
        R_g, L_g = (array[:, 0] for array in grid_arrays(study, values, np.array([other])))
    else:
        R_g, L_g = (array[0] for array in grid_arrays(study, np.array([other]), values))
    cells = cells_under(study, law, R_g, L_g, P, Q)
    model = full_order_cells(study, cells)
    spread = np.full((len(values), len(model.states)), np.nan + 0j)
    if len(model.index):
        good = np.flatnonzero(cells.good)[model.index]
        spread[good] = track(to_continuous(np.linalg.eigvals(model.A), model.T_s))
    return Locus(parameter, values, spread)


_COLUMNS = (
    "stable",
    "spectral_abscissa [1/s]",
    "{damping} [1]",
    "least_damped [rad/s]",
    "disk_margin_output [1]",
    "disk_margin_output_at [rad/s]",
    "disk_margin_input [1]",
    "disk_margin_input_at [rad/s]",
    "M_s [1]",
    "M_s_at [rad/s]",
    "gain_margin_P [dB]",
    "phase_margin_P [deg]",
    "delay_margin_P [s]",
    "gain_margin_Q [dB]",
    "phase_margin_Q [deg]",
    "delay_margin_Q [s]",
)


def map_header(field: MarginMap) -> list[str]:
    """Column names of :func:`map_rows`, with units."""
    axes = [name for name, _ in field.axes if name != "P, Q"]
    fixed = ["P [W]", "Q [var]", "R_g [ohm]", "L_g [H]", "V [V]", "delta [rad]", *field.cells.gains._fields]
    columns = [name.format(damping=damping_of(field.model)) for name in _COLUMNS]
    return [*axes, *fixed, *columns, "fault", OUTSIDE]


def map_rows(field: MarginMap) -> Iterator[list[object]]:
    """One row for each cell; a faulty cell has its reason and no values."""
    t, c = field.table, field.cells
    columns = [
        t.stable.astype(float),
        t.spectral_abscissa,
        t.least_damping,
        t.least_damped_rad_s,
        t.disk_output.value,
        t.disk_output.omega,
        t.disk_input.value,
        t.disk_input.omega,
        t.M_s.value,
        t.M_s.omega,
        t.loop_P.gain_margin_db,
        t.loop_P.phase_margin_deg,
        t.loop_P.delay_margin_s,
        t.loop_Q.gain_margin_db,
        t.loop_Q.phase_margin_deg,
        t.loop_Q.delay_margin_s,
    ]
    figures = np.stack(columns, axis=1) if len(t.stable) else np.empty((0, len(columns)))
    row_of = {int(flat): k for k, flat in enumerate(field.analysed)}
    keep = [k for k, (name, _) in enumerate(field.axes) if name != "P, Q"]
    for flat, fault in enumerate(field.faults):
        position = np.unravel_index(flat, field.shape)
        place = [float(field.axes[k][1][position[k]]) for k in keep]
        known = [c.P, c.Q, c.R_g, c.L_g, c.V_rms, c.delta, *c.gains]
        row = row_of.get(flat)
        values: list[object] = [None] * len(columns) if row is None else [float(v) for v in figures[row]]
        yield [*place, *(float(v[flat]) for v in known), *values, fault, c.outside[flat]]


VIEW_HEADER = (
    "frequency [Hz]",
    "L_P real",
    "L_P imag",
    "L_Q real",
    "L_Q imag",
    *(f"Y_{a}{b} {part} [S]" for a in "dq" for b in "dq" for part in ("real", "imag")),
    "passivity_index [S]",
    "nyquist_1 real",
    "nyquist_1 imag",
    "nyquist_2 real",
    "nyquist_2 imag",
    "NFP real [pu/pu]",
    "NFP imag [pu/pu]",
)
"""Column names of :func:`view_rows`."""


def view_rows(cell: FocusCell) -> Iterator[list[object]]:
    """One row for each frequency: loops, admittance, passivity, generalised Nyquist, NFP."""
    v = cell.view
    complex_columns = [v.L_P, v.L_Q, *(v.admittance[:, i, j] for i in (0, 1) for j in (0, 1))]
    for k, omega in enumerate(v.omega):
        row: list[object] = [float(omega / (2.0 * np.pi))]
        for column in complex_columns:
            row += [float(column[k].real), float(column[k].imag)]
        row.append(float(v.passivity[k]))
        for value in (*v.nyquist[k], v.nfp[k]):
            row += [float(value.real), float(value.imag)]
        yield row
