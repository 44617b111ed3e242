"""Filter and grids of a datasheet: per unit, kvar, star and delta; SCR, short-circuit power or impedance."""

from __future__ import annotations

import math

from vsgdesign.equations.frames import base_impedance, delta_to_star, delta_to_star_capacitance, ll_to_phase
from vsgdesign.equations.grid import grid_from_scr_impedance
from vsgdesign.study.datasheet.fields import CONNECTIONS
from vsgdesign.study.datasheet.quantities import RATIO, Amount
from vsgdesign.study.datasheet.rows import LIMITS, Rows
from vsgdesign.study.parameters.units import format_quantity


def read_inductor(rows: Rows, name: str, Z: float, omega: float) -> float:
    """An inductance in H, from H, from a reactance or from per unit."""
    amount = rows.amount(name, ("H", "ohm", RATIO))
    if amount is None:
        return math.nan
    field = "L_2" if name == "transformer" else name
    if amount.base == RATIO:
        L = amount.value * Z / omega
        rows.remarks[field] = f"{amount.value:.6g} pu"
        if name == "transformer":
            rows.assume(name, f"{amount.value:.6g} pu is on the converter's rating and voltage")
    elif amount.base == "ohm":
        L = amount.value / omega
        rows.remarks[field] = f"{format_quantity(amount.value, 'ohm')} at nominal frequency"
    else:
        L = amount.value
    return rows.within(name, L, "H", Z / omega)


def read_resistance(rows: Rows, name: str, of: str, assumed: float, Z: float, q: float) -> float:
    """A resistance in Ω, from Ω or per unit. If it is missing, it follows from X/R = q of the inductor."""
    amount = rows.amount(name, ("ohm", RATIO))
    if amount is None:
        if name not in rows.given:
            rows.assume(name, f"{format_quantity(float(f'{assumed:.4g}'), 'ohm')}: X/R of {of} is {q:.6g}")
        return float(f"{assumed:.4g}")
    if amount.base == RATIO:
        rows.remarks[name] = f"{amount.value:.6g} pu"
        return rows.within(name, amount.value * Z, "ohm", Z)
    return rows.within(name, amount.value, "ohm", Z)


def read_capacitor(rows: Rows, Z: float, omega: float, V: float) -> tuple[float, float]:
    """C and its series resistance per phase in star. Three capacitors in delta count as three times the capacitance."""
    said = rows.word("capacitor_connection", CONNECTIONS)
    amount = rows.amount("C", ("F", "var", RATIO))
    words = (amount.words if amount else frozenset()) | {rows.beside.get("C", "")}
    connections = {word for word in (said, *words) if word in ("star", "delta")}
    if len(connections) > 1:
        rows.fault("capacitor_connection", "is not the one that C says", "Keep one of them.")
    in_delta = connections == {"delta"}
    C = math.nan
    if amount is not None and amount.base == RATIO:
        C = amount.value / (Z * omega)
        rows.remarks["C"] = f"{amount.value:.6g} pu, star"
    elif amount is not None and amount.base == "var":
        C = amount.value / (omega * V * V)
        rows.remarks["C"] = f"{format_quantity(amount.value, 'var')} of all three at rated voltage, as star"
    elif amount is not None:
        C = delta_to_star_capacitance(amount.value) if in_delta else amount.value
        if in_delta:
            rows.remarks["C"] = f"star; three of {format_quantity(amount.value, 'F')} in delta"
        elif not connections and "capacitor_connection" not in rows.given:
            rows.assume("capacitor_connection", "star (three of the same in delta are three times that)")
    C = rows.within("C", C, "F", 1.0 / (Z * omega))
    resistor = rows.amount("R_c", ("ohm", RATIO))
    if resistor is None:
        if "R_c" not in rows.given:
            rows.assume("R_c", "0 ohm: nothing in series with C damps the filter")
        return C, 0.0
    R_c = resistor.value * (Z if resistor.base == RATIO else 1.0)
    if in_delta and resistor.base != RATIO and R_c > 0.0:
        R_c = delta_to_star(R_c)
        rows.remarks["R_c"] = f"star; {format_quantity(resistor.value, 'ohm')} in series with each in delta"
    return C, rows.within("R_c", R_c, "ohm", Z)


def read_outer(rows: Rows, kind: str | None, Z: float, omega: float, q: float) -> tuple[float, float]:
    """L_2 and R_2 including the leakage of a transformer; zeros for an LC filter."""
    both = [name for name in ("L_2", "transformer") if name in rows.given]
    if kind == "LC" and both:
        rows.fault(both[0], "an LC filter has none", "Say filter = LCL, or take it out.")
    if kind == "LCL" and not both:
        rows.fault("L_2", "missing of an LCL filter", "Give L_2 or transformer, or say filter = LC.")
    if not both:
        if "R_2" in rows.given:
            rows.fault("R_2", "belongs to L_2, which is missing", "Give L_2, or take it out.")
        if kind is None:
            rows.assume("filter", "LC: there is no L_2 and no transformer")
        return 0.0, 0.0
    parts = [read_inductor(rows, name, Z, omega) for name in both]
    L_2 = sum(parts)
    if len(both) == 2:
        rows.remarks["L_2"] = " and ".join(
            f"{format_quantity(L, 'H')} of {'L_2' if name == 'L_2' else 'the transformer'}"
            for name, L in zip(both, parts, strict=True)
        )
    return L_2, read_resistance(rows, "R_2", "L_2", L_2 * omega / q, Z, q)


def check_resonance(rows: Rows, L_1: float, C: float, T_s: float) -> None:
    """Check that L_1 and C alone, behind the weakest grid, have their resonance below half the sampling frequency."""
    resonance = 1.0 / (2.0 * math.pi * math.sqrt(L_1 * C)) if L_1 * C > 0.0 else math.nan
    if resonance > 0.5 / T_s:
        rows.fault(
            "C",
            f"rings with L_1 at {resonance:.4g} Hz, above half the sampling frequency ({0.5 / T_s:.4g} Hz)",
            "Check L_1, C, the carrier and their units.",
        )


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
