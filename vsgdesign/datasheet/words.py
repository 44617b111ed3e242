"""Fields whose values are words: PWM, connection, filter, sampling and delay, as people write them."""

from __future__ import annotations

import math
import re

from vsgdesign.datasheet.quantities import AmountError, read_amount
from vsgdesign.errors import did_you_mean

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
    key = _squeezed(text)
    if key in _TIMES:
        return _TIMES[key]
    amount = read_amount(
        re.sub(r"\bper carrier.*$", "", text), ("1", "Hz", "s"), unit=unit, decimal_comma=decimal_comma
    )
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
