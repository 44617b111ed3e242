"""Short-circuit ratio and X/R against (R_g, L_g). The basis of the ratio is always said.

``impedance``: SCR = V_ll²/(S·|Z_g|), the usual definition. ``reactance``: SCR = V_ll²/(S·X_g), as the
published case has it; at X/R = 1 the two differ by √2.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def grid_from_scr_impedance(scr: Any, x_over_r: Any, Z_base: Any, omega: Any) -> Any:
    """Returns (R_g, L_g) in Ω and H, with the ratio taken on \\|Z_g\\| (:eq:`scr`)."""
    R_g = Z_base / scr / np.hypot(1.0, x_over_r)
    return R_g, R_g * x_over_r / omega


def grid_from_scr_reactance(scr: Any, x_over_r: Any, Z_base: Any, omega: Any) -> Any:
    """Returns (R_g, L_g) in Ω and H, with the ratio taken on X_g (:eq:`scr`)."""
    X_g = Z_base / scr
    return X_g / x_over_r, X_g / omega


def scr_impedance(R_g: Any, L_g: Any, Z_base: Any, omega: Any) -> Any:
    """Short-circuit ratio on \\|Z_g\\| of a grid."""
    return Z_base / np.hypot(R_g, omega * L_g)


def scr_reactance(R_g: Any, L_g: Any, Z_base: Any, omega: Any) -> Any:
    """Short-circuit ratio on X_g of a grid."""
    return Z_base / (omega * L_g) + 0.0 * R_g
