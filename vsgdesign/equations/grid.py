"""The circuit before the bridge: LC or LCL filter with an R–L grid, and the grid itself: conversion between
short-circuit ratio with X/R and (R_g, L_g), and its source.

The circuit is one axis of αβ (both axes are alike and uncoupled). States: converter-side current i_s (A), capacitor
voltage v_c (V), grid current i_g (A), all peak space-vector components. An LC filter is an LCL filter with L_2 = R_2 =
0. R_c damps in series with the capacitor.

The basis of the ratio is always stated. With the basis ``impedance``, SCR = V_ll²/(S·|Z_g|), which is the usual
definition. With ``reactance``, SCR = V_ll²/(S·X_g), which the published case uses. At X/R = 1 the two differ by √2.

The source's phase and magnitude wander and move its phasors (:eq:`wander`), and it has sags of the types A to G.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.frames import PHASES, rotate
from vsgdesign.errors import UnknownNameError


def grid_from_scr_impedance(scr: Any, x_over_r: Any, Z_base: Any, omega: Any) -> tuple[Any, Any]:
    """Returns (R_g, L_g) in Ω and H for a ratio taken on \\|Z_g\\| (:eq:`scr`)."""
    R_g = Z_base / scr / np.hypot(1.0, x_over_r)
    return R_g, R_g * x_over_r / omega


def grid_from_scr_reactance(scr: Any, x_over_r: Any, Z_base: Any, omega: Any) -> tuple[Any, Any]:
    """Returns (R_g, L_g) in Ω and H for a ratio taken on X_g (:eq:`scr`)."""
    X_g = Z_base / scr
    return X_g / x_over_r, X_g / omega


def scr_impedance(R_g: Any, L_g: Any, Z_base: Any, omega: Any) -> Any:
    """Short-circuit ratio of a grid, taken on \\|Z_g\\|."""
    return Z_base / np.hypot(R_g, omega * L_g)


def scr_reactance(R_g: Any, L_g: Any, Z_base: Any, omega: Any) -> Any:
    """Short-circuit ratio of a grid, taken on X_g."""
    return Z_base / (omega * L_g) + 0.0 * R_g


def grid_behind_load(R_g: Any, X_g: Any, G_load: Any, B_load: Any) -> tuple[Any, Any, Any, Any]:
    """Returns (R, X, cosine, sine) of what a grid with a load at the PCC looks like from the converter
    (:eq:`grid-behind-load`).

    The load has the admittance G_load + jB_load in S. R and X are in Ω. The source's phasor is that of the grid times
    cosine + j sine.
    """
    real = 1.0 + R_g * G_load - X_g * B_load
    imag = R_g * B_load + X_g * G_load
    length_sq = real * real + imag * imag
    cosine, sine = real / length_sq, -imag / length_sq
    return R_g * cosine - X_g * sine, R_g * sine + X_g * cosine, cosine, sine


def grid_of_each(R_g: Any, L_g: Any, units: Any) -> tuple[Any, Any]:
    """Returns (R_g, L_g) in Ω and H of the grid that each of so many equal units at one node sees, from the node's own
    (:eq:`plant-grid`): they change their currents together."""
    return units * R_g, units * L_g


MOST_ERROR_Z = 0.3
"""Largest error_Z that is designed for."""


def error_half_widths(R: Any, X: Any, error_R: Any, error_X: Any, error_Z: Any) -> tuple[Any, Any]:
    """Returns (h_R, h_X): by how much the estimate of a true grid R + jX may be off in R and in X (:eq:`error-set`).

    The widths are those of the box around the true grid that contains both ±error_R of R with ±error_X of X, and every
    error of at most error_Z·\\|Z\\| in any direction. R and X are in one unit, at the rated frequency.
    """
    least = error_Z * np.hypot(R, X)
    return np.maximum(error_R * np.abs(R), least), np.maximum(error_X * np.abs(X), least)


class ScrBasis(NamedTuple):
    """The part of a grid's impedance on which a short-circuit ratio is taken. Only here does the basis matter."""

    name: str
    """The name of the basis in study files and tables."""
    scr: Callable[[Any, Any, Any, Any], Any]
    """Function of R_g, L_g, Z_base and ω that returns the SCR."""
    grid: Callable[[Any, Any, Any, Any], Any]
    """Function of SCR, X/R, Z_base and ω that returns R_g and L_g."""
    counted: Callable[[Any, Any], Any]
    """Function of R and X that returns the counted part in the same unit; the SCR is Z_base divided by it."""
    magnitude: Callable[[Any, Any], Any]
    """Function of the counted part and the sine of the impedance's angle that returns \\|Z_g\\|."""
    counts_resistance: bool


class _ScrBases(dict[str, ScrBasis]):
    """The bases by name. An unknown name raises UnknownNameError."""

    def __missing__(self, name: str) -> ScrBasis:
        raise UnknownNameError("SCR basis", name, self)


IMPEDANCE = ScrBasis(
    name="impedance",
    scr=scr_impedance,
    grid=grid_from_scr_impedance,
    counted=np.hypot,
    magnitude=lambda counted, _: counted,
    counts_resistance=True,
)
REACTANCE = ScrBasis(
    name="reactance",
    scr=scr_reactance,
    grid=grid_from_scr_reactance,
    counted=lambda _, X: X,
    magnitude=lambda counted, sine: counted / sine,
    counts_resistance=False,
)
SCR_BASES = _ScrBases({basis.name: basis for basis in (IMPEDANCE, REACTANCE)})
"""The bases on which an SCR may be taken."""


class WanderPath(NamedTuple):
    """Where a wandering source is."""

    frequency: Any = 0.0
    """Hz."""
    turned: Any = 0.0
    """Its angle without noise, rad."""
    slow: Any = 0.0
    """ln of the magnitude: steps and walk."""
    magnitude: Any = 0.0
    """ln of the magnitude: its wander."""
    phase_noise: Any = 0.0
    voltage_noise: Any = 0.0


class WanderDrive(NamedTuple):
    """What random numbers add to the path in a sample."""

    frequency: Any
    turned: Any
    """Walk and jumps."""
    slow: Any
    """Walk and steps."""
    magnitude: Any
    phase_noise: Any
    voltage_noise: Any


class WanderPace(NamedTuple):
    """What of the path is left after a sample, and how far a frequency turns in it."""

    frequency: Any
    slow: Any
    magnitude: Any
    noise: Any
    turn: Any
    """rad/Hz."""


def wandered(path: WanderPath, drive: WanderDrive, pace: WanderPace) -> Any:
    """A sample of the path (:eq:`wander`). Returns (following, exponent, angle): the path at the next one, and ln of
    the magnitude and the angle (rad) at this one."""
    following = WanderPath(
        frequency=pace.frequency * path.frequency + drive.frequency,
        turned=path.turned + (pace.turn * path.frequency + drive.turned),
        slow=pace.slow * path.slow + drive.slow,
        magnitude=pace.magnitude * path.magnitude + drive.magnitude,
        phase_noise=pace.noise * path.phase_noise + drive.phase_noise,
        voltage_noise=pace.noise * path.voltage_noise + drive.voltage_noise,
    )
    exponent = path.slow + path.magnitude + path.voltage_noise
    return following, exponent, path.turned + path.phase_noise


def moved_phasor(gain: Any, angle: Any, turned: Any, cosine: Any, sine: Any) -> Any:
    """The phasor of a source that has turned by an angle (rad) from a direction (cosine, sine) on, and is moved by a
    gain and an angle (rad). Returns (moved_re, moved_im, change_re, change_im): of length 1, and by how much the
    fundamental differs from the one that is not moved."""
    turn_re, turn_im = rotate(np.cos(turned), np.sin(turned), cosine, sine)
    moved_re, moved_im = rotate(turn_re, turn_im, np.cos(angle), np.sin(angle))
    return moved_re, moved_im, gain * moved_re - turn_re, gain * moved_im - turn_im


_HALF, _THIRD = 0.5, 1.0 / PHASES

SAG_TYPES: dict[str, tuple[float, float]] = {
    "A": (1.0, 0.0),
    "B": (_THIRD, -_THIRD),
    "C": (_HALF, _HALF),
    "D": (_HALF, -_HALF),
    "E": (1.0 - _THIRD, _THIRD),
    "F": (1.0 - _THIRD, -_THIRD),
    "G": (1.0 - _THIRD, _THIRD),
}
"""Shares p and n of each type (:eq:`sag-types`). Without a zero sequence, E and G are the same."""


def sag_sequences(kind: str, V: complex) -> tuple[complex, complex]:
    """Positive and negative sequence of a sag over the voltage before it, as phasors of phase a (:eq:`sag-types`).

    ``kind`` is a name of :data:`SAG_TYPES`, and ``V`` is the characteristic voltage over the voltage before. Phase a is
    the phase of symmetry. The zero sequence is left out: three wires carry none.
    """
    p, n = SAG_TYPES[kind]
    return 1.0 - p * (1.0 - V), n * (1.0 - V)


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
