"""Short-circuit ratio and X/R against (R_g, L_g). The basis of the ratio is always said.

``impedance``: SCR = V_ll²/(S·|Z_g|), the usual definition. ``reactance``: SCR = V_ll²/(S·X_g), as the
published case has it; at X/R = 1 the two differ by √2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.errors import UnknownNameError


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


class ScrBasis(NamedTuple):
    """What a short-circuit ratio counts of a grid's impedance: the one place where that makes a difference."""

    name: str
    """As studies and tables have it."""
    scr: Callable[[Any, Any, Any, Any], Any]
    """R_g, L_g, Z_base, ω to SCR."""
    grid: Callable[[Any, Any, Any, Any], Any]
    """SCR, X/R, Z_base, ω to R_g and L_g."""
    counted: Callable[[Any, Any], Any]
    """R and X to what is counted, in their unit: SCR is Z_base over it."""
    magnitude: Callable[[Any, Any], Any]
    """What is counted, and the sine of the impedance's angle, to \\|Z_g\\|."""
    counts_resistance: bool


class _ScrBases(dict[str, ScrBasis]):
    """By name; an unknown name raises UnknownNameError."""

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
"""Everything that an SCR may be taken on."""
