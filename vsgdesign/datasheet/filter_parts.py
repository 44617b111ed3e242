"""Inductors, capacitors and their resistances: per unit, kvar, star and delta."""

from __future__ import annotations

import math

from vsgdesign.datasheet.quantities import RATIO
from vsgdesign.datasheet.rows import Rows
from vsgdesign.datasheet.words import CONNECTIONS
from vsgdesign.frames import delta_to_star, delta_to_star_capacitance
from vsgdesign.parameters.units import format_quantity


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
