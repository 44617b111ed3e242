"""The strength of a datasheet's grids, given as SCR, as short-circuit power or as impedance."""

from __future__ import annotations

import math

from vsgdesign.datasheet.quantities import RATIO, Amount
from vsgdesign.datasheet.rows import LIMITS, Rows
from vsgdesign.equations.grid import grid_from_scr_impedance
from vsgdesign.frames import base_impedance, ll_to_phase
from vsgdesign.parameters.units import format_quantity

DEFAULT_SCR = (1.5, 20.0)
DEFAULT_X_OVER_R = (0.3, 20.0)


def read_scr(rows: Rows, S: float, V: float) -> tuple[float, float]:
    """Smallest and largest short-circuit ratio on the impedance."""
    names = [name for name in ("scr", "short_circuit_power", "grid_impedance") if name in rows.given]
    if len(names) > 1:
        rows.fault(names[1], f"says what {names[0]} says", "Keep one of them.")
        return DEFAULT_SCR
    if names in ([], ["scr"]):
        return read_range(rows, "scr", DEFAULT_SCR)
    amount = rows.amount(names[0], ("VA",) if names[0] == "short_circuit_power" else ("ohm", RATIO), ranged=True)
    if amount is None:
        return DEFAULT_SCR
    Z_base = base_impedance(S, ll_to_phase(V))
    per_unit = [value / {"VA": S, "ohm": Z_base, RATIO: 1.0}[amount.base] for value in amount.values]
    if amount.base != "VA":  # an impedance: its inverse in per unit is the ratio
        per_unit = [1.0 / value if value > 0.0 else math.inf for value in per_unit]
    rows.remarks["scr"] = f"{names[0].replace('_', ' ')} " + " to ".join(
        format_quantity(value, amount.base) for value in amount.values
    )
    turned = amount.base != "VA"  # the least impedance is the largest ratio
    return _ends(rows, names[0], per_unit, _said(rows, names[0], amount), DEFAULT_SCR, turned=turned)


def read_range(rows: Rows, name: str, default: tuple[float, float]) -> tuple[float, float]:
    """Both ends of a range of ratios."""
    amount = rows.amount(name, (RATIO,), ranged=True)
    if amount is None:
        if name not in rows.given:
            rows.assume(name, f"{default[0]:.6g} to {default[1]:.6g}")
        return default
    return _ends(rows, name, list(amount.values), _said(rows, name, amount), default)


def _said(rows: Rows, name: str, amount: Amount) -> frozenset[str]:
    """What the field and its name say about the value: ``least``, ``most``."""
    return amount.words | {rows.beside.get(name, "")}


def _ends(
    rows: Rows,
    name: str,
    values: list[float],
    said: frozenset[str],
    default: tuple[float, float],
    *,
    turned: bool = False,
) -> tuple[float, float]:
    """Both ends of a range. Of a single value, which is no range, the other end or both are assumed, and it is said."""
    field = "x_over_r" if name == "x_over_r" else "scr"
    low, high = LIMITS[field]
    ends = sorted(values)
    if not all(low <= end <= high for end in ends):
        shown = " to ".join(f"{end:.4g}" for end in ends)
        what = "" if name == field else f"is {field} {shown}, "
        rows.fault(name, f"{what}outside {low:.6g} to {high:.6g}", "Check it, the rating and their units.")
        return ends[0], ends[-1]
    if len(ends) == 2 and ends[1] > 1.02 * ends[0]:
        return ends[0], ends[1]
    one, example = ends[0], f"{default[0]:.6g} to {default[1]:.6g}"
    if ("most" if turned else "least") in said:
        ends = [one, max(default[1], min(4.0 * one, high))]
        rows.assume(field, f"up to {ends[1]:.6g}: only the least is given")
    elif ("least" if turned else "most") in said:
        ends = [min(default[0], max(0.25 * one, low)), one]
        rows.assume(field, f"from {ends[0]:.6g}: only the largest is given")
    else:
        ends = [max(float(f"{one / 1.25:.4g}"), low), min(float(f"{one * 1.25:.4g}"), high)]
        rows.assume(
            field, f"{ends[0]:.6g} to {ends[1]:.6g}: one value is no range. For more grids give one, such as {example}"
        )
    return ends[0], ends[1]


def strongest_inductance(scr: tuple[float, float], x_over_r: tuple[float, float], Z: float, omega: float) -> float:
    """The smallest L_g of the grids, H: that of the strongest and most resistive one. ``Z`` is the base impedance."""
    _, L_g = grid_from_scr_impedance(scr[1], x_over_r[0], Z, omega)
    return float(L_g)
