"""The fields of a datasheet: their names and words as people write them, and the question for each."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from vsgdesign.errors import did_you_mean, nearest
from vsgdesign.study.datasheet.quantities import AmountError, read_amount


@dataclass(frozen=True)
class Field:
    """One field of a datasheet."""

    name: str
    """The name in messages and in the tutorial."""
    question: str
    """The question on the terminal."""
    missing: str
    """What is done if the field is not given. If this is empty, the field must be given."""
    example: str
    aliases: tuple[str, ...]
    """Other names. ``name > word``: the name also says something about the value, such as phase voltage or delta."""


FIELDS = (
    Field("title", "What is the converter called", "named after its ratings", "Bench converter",
          ("name", "converter", "model", "type", "product", "designation", "description", "bezeichnung")),
    Field("rating", "Rated power, kVA (or kW)", "", "250 kVA",
          ("S", "S_n", "S_rated", "rated power", "rated apparent power", "apparent power", "nominal power", "power",
           "output power", "power rating", "S_nom", "P_rated", "P_n", "P_nom", "rated active power", "active power",
           "nennleistung", "scheinleistung", "leistung", "bemessungsleistung")),
    Field("power_factor", "Power factor of that rating", "1.0", "0.8",
          ("pf", "cos phi", "cosphi", "cos φ", "cosφ", "leistungsfaktor", "rated power factor")),
    Field("voltage", "Rated voltage, line to line unless you say phase", "", "480 V L-L",
          ("V", "U", "V_n", "U_n", "V_ll", "V_rated", "U_rated", "V_rated_ll_rms > ll", "V_ll_rms > ll",
           "V_rated_rms > ln", "rated voltage", "nominal voltage", "ac voltage", "grid voltage", "output voltage",
           "line voltage > ll", "line to line voltage > ll", "voltage ll > ll", "phase voltage > ln", "voltage ln > ln",
           "phase to neutral voltage > ln", "line to neutral voltage > ln", "V_ln > ln", "V_phase > ln",
           "nennspannung", "netzspannung", "spannung", "bemessungsspannung", "leiterspannung > ll",
           "strangspannung > ln", "ac output voltage", "rated ac voltage", "nominal ac voltage",
           "nominal voltage ll > ll", "rated voltage ll > ll", "nominal voltage ln > ln", "rated voltage ln > ln",
           "nominal line to line voltage > ll", "rated line to line voltage > ll")),
    Field("frequency", "Nominal frequency", "", "60 Hz",
          ("f", "f_n", "f_nom", "f_grid", "nominal frequency", "rated frequency", "grid frequency", "line frequency",
           "mains frequency", "output frequency", "nennfrequenz", "netzfrequenz", "frequenz")),
    Field("dc_link", "Dc-link voltage (the least at which it must work)", "", "850 V",
          ("V_dc", "U_dc", "vdc", "udc", "dc voltage", "dc link voltage", "dc bus", "dc bus voltage",
           "dc input voltage", "zwischenkreisspannung", "zwischenkreis", "dc link")),
    Field("dc_power", "Largest power of the dc source (none: an ideal dc link)", "none: the dc link is ideal", "300 kW",
          ("P_dc", "dc power", "dc source power", "source power", "battery power", "maximum dc power", "max dc power",
           "dc input power", "discharge power", "batterieleistung", "entladeleistung")),
    Field("dc_charge_power", "Largest power that it takes", "none: it takes no power", "150 kW",
          ("charge power", "charging power", "maximum charge power", "max charge power", "P_charge", "ladeleistung")),
    Field("dc_capacitor", "Capacitor of the dc link", "what stores 10 ms of the rating", "8 mF",
          ("C_dc", "dc link capacitor", "dc link capacitance", "dc capacitor", "dc capacitance", "dc bus capacitor",
           "dc bus capacitance", "zwischenkreiskapazität", "zwischenkreiskondensator")),
    Field("dc_energy", "Usable energy of the dc source, kWh", "without a limit", "200 kWh",
          ("usable energy", "battery energy", "energy", "battery capacity", "storage", "energieinhalt", "dc energy")),
    Field("carrier", "Carrier (switching) frequency", "", "10 kHz",
          ("f_sw", "f_c", "f_pwm", "fsw", "switching frequency", "carrier frequency", "pwm frequency",
           "schaltfrequenz", "taktfrequenz", "pulse frequency")),
    Field("sampling", "Samples per carrier (once, twice), or the sampling frequency", "twice per carrier", "twice",
          ("samples per carrier", "samples_per_carrier", "sampling frequency", "sampling rate", "sample rate", "f_s",
           "control frequency", "update", "pwm update", "sample time > period", "sampling time > period",
           "sampling period > period", "T_s > period", "control period > period", "abtastfrequenz",
           "abtastzeit > period", "abtastung")),
    Field("delay", "Samples of computation delay (0 or 1)", "1 sample", "1",
          ("delay_samples", "computation delay", "computational delay", "control delay", "delay samples",
           "processing delay", "totzeit", "rechenzeit")),
    Field("pwm", "Kind of PWM (SPWM, SVPWM, third harmonic...)", "SVPWM", "SVPWM",
          ("modulation", "pwm type", "pwm kind", "pwm method", "modulation method", "modulation type", "modulator",
           "modulationsverfahren", "pwm scheme", "modulation scheme", "pwm strategy")),
    Field("current_limit", "Current limit, A rms, A peak or pu", "1.2 pu", "1.5 pu",
          ("I_max", "i_lim", "I_limit", "current_limit_pu > pu", "maximum current", "max current",
           "peak current > peak", "I_max_rms > rms", "I_max_pk > peak", "overcurrent limit",
           "current limitation", "overload current", "maximum output current", "max output current",
           "maximum ac current", "max ac current", "strombegrenzung", "maximalstrom", "overload",
           "short circuit current limit")),
    Field("filter", "Filter, LC or LCL", "LCL where L_2 or a transformer is given, else LC", "LCL",
          ("kind", "filter type", "filter kind", "filter topology", "output filter", "filtertyp", "ac filter")),
    Field("L_1", "Converter-side inductor L_1, mH, uH or pu", "", "0.25 mH",
          ("L1", "L_f", "L_fc", "L_c", "L_i", "L_inv", "L", "converter side inductor", "converter side inductance",
           "inverter side inductance", "inverter side inductor", "filter inductance", "filter inductor", "inductance",
           "converter inductor", "converter inductance", "inductor", "induktivität", "drossel", "filterdrossel",
           "filterinduktivität")),
    Field("R_1", "Its resistance (ESR, with the switches)", "its reactance over inductor_x_over_r", "5 mohm",
          ("R1", "R_f", "R_fc", "R_L1", "ESR_L1", "L1 ESR", "L_1 resistance", "esr of L1", "inductor resistance",
           "inductor esr", "converter side resistance", "filter resistance", "drosselwiderstand")),
    Field("C", "Filter capacitor C, uF, pu or kvar", "", "60 uF",
          ("C_f", "cf", "C_filter", "filter capacitor", "filter capacitance", "capacitor", "capacitance",
           "C_delta > delta", "C_d > delta", "C_star > star", "C_y > star", "C_wye > star", "kapazität",
           "filterkondensator",
           "filterkapazität", "kondensator", "ac capacitor", "ac filter capacitor")),
    Field("capacitor_connection", "Capacitors in star or delta", "star", "delta",
          ("connection", "capacitor connection", "C connection", "capacitors", "schaltung", "capacitor configuration",
           "connection of C", "kondensatorschaltung", "filter capacitor connection", "cap connection")),
    Field("R_c", "Resistor in series with each capacitor (0: none)", "none: nothing is damped by it", "20 mohm",
          ("Rc", "R_d", "Rd", "damping resistor", "damping resistance", "ESR_C", "C ESR", "capacitor ESR", "R_cf",
           "capacitor resistance", "esr of C", "dämpfungswiderstand")),
    Field("L_2", "Grid-side inductor L_2", "none", "0.08 mH",
          ("L2", "L_fg", "grid side inductor", "grid side inductance", "grid inductor",
           "line side inductor", "line side inductance", "netzdrossel", "output inductor")),
    Field("R_2", "Its resistance", "its reactance over inductor_x_over_r", "3 mohm",
          ("R2", "R_fg", "R_L2", "ESR_L2", "L2 ESR", "L_2 resistance", "esr of L2", "grid side resistance")),
    Field("transformer", "Leakage of a transformer behind the filter (u_k)", "none", "6 %",
          ("transformer leakage", "leakage", "leakage inductance", "L_t", "L_tr", "u_k", "uk", "u_cc",
           "transformer impedance", "short circuit voltage", "transformator", "kurzschlussspannung",
            "transformer reactance")),
    Field("inductor_x_over_r", "X/R of inductors without a resistance", "30", "30",
          ("X/R of inductors", "inductor X/R", "quality factor", "Q of inductors", "inductor quality")),
    Field("scr", "Short-circuit ratios of its grids", "1.5 to 20", "1.5 to 20",
          ("short circuit ratio", "SCR range", "short circuit ratios", "kurzschlussverhältnis", "grid scr",
           "minimum short circuit ratio > least", "min short circuit ratio > least", "minimum scr > least",
           "min scr > least", "scr min > least")),
    Field("x_over_r", "X/R ratios of its grids", "0.3 to 20", "0.3 to 20",
          ("X/R", "X over R", "XR", "XR ratio", "X/R ratio", "X/R range", "grid X/R", "grid x over r")),
    Field("short_circuit_power", "Short-circuit power at its terminals", "", "5 MVA to 40 MVA",
          ("fault level", "S_sc", "S_k", "Sk", "Ssc", "short circuit level", "short circuit capacity", "fault power",
           "kurzschlussleistung", "grid short circuit power")),
    Field("grid_impedance", "Impedance of the grid at its terminals", "", "20 mohm to 0.3 ohm",
          ("Z_g", "Zg", "Z_grid", "grid impedance", "impedance at the terminals", "source impedance", "netzimpedanz",
           "terminal impedance", "line impedance")),
    Field("source", "Where these data are from", "none", "data sheet DS-250, page 3",
          ("reference", "citation", "origin", "datasheet", "quelle", "url")),
)  # fmt: skip

UNUSED = (
    "efficiency", "weight", "mass", "dimensions", "height", "width", "depth", "cooling", "temperature", "humidity",
    "altitude", "noise", "thd", "serial", "date", "warranty", "protection", "enclosure", "manufacturer",
    "communication", "price", "standard", "certification", "losses", "ambient", "revision", "comment",
    "note", "remark", "dead time",
    "wirkungsgrad", "gewicht", "hersteller", "kühlung", "schutzart", "phases", "mtbf",
    "ip", "emc", "display", "interface",
)  # fmt: skip
"""Rows that many datasheets have and no study needs. They are listed as not used. Any other unknown row is a fault."""

BY_NAME = {field.name: field for field in FIELDS}


def squeezed(key: str) -> str:
    """A key without spaces, brackets, case and special characters: ``Rated power (kVA)`` equals ``rated_power``."""
    return re.sub(r"[\W_]", "", re.sub(r"[(\[].*?[)\]]", "", key)).casefold()


def _aliases() -> dict[str, tuple[str, str]]:
    known: dict[str, tuple[str, str]] = {}
    for field in FIELDS:
        known[squeezed(field.name)] = (field.name, "")
        for alias in field.aliases:
            key, _, word = alias.partition(" > ")
            known.setdefault(squeezed(key), (field.name, word))
    return known


_KNOWN = _aliases()
_UNUSED = frozenset(squeezed(word) for word in UNUSED)


def find_field(key: str) -> tuple[str, str] | None:
    """The field that a key means, and what else the key says (``ll``, ``delta``, ``peak`` ...), or None."""
    found = _KNOWN.get(squeezed(key))
    if found is None and "." in key:  # of a TOML table: [filter] L_1, [capacitor] connection
        parts = key.split(".")
        found = _KNOWN.get(squeezed(" ".join(parts[-2:]))) or _KNOWN.get(squeezed(parts[-1]))
    return found


def is_unused(key: str) -> bool:
    """Whether a key is one of the rows that no study needs."""
    words = {squeezed(word) for word in re.split(r"[\s_.]+", key)}
    return squeezed(key) in _UNUSED or bool(words & _UNUSED)


def advice_for(key: str) -> str:
    """Advice for an unknown key."""
    near = nearest(squeezed(key.rpartition(".")[2]), _KNOWN)
    if near is not None:
        return f"Did you mean {_KNOWN[near][0]}?"
    return "Take the row out, or give it one of these names: " + ", ".join(BY_NAME) + "."


_SAME_RANGE = "min_max: simulated as min-max injection, which has the same voltage range"

MODULATIONS = {
    **dict.fromkeys(
        ("spwm", "sinetriangle", "sinusoidal", "sinusoidalpwm", "sine", "sinepwm", "naturalsampling", "sinedreieck",
         "sinusdreieck", "sinetrianglepwm"),
        "sine_triangle",
    ),
    **dict.fromkeys(
        ("svpwm", "svm", "spacevector", "spacevectormodulation", "spacevectorpwm", "minmax", "minmaxinjection",
         "zerosequence", "zerosequenceinjection", "commonmodeinjection", "symmetricalpwm", "raumzeiger",
         "raumzeigermodulation", "spacevectormodulationsvm", "spacevectorpwmsvpwm", "centeredsvpwm", "svpwmminmax"),
        "min_max",
    ),
    **dict.fromkeys(
        ("thirdharmonic", "thirdharmonicinjection", "3rdharmonic", "3rdharmonicinjection", "thipwm", "thi",
         "spwmwiththirdharmonicinjection", "spwm3rdharmonic", "spwmthirdharmonic", "discontinuous", "discontinuouspwm",
         "dpwm", "dpwm1", "dpwmmin", "dpwmmax", "flattop", "dritteharmonische"),
        _SAME_RANGE,
    ),
}  # fmt: skip
"""Words without spaces and special characters, and the study's modulation, with a remark after a colon."""

CONNECTIONS = {
    **dict.fromkeys(("star", "wye", "y", "yn", "stern", "groundedwye", "starconnected", "wyeconnected"), "star"),
    **dict.fromkeys(("delta", "δ", "∆", "d", "triangle", "dreieck", "mesh", "deltaconnected"), "delta"),
}

FILTERS = {
    "lc": "LC",
    "lcl": "LCL",
    "lcfilter": "LC",
    "lclfilter": "LCL",
    "lctransformer": "LCL",
    "lcandtransformer": "LCL",
}

_TIMES = {
    **dict.fromkeys(("once", "single", "singleupdate", "oncepercarrier", "symmetric", "symmetrical", "einfach",
                     "oncepercarrierperiod", "symmetricregular", "1percarrier", "1x", "1xcarrier"), 1),
    **dict.fromkeys(("twice", "double", "doubleupdate", "twicepercarrier", "asymmetric", "asymmetrical", "zweifach",
                     "twicepercarrierperiod", "asymmetricregular", "2percarrier", "2x", "peakandvalley", "doppelt"), 2),
}  # fmt: skip

_PER_PERIOD = re.compile(
    r"\s*(?:(?:samples?|times|updates?|x)\b)?\s*(?:/|\bper\b|\bpro\b)\s*(?:(?:the|one|each|carrier|switching|pwm)\s*)*"
    r"(?:carrier|period|cycle|periode)?\s*$|\s*\b(?:samples|times|updates)\s*$",
    re.IGNORECASE,
)
"""What a number of samples in a carrier period is followed by."""

_NO_DELAY = ("none", "no", "zero", "nodelay", "immediate", "keine", "without")
_ONE_DELAY = (
    "one",
    "onesample",
    "1sample",
    "oneperiod",
    "1period",
    "yes",
    "onestep",
    "1ts",
    "ts",
    "onesamplingperiod",
    "1samplingperiod",
    "einabtastschritt",
    "1step",
)
_SAMPLES = re.compile(r"\s*[·*]?\s*(?:T_?s|samples?|(?:sampling )?periods?|steps?|Abtastschritte?)\s*$", re.I)


def _squeezed(text: str) -> str:
    return re.sub(r"[\W_]", "", text).casefold() or text.strip().casefold()


def chosen(text: str, known: dict[str, str]) -> tuple[str | None, str]:
    """The meaning of a word, or None with advice."""
    key = _squeezed(text)
    if key in known:
        return known[key], ""
    short = sorted({min((k for k in known if known[k] == v), key=len) for v in known.values()})
    return None, did_you_mean(key, known, f"Known are among others: {', '.join(short)}.", 0.7)


def read_sampling(text: str, unit: str, f_sw: float, decimal_comma: bool) -> int:
    """Samples per carrier period from a word, a number, a frequency or a period. Raises AmountError."""
    text, unit = _PER_PERIOD.sub("", text), "" if _PER_PERIOD.fullmatch(unit) else unit
    key = _squeezed(text)
    if key in _TIMES:
        return _TIMES[key]
    amount = read_amount(text, ("1", "Hz", "s"), unit=unit, decimal_comma=decimal_comma)
    value = amount.value
    if amount.base == "1" and value > 64:
        value, base = value / f_sw, "Hz"  # a bare sampling frequency
    elif amount.base == "Hz":
        value, base = value / f_sw, "Hz"
    elif amount.base == "s":
        value, base = 1.0 / (value * f_sw) if value > 0.0 else 0.0, "s"
    else:
        base = "1"
    if math.isnan(f_sw):  # it is faulty and has its own fault
        return 2
    if abs(value - round(value)) > 1e-3 * max(value, 1.0) or not 1 <= round(value) <= 64:
        raise AmountError(
            f"is {value:.4g} samples per carrier" if base != "1" else "is no number of samples per carrier",
            "Give a whole number from 1 to 64, once, twice, or a whole multiple of the carrier frequency.",
        )
    return round(value)


def read_delay(raw: object, unit: str, decimal_comma: bool) -> tuple[int, str]:
    """Samples of computation delay, 0 or 1, and how they were read. Raises AmountError."""
    text = str(raw).strip()
    key = _squeezed(text)
    if key in _NO_DELAY:
        return 0, ""
    if key in _ONE_DELAY:
        return 1, ""
    unit = "" if _SAMPLES.fullmatch(unit) else unit
    value = read_amount(_SAMPLES.sub("", text), ("1",), unit=unit, decimal_comma=decimal_comma).value
    if value in (0.0, 1.0):
        return int(value), ""
    if value in (0.5, 1.5):
        return int(value - 0.5), f"{value:.1f} T_s with the half sample of the PWM, which the bridge has by itself"
    raise AmountError("is neither 0 nor 1 sample", "Other delays are not modelled; take the nearest and its margins.")
