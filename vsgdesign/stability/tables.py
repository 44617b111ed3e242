"""Maps and frequency views as rows, for CSV files and for readers with their own tools."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vsgdesign.stability.assessment import FocusCell
from vsgdesign.stability.cells import OUTSIDE
from vsgdesign.stability.maps import MarginMap

_COLUMNS = (
    "stable",
    "spectral_abscissa [1/s]",
    "least_damping [1]",
    "least_damped [rad/s]",
    "disk_margin_output [1]",
    "at [rad/s]",
    "disk_margin_input [1]",
    "at [rad/s]",
    "M_s [1]",
    "at [rad/s]",
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
    return [*axes, *fixed, *_COLUMNS, "fault", OUTSIDE]


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
