"""Quantities as datasheets print them: ``12,5 kVA``, ``480 V L-L``, ``1.5…20``, ``3 x 50 µF (delta)``, ``450 A rms``.

The quantities of a study file follow stricter rules (parameters.reader). Values that are read here are written there
in that form.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from vsgdesign.errors import VsgDesignError
from vsgdesign.study.parameters.reader import format_quantity

RATIO = "1"
"""The base of a plain number, a percentage or a value in per unit."""

_PREFIXES = {"": 1.0, "p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}

_SPELT = {
    "volts": "V", "volt": "V", "amperes": "A", "ampere": "A", "amps": "A", "amp": "A", "hertz": "Hz", "watts": "W",
    "watt": "W", "henries": "H", "henry": "H", "farads": "F", "farad": "F", "ohms": "ohm", "Ω": "ohm",
    "VAr": "var", "VAR": "var", "Var": "var",
}  # fmt: skip

_WORDS = {
    "ac": "", "dc": "", "vac": "", "rms": "rms", "eff": "rms", "pk": "peak", "peak": "peak", "p": "peak",
    "ll": "ll", "linetoline": "ll", "line": "ll", "phasetophase": "ll", "phph": "ll", "delta": "delta", "d": "delta",
    "triangle": "delta", "dreieck": "delta", "ln": "ln", "linetoneutral": "ln", "phasetoneutral": "ln", "phn": "ln",
    "phase": "ln", "perphase": "", "each": "", "star": "star", "wye": "star", "y": "star", "stern": "star",
    "3ph": "", "3phase": "", "threephase": "", "3": "", "nominal": "", "nom": "", "rated": "", "max": "", "typ": "",
    "connected": "", "connection": "", "in": "", "the": "", "pu": "pu", "short": "", "circuit": "",
    "of": "", "current": "", "lagging": "", "leading": "", "lag": "", "lead": "", "ind": "", "cap": "",
}  # fmt: skip
"""Words that may follow a unit, and their meaning."""

_PHRASES = (
    (r"line\s*[- ]?to\s*[- ]?line", "ll"),
    (r"phase\s*[- ]?to\s*[- ]?phase", "ll"),
    (r"\bl\s*-\s*l\b", "ll"),
    (r"line\s*[- ]?to\s*[- ]?neutral", "ln"),
    (r"phase\s*[- ]?to\s*[- ]?neutral", "ln"),
    (r"\bl\s*-\s*n\b", "ln"),
    (r"\bph\s*-\s*ph\b", "ll"),
    (r"\bph\s*-\s*n\b", "ln"),
    (r"per\s+phase", "perphase"),
    (r"3\s*-?\s*(?:phase|ph|~|φ)", "3ph"),
    (r"three\s*-?\s*phase", "3ph"),
    (r"[Δ∆]", " delta "),
    (r"δ", " delta "),
)

_DIGITS = r"[-+−]?(?:\d[\d\s.,'’]*\d|\d|[.,]\d+)(?:[eE][-+−]?\d+)?"
_VALUE = re.compile(rf"^\s*({_DIGITS})\s*(.*?)\s*$")
_LEADING = re.compile(r"^\s*(?:(?:approx\.?|approximately|about|ca\.?|typ\.?|max\.?|nominal|rated|[~≈≤<=])\s*)+", re.I)
_LEAST = re.compile(r"^\s*(?:>=?|≥|at least|not less than|from|min(?:imum)?\b\.?)\s*(?=[\d.,])", re.I)
_MOST = re.compile(r"^\s*(?:<=?|≤|at most|not more than|up to|max(?:imum)?\b\.?)\s*(?=[\d.,])", re.I)
_TOLERANCE = re.compile(r"\s*(?:±|\+\s*/?\s*[-−])\s*[\d.,]+\s*%?\s*$")
_RANGE = re.compile(r"\s*(?:\.{2,3}|…|–|—|\bto\b|\bbis\b|(?<=[^eE(\s])\s*-(?=\s*[\d.,])|(?<=\w)\s+-\s+(?=\d))\s*", re.I)


class AmountError(VsgDesignError):
    """A text cannot be read as a quantity. The message says what is wrong and what to do."""

    def __init__(self, problem: str, advice: str = "") -> None:
        self.problem = problem
        self.advice = advice
        super().__init__(f"{problem}. {advice}".strip())


@dataclass(frozen=True)
class Amount:
    """One value, or both ends of a range, in the SI unit ``base`` (or as a ratio), and the words that followed it."""

    values: tuple[float, ...]
    base: str
    words: frozenset[str]
    bare: bool = False
    """Whether no unit was given."""

    @property
    def value(self) -> float:
        """The value, if it is not a range."""
        return self.values[0]


def read_amount(
    text: str | float, bases: tuple[str, ...], *, unit: str = "", decimal_comma: bool = False, ranged: bool = False
) -> Amount:
    """Read a text in one of some units (``V``, ``VA``, ``W``, ``var``, ``Hz``, ``H``, ``F``, ``ohm``, ``A``, ``1``).

    ``unit`` is the content of a column of units; a unit in the text itself has priority. A number without a unit is
    in the first of ``bases``. With ``decimal_comma`` the file is known to write 1,5. Where a range may stand, a single
    value may be said to be its ``least`` or ``most``. Raises AmountError.
    """
    if isinstance(text, int | float):
        text = repr(float(text))
    body, side = _side(_plain(text)) if ranged else (_plain(text), frozenset())
    body = _TOLERANCE.sub("", _LEADING.sub("", body)).strip("[]; ")
    parts = _RANGE.split(body) if ranged else [body]
    if ranged and len(parts) == 1 and body.count(",") == 1 and re.fullmatch(r"\s*[\d.]+\s*,\s+[\d.]+\s*", body):
        parts = body.split(",")
    if len(parts) > 2 or not all(parts):
        raise AmountError("is not a value or a range", "Write for example 1.5 to 20.")
    found = [_one(part, decimal_comma) for part in parts]
    units = [written for _, written in found]
    if len(units) == 2 and not units[0]:
        units[0] = units[1]
    units = [written or _plain(unit) for written in units]
    values, read = [], []
    for (number, _), written in zip(found, units, strict=True):
        base, factor, words = _unit(written, bases)
        read.append((base, words))
        values.append(float(f"{number * factor:.15g}"))  # 20 uF is 2e-5, not 1.9999999999999998e-5
    if len(read) == 2 and read[0][0] != read[1][0]:
        raise AmountError("its two ends are in different units", "Give both in the same unit.")
    if not all(math.isfinite(value) for value in values):
        raise AmountError("must be a finite number")
    words = side if len(values) == 1 else frozenset()
    return Amount(tuple(values), read[0][0], words.union(*(words for _, words in read)), not any(units))


def _side(text: str) -> tuple[str, frozenset[str]]:
    """A text without what makes it one end of a range, such as ≥ or "at most", and which end it is."""
    for pattern, word in ((_LEAST, "least"), (_MOST, "most")):
        if pattern.match(text):
            return pattern.sub("", text), frozenset({word})
    return text, frozenset()


_ANGULAR = re.compile(r"\s*(?:rad|deg|°|rev|1)?\s*/\s*(?:s|sec|min)\s*|\s*(?:rpm|s-1|min-1)\s*", re.I)
"""Units of a speed of rotation. No field has one, and none may be taken for a remark."""


def is_unit(text: str) -> bool:
    """Whether a text is a unit of any field, as in a column of units; also one that no field has, such as rad/s."""
    if _ANGULAR.fullmatch(text):
        return True
    try:
        read_amount(f"1 {text}", ("V", "VA", "W", "var", "Hz", "H", "F", "ohm", "A", "s", "Wh", "J", RATIO))
    except AmountError:
        return False
    return bool(text.strip()) and not re.match(r"\s*[\d.,+-]", text)


def _plain(text: str) -> str:
    """Text with one kind of space, minus, micro, ohm and multiplication sign."""
    text = re.sub(r"[\u00a0\u2007\u2009\u202f]", " ", text)
    for written, plain in (("\u03bc", "u"), ("\u00b5", "u"), ("\u2212", "-"), ("\u2126", "Ω")):
        text = text.replace(written, plain)
    return re.sub(r"^\s*3\s*[x×*]\s*(?=\d)", "", text)


def _one(text: str, decimal_comma: bool) -> tuple[float, str]:
    match = _VALUE.match(text)
    if match is None:
        raise AmountError("is not a number with a unit")
    return read_number(match[1], decimal_comma), match[2]


def read_number(text: str, decimal_comma: bool = False) -> float:
    """A number with a decimal point or comma, and any separator between its thousands. Raises AmountError."""
    mantissa, *exponent = re.split("[eE]", re.sub(r"[\s'’]", "", text))
    commas, points = mantissa.count(","), mantissa.count(".")
    if commas and points:
        decimal = max(",.", key=mantissa.rfind)
        mantissa = mantissa.replace("," if decimal == "." else ".", "").replace(decimal, ".")
    elif commas + points > 1:
        mantissa = mantissa.replace(",", "").replace(".", "")
    elif commas or points:
        sign = "," if commas else "."
        thousands = re.fullmatch(rf"[-+]?[1-9]\d{{0,2}}\{sign}\d{{3}}", mantissa)
        if thousands and (sign == ",") is not decimal_comma:
            raise AmountError(
                "may be a thousand or a decimal fraction",
                f"Write {mantissa.replace(sign, '')} or {mantissa.replace(sign, '.')}0.",
            )
        mantissa = mantissa.replace(",", ".")
    try:
        return float(mantissa + ("e" + exponent[0] if exponent else ""))
    except ValueError:
        raise AmountError("is not a number") from None


def _unit(text: str, bases: tuple[str, ...]) -> tuple[str, float, frozenset[str]]:
    """Base, factor to the base, and what else the unit says."""
    rest = text.strip()
    for pattern, word in _PHRASES:
        rest = re.sub(pattern, f" {word} ", rest, flags=re.IGNORECASE)
    rest = re.sub(r"\bp\.\s?u\.?|\bper[- ]unit\b", "pu", rest.strip(), flags=re.IGNORECASE)
    rest = re.sub(r"\b(?:percent|pct|prozent)\b", "%", rest, flags=re.IGNORECASE)
    for spelt, symbol in _SPELT.items():
        rest = re.sub(rf"(?<![A-Za-z]){spelt}\b" if len(spelt) > 3 else re.escape(spelt), symbol, rest)
    if not rest:
        return bases[0], 1.0, frozenset()
    if RATIO in bases:
        for name, factor in (("%", 0.01), ("pu", 1.0)):
            if rest.casefold().startswith(name):
                return RATIO, factor, _words(rest[len(name) :], text) | {"pu"}
    for base in sorted(bases, key=len, reverse=True):
        for prefix, factor in _PREFIXES.items():
            head = prefix + base
            if (
                base != RATIO
                and rest.startswith(prefix)
                and rest[len(prefix) : len(head)].casefold() == base.casefold()
            ):
                tail = rest[len(head) :]
                if not tail or _known(tail) is not None:
                    return base, factor, _words(tail, text)
    words = _known(rest)
    if words is not None:  # no unit, only words: 0.05 per phase
        return bases[0], 1.0, words
    raise AmountError(f'"{text.strip()}" is not a unit of this field', f"Give it in {_named(bases)}.")


def _known(tail: str) -> frozenset[str] | None:
    """The meaning of some words, or None if one of them is unknown."""
    words = re.findall(r"[a-z0-9]+", tail.casefold())
    return frozenset(_WORDS[word] for word in words) - {""} if all(word in _WORDS for word in words) else None


def _words(tail: str, text: str) -> frozenset[str]:
    words = _known(tail)
    if words is None:
        raise AmountError(f'cannot tell what "{text.strip()}" means', "Write the number and its unit alone.")
    return words


def _named(bases: tuple[str, ...]) -> str:
    shown = {
        "H": "H, mH or uH",
        "F": "F, mF or uF",
        "ohm": "ohm or mohm",
        "1": "pu or %",
        "V": "V or kV",
        "VA": "VA, kVA or MVA",
        "W": "kW or MW",
        "Hz": "Hz or kHz",
        "A": "A or kA",
        "var": "kvar",
        "s": "s or us",
        "Wh": "Wh or kWh",
        "J": "J or kJ",
    }
    return ", ".join(shown[base] for base in bases)


def other_prefix(value: float, base: str, low: float, high: float) -> str:
    """What the value would be with another prefix, if this lies within the limits."""
    for factor in (1e-3, 1e3, 1e-6, 1e6, 1e-9, 1e9):
        if low <= value * factor <= high:
            return f"Did you mean {format_quantity(value * factor, base)}?"
    return "Check the value and its unit."
