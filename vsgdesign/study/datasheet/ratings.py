"""Ratings, bridge and sampling of a datasheet."""

from __future__ import annotations

import math
import re

from vsgdesign.equations.frames import (
    linear_modulation_limit,
    ll_to_phase,
    peak_to_rms,
    phase_to_ll,
    rated_current_rms,
    rms_to_peak,
)
from vsgdesign.study.datasheet.fields import MODULATIONS, read_delay, read_sampling
from vsgdesign.study.datasheet.quantities import RATIO, AmountError, read_amount
from vsgdesign.study.datasheet.reading import Entry
from vsgdesign.study.datasheet.rows import LIMITS, Rows
from vsgdesign.study.parameters.converter import angular_advice, frequency_of_angular
from vsgdesign.study.parameters.units import format_quantity

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
