"""Gain tables from the closed form, for tests: constant normalised columns, or any others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vsgdesign.artifacts.certificate_record import certificate_record
from vsgdesign.artifacts.gain_table import COLUMNS, GainTable, TableBase, ValidityBox, fill_outside, to_dimensionless
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.table import table_grids, table_schedule, with_node_gains

PUBLISHED_BASE = TableBase(S_rated=5e3, V_rated_rms=110.0, omega_n=2.0 * np.pi * 50.0, V_g_rms=110.0)
CONSTANT = {
    "poles": {"k_1": 15.8, "d_1": 6.6, "k_2": 4.0, "q": 0.0, "share_P": 1.0, "share_Q": 1.0},
    "inertia": {"H": 2.0, "zeta": 0.7, "k_2": 4.0, "q": 0.0, "share_P": 1.0, "share_Q": 1.0},
    "published": {"k_1": 16.0, "d_1": 8.0, "k_2": 4.0, "q": 0.01, "share_P": 0.0, "share_Q": 0.0},
}


def table(
    structure: str = "angle_damped",
    law: str = "poles",
    scr: Any = (1.5, 2.0, 5.0, 20.0),
    x_over_r: Any = (0.3, 1.0, 3.0, 10.0),
    parameters: Mapping[str, Any] | None = None,
    **changes: Any,
) -> GainTable:
    """A whole table; ``parameters``: normalised columns in SI, numbers or (n, m) arrays, over the closed form's;
    ``certificate``: as its document."""
    scr, x_over_r = np.asarray(scr, dtype=float), np.asarray(x_over_r, dtype=float)
    shape = (len(scr), len(x_over_r))
    chosen = CONSTANT["published" if (structure, law) == ("published", "poles") else law] | dict(parameters or {})
    if structure == "published":
        chosen |= {"share_P": 0.0, "share_Q": 0.0}
    columns = {name: np.broadcast_to(chosen[name], shape) for name in COLUMNS[law]}
    time_scale = 1.0 if law == "inertia" else 1.5
    content: dict[str, Any] = {
        "name": "closed form",
        "structure": structure,
        "law": law,
        "study": "published",
        "study_hash": "0" * 64,
        "base": PUBLISHED_BASE,
        "D_p": 318.3 if structure == "angle_damped" else 0.0,
        "D_q": 0.0 if structure == "published" else 90.9,
        "P_design": 4500.0,
        "Q_design": 1000.0,
        "time_scale": time_scale,
        "scr": scr,
        "x_over_r": x_over_r,
        "columns": to_dimensionless(columns, time_scale),
        "gains": PowerLoopGains(*[np.full(shape, np.nan)] * 8),
        "status": np.full(shape, "met"),
        "active": np.full(shape, ""),
        "price": np.zeros(shape),
        "specification": {"settling_time": time_scale, "overshoot_pct": 1.0},
        "validity": ValidityBox(
            (scr[0], scr[-1]), (x_over_r[0], x_over_r[-1]), (-4500.0, 4500.0), (-2000.0, 2000.0), (93.5, 137.5), 0.2
        ),
    } | changes
    if isinstance(content.get("certificate"), dict):
        content["certificate"] = certificate_record(content["certificate"])
    bare = GainTable(**content)
    A, _, _, D = table_schedule(bare).plant_gains(*table_grids(bare))
    carries = (A > 0.0) & (D > 0.0)
    if "status" not in changes:
        content["status"] = np.where(carries, "met", "outside")
        content["price"] = np.where(carries, 0.0, np.nan)
        content["columns"] = {name: fill_outside(values, carries) for name, values in bare.columns.items()}
    return with_node_gains(GainTable(**content))
