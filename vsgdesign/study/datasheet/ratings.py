"""Ratings, bridge and sampling of a datasheet, its filter and its grids.

Filter and grids may be given per unit, in kvar, in star or delta; as SCR, short-circuit power or impedance.
"""

from __future__ import annotations

import math
import re

from vsgdesign.equations.frames import (
    base_impedance,
    delta_to_star,
    delta_to_star_capacitance,
    linear_modulation_limit,
    ll_to_phase,
    peak_to_rms,
    phase_to_ll,
    rated_current_rms,
    rms_to_peak,
)
from vsgdesign.equations.grid import grid_from_scr_impedance
from vsgdesign.study.datasheet.fields import CONNECTIONS, MODULATIONS, read_delay, read_sampling
from vsgdesign.study.datasheet.quantities import RATIO, Amount, AmountError, read_amount
from vsgdesign.study.datasheet.reading import LIMITS, Entry, Rows
from vsgdesign.study.parameters.converter import angular_advice, frequency_of_angular
from vsgdesign.study.parameters.reader import format_quantity

DEFAULT_CURRENT_LIMIT = 1.2


def read_rating(rows: Rows) -> float:
    """The rating in VA, from VA, or from W and a power factor."""
    amount = rows.amount("rating", ("VA", "W"))
    power_factor = rows.plain("power_factor", RATIO, 1.0)
    if amount is None:
        return math.nan
    S = amount.value
    if amount.base == "W":
        S /= power_factor
        rows.remarks["S_rated"] = f"{format_quantity(amount.value, 'W')} at power factor {power_factor:.4g}"
        if "power_factor" not in rows.given:
            rows.assume("power_factor", "1.0, so that the rating in W is the one in VA")
    return rows.within("rating", S, "VA")


def read_voltage(rows: Rows) -> float:
    """The rated voltage, line-to-line rms, V."""
    entry = rows.given.get("voltage")
    pair = re.match(r"\s*(\d[\d.,]*)\s*k?V?\s*Y?\s*/\s*(\d[\d.,]*)\s*(.*)$", str(entry.value)) if entry else None
    if entry is not None and pair is not None:
        return _voltage_pair(rows, entry, pair)
    amount = rows.amount("voltage", ("V",))
    if amount is None:
        return math.nan
    words = amount.words | {rows.beside["voltage"]}
    if "peak" in words:
        rows.fault("voltage", "is a peak value", "Give the rms value.")
        return math.nan
    if {"ll", "ln"} <= words:
        rows.fault("voltage", "is said to be line to line and line to neutral", "Keep one of them.")
        return math.nan
    if "ln" in words:
        V = phase_to_ll(amount.value)
        rows.remarks["V_rated_ll_rms"] = f"{format_quantity(amount.value, 'V')} line to neutral"
    else:
        V = amount.value
        if "ll" not in words:
            rows.assume("voltage", f"{format_quantity(V, 'V')} is line to line, rms")
    return rows.within("voltage", V, "V")


def _voltage_pair(rows: Rows, entry: Entry, pair: re.Match[str]) -> float:
    """277/480 V and 480Y/277 V give both voltages at once."""
    try:
        unit = pair[3] or entry.unit
        both = sorted(
            read_amount(f"{text} {unit}", ("V",), decimal_comma=rows.sheet.decimal_comma).value
            for text in (pair[1], pair[2])
        )
    except AmountError as error:
        rows.fault("voltage", error.problem, error.advice)
        return math.nan
    if abs(both[1] - phase_to_ll(both[0])) > 0.02 * both[1]:
        rows.fault("voltage", "is two voltages that are not a phase and a line voltage", "Give the line voltage.")
        return math.nan
    rows.remarks["V_rated_ll_rms"] = f"the line voltage of {entry.value}"
    return rows.within("voltage", both[1], "V")


def read_frequency(rows: Rows) -> float:
    """The nominal frequency, Hz."""
    entry = rows.given.get("frequency")
    if entry is not None and re.match(r"\s*\d+\s*(?:hz)?\s*(?:/|or|und|oder|and)\s*\d+", str(entry.value), re.I):
        rows.fault("frequency", "is two frequencies", "Give the one that this study is for; make two studies.")
        return math.nan
    f_n = rows.plain("frequency", "Hz", math.nan)
    meant = frequency_of_angular(f_n)
    if meant is not None:
        rows.fault("frequency", "is in rad/s, it seems", angular_advice(meant))
    return f_n


def read_dc_link(rows: Rows) -> float:
    """The dc voltage, V; of a range, the smallest value."""
    amount = rows.amount("dc_link", ("V",), ranged=True)
    if amount is None:
        return math.nan
    V_dc = min(amount.values)
    if len(amount.values) == 2:
        rows.remarks["V_dc"] = "the least of " + " to ".join(format_quantity(v, "V") for v in amount.values)
        rows.assume("dc_link", f"{format_quantity(V_dc, 'V')}, the least at which it must work")
    return rows.within("dc_link", V_dc, "V")


def read_modulation(rows: Rows) -> str:
    """The modulation, as a study names it."""
    found = rows.word("pwm", MODULATIONS)
    if found is None:
        if "pwm" not in rows.given:
            rows.assume("pwm", "SVPWM, as most converters have")
        return "min_max"
    modulation, _, remark = found.partition(": ")
    if remark:
        rows.remarks["modulation"] = remark
        rows.assume("pwm", remark)
    return modulation


def check_voltages(rows: Rows, V: float, V_dc: float, modulation: str) -> None:
    """Check that the bridge can make the rated voltage, and that the dc link is not many times as large."""
    peak = rms_to_peak(ll_to_phase(V))
    limit = linear_modulation_limit(V_dc, modulation == "min_max")
    if limit < peak:
        advice = "Check both voltages and their units."
        if modulation == "sine_triangle" and linear_modulation_limit(V_dc, True) >= peak:
            advice = "Raise it, or say pwm = SVPWM if the modulator adds a zero sequence (+15 %)."
        rows.fault("dc_link", f"makes at most {limit:.4g} V phase peak, and the rated voltage is {peak:.4g} V", advice)
    elif limit > 6.0 * peak:
        rows.fault(
            "dc_link",
            f"makes {limit:.4g} V phase peak, {limit / peak:.3g} times the rated voltage's",
            "Check both voltages and their units.",
        )


def read_samples(rows: Rows, f_sw: float, f_n: float) -> int:
    """Samples per carrier period; 0 if they are not known."""
    entry = rows.given.get("sampling")
    if entry is None:
        rows.assume("sampling", "twice per carrier")
        samples = 2
    else:
        unit = entry.unit or ("s" if rows.beside["sampling"] == "period" else "")
        try:
            samples = read_sampling(str(entry.value), unit, f_sw, rows.sheet.decimal_comma)
        except AmountError as error:
            rows.fault("sampling", error.problem, error.advice)
            return 0
    if samples * f_sw < 20.0 * f_n:
        rows.fault(
            "carrier",
            f"samples {samples * f_sw / f_n:.3g} times in a cycle of {f_n:.6g} Hz; 20 are the least",
            "Check the carrier and its unit.",
        )
    return samples


def read_delay_samples(rows: Rows) -> int:
    """The computation delay, 0 or 1 sample."""
    entry = rows.given.get("delay")
    if entry is None:
        rows.assume("delay", "1 sample: computed in one period, applied in the next")
        return 1
    try:
        samples, remark = read_delay(entry.value, entry.unit, rows.sheet.decimal_comma)
    except AmountError as error:
        rows.fault("delay", error.problem, error.advice)
        return 1
    if remark:
        rows.remarks["delay_samples"] = remark
    return samples


def read_current_limit(rows: Rows, S: float, V: float) -> float:
    """The current limit in per unit of the rated current."""
    amount = rows.amount("current_limit", ("A", RATIO))
    if amount is None:
        if "current_limit" not in rows.given:
            rows.assume("current_limit", f"{DEFAULT_CURRENT_LIMIT} pu of the rated current")
        return DEFAULT_CURRENT_LIMIT
    words = amount.words | {rows.beside["current_limit"]}
    if amount.base == RATIO or (amount.bare and ("pu" in words or amount.value <= LIMITS["current_limit"][1])):
        if amount.bare and "pu" not in words:
            rows.assume("current_limit", f"{amount.value:.6g} is in pu of the rated current")
        return rows.within("current_limit", amount.value, RATIO)
    if ("rms" in words) == ("peak" in words):
        rows.fault("current_limit", "may be rms or peak", 'Write "A rms" or "A peak", or give it in pu.')
        return math.nan
    rated_rms = rated_current_rms(S, ll_to_phase(V))
    rms = amount.value if "rms" in words else peak_to_rms(amount.value)
    said = "rms" if "rms" in words else "peak"
    rows.remarks["current_limit_pu"] = f"{format_quantity(amount.value, 'A')} {said}"
    low, high = LIMITS["current_limit"]
    if not math.isnan(rated_rms) and not low <= rms / rated_rms <= high:
        rows.fault(
            "current_limit",
            f"is {rms / rated_rms:.4g} pu of {rated_rms:.4g} A rms, outside {low} to {high}",
            "Check it, the rating and the voltage.",
        )
    return rms / rated_rms


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
