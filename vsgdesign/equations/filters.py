"""LC and LCL filter with an R–L grid, one axis of αβ (both axes are alike and uncoupled).

States: converter-side current i_s (A), capacitor voltage v_c (V), grid current i_g (A), all peak space-vector
components. An LC filter is an LCL filter with L_2 = R_2 = 0. R_c damps in series with the capacitor.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class FilterGrid(NamedTuple):
    """The circuit between the bridge and the grid source, SI."""

    L_1: Any
    R_1: Any
    C: Any
    R_c: Any
    L_2: Any
    R_2: Any
    R_g: Any
    L_g: Any


def capacitor_node_voltage(i_s: Any, v_c: Any, i_g: Any, circuit: FilterGrid) -> Any:
    """Voltage of the capacitor branch, damping resistor included: what the voltage sensor sees."""
    return v_c + circuit.R_c * (i_s - i_g)


def filter_grid_derivative(i_s: Any, v_c: Any, i_g: Any, v_b: Any, v_g: Any, circuit: FilterGrid) -> Any:
    """d(i_s, v_c, i_g)/dt for bridge voltage v_b and grid source v_g (:eq:`filter-grid`)."""
    v_node = capacitor_node_voltage(i_s, v_c, i_g, circuit)
    di_s = (v_b - circuit.R_1 * i_s - v_node) / circuit.L_1
    dv_c = (i_s - i_g) / circuit.C
    di_g = (v_node - (circuit.R_2 + circuit.R_g) * i_g - v_g) / (circuit.L_2 + circuit.L_g)
    return di_s, dv_c, di_g


def pcc_voltage(i_s: Any, v_c: Any, i_g: Any, v_g: Any, circuit: FilterGrid) -> Any:
    """Voltage at the PCC, between L_2 and the grid impedance (:eq:`pcc-voltage`).

    The inductive divider of node and grid voltage, corrected for the two resistances. With L_2 = R_2 = 0
    it is the capacitor node.
    """
    v_node = capacitor_node_voltage(i_s, v_c, i_g, circuit)
    inductive = circuit.L_g * v_node + circuit.L_2 * v_g
    resistive = (circuit.R_g * circuit.L_2 - circuit.R_2 * circuit.L_g) * i_g
    return (inductive + resistive) / (circuit.L_2 + circuit.L_g)


def largest_current_after_jump(limit: Any, phase: Any, turn: Any, X_1: Any) -> Any:
    """Bound of the converter current after a jump of the grid's phase, by hand (:eq:`phase-jump-bound`).

    ``limit``: the current limit, pu. ``phase``: the jump, 0 to π rad. ``turn``: the angle by which the grid turns
    until the bridge answers a measurement, ω (d + 1) T_s, rad. ``X_1``: the converter-side reactance, pu. Returns pu.
    """
    return limit + 2.0 * np.sin(0.5 * phase) * turn / X_1
