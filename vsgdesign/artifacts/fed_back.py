"""How near a gain table comes to 1 − k_P D_p = 0, by which the change of its gains divides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.power_loops import MOST_FED_BACK
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.frames import base_impedance

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable

Array = NDArray[np.float64]


def largest_fed_back(table: GainTable) -> tuple[float, dict[str, float]]:
    """The largest k_P D_p (:eq:`droop-fed-back`) at the nodes, halfway between them, and at the limits and the middle
    of P, Q and V of the table's validity. Returns it with its place: ``scr``, ``x_over_r``, ``P``, ``Q`` and ``V_rms``.

    The value is −inf and the place empty if no node is a design.
    """
    base, box = table.base, table.validity
    r_over_x = 1.0 / table.x_over_r
    known = np.where(table.valid, 1.0, np.nan)
    columns = [_halved(_halved(values * known).T).T for values in table.parameters.values()]
    axes = [_halved(table.scr), _halved(r_over_x), *(_three(pair) for pair in (box.P, box.Q, box.V_rms))]
    scr, ratio, P, Q, V_rms = np.meshgrid(*axes, indexing="ij")
    Z_base = base_impedance(base.S_rated, base.V_rated_rms)
    R_g, L_g = SCR_BASES[base.scr_basis].grid(scr, 1.0 / ratio, Z_base, base.omega_n)
    J = scheduled_jacobian(P, Q, V_rms, R_g + base.R_2, base.omega_n * (L_g + base.L_2))
    normalised = NormalisedGains(*(values[:, :, None, None, None] for values in columns))
    ratings = table.D_p, table.D_q, base.S_rated, base.omega_n, table.law == "inertia"
    gains = STRUCTURES[table.structure].gains(*J, normalised, *ratings)
    found = np.broadcast_to(np.asarray(gains.k_P * gains.D_p + 0.0 * columns[0][:, :, None, None, None]), scr.shape)
    if not np.isfinite(found).any():
        return -np.inf, {}
    at = np.unravel_index(np.nanargmax(found), found.shape)
    place = {"scr": scr[at], "x_over_r": 1.0 / ratio[at], "P": P[at], "Q": Q[at], "V_rms": V_rms[at]}
    return float(found[at]), {name: float(value) for name, value in place.items()}


def fed_back_fault(table: GainTable) -> str | None:
    """Why the gains of a table may not be changed from one to another, in a sentence; None where they may."""
    found, at = largest_fed_back(table)
    if found <= MOST_FED_BACK:
        return None
    return (
        f"k_P·D_p reaches {found:.3g} at SCR {at['scr']:.3g}, X/R {at['x_over_r']:.3g}, P {at['P']:g} W, "
        f"Q {at['Q']:g} var, V {at['V_rms']:.4g} V, and may be at most {MOST_FED_BACK:g}: a change of gains divides by "
        "1 − k_P·D_p. Give less damping there (d_1, zeta) or a softer P–f droop (a larger P_droop)"
    )


def _halved(values: Array) -> Array:
    """Rows with the mean of every two neighbours between them."""
    made = np.repeat(values, 2, axis=0)[:-1]
    made[1::2] = 0.5 * (values[:-1] + values[1:])
    return made


def _three(pair: tuple[float, float]) -> Array:
    return np.linspace(*pair, 3)


__all__ = ["fed_back_fault", "largest_fed_back"]
