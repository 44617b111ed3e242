"""The same fields, asked one after another: the next question, and what is wrong with an answer."""

from __future__ import annotations

from collections.abc import Sequence

from vsgdesign.datasheet.fields import BY_NAME, Field
from vsgdesign.datasheet.quantities import AmountError, read_amount
from vsgdesign.datasheet.reading import Entry, Sheet
from vsgdesign.datasheet.resolving import faults_of
from vsgdesign.errors import Fault

_ORDER = (
    "rating", "power_factor", "voltage", "frequency", "pwm", "dc_link", "carrier", "sampling", "delay", "current_limit",
    "L_1", "R_1", "C", "capacitor_connection", "R_c", "L_2", "transformer", "R_2", "scr", "x_over_r", "title", "source",
)  # fmt: skip

TERMINAL = "the terminal"


def next_question(answers: Sequence[Entry], asked: Sequence[str]) -> Field | None:
    """The field to ask for next, given the answers and the questions so far; None if there is no further question."""
    given = {entry.key: str(entry.value) for entry in answers}
    for name in _ORDER:
        if name in asked:
            continue
        if name == "power_factor" and not _reads(given.get("rating", ""), "W"):
            continue
        if name == "capacitor_connection" and not _needs_connection(given.get("C", "")):
            continue
        if name == "R_2" and not {"L_2", "transformer"} & given.keys():
            continue
        return BY_NAME[name]
    return None


def answer_faults(answers: Sequence[Entry], answer: Entry) -> list[Fault]:
    """What is wrong with one more answer, by itself or together with the earlier answers."""
    before = {str(fault) for fault in faults_of(Sheet(TERMINAL, tuple(answers), decimal_comma=_comma(answers)))}
    after = faults_of(Sheet(TERMINAL, (*answers, answer), decimal_comma=_comma([*answers, answer])))
    return [fault for fault in after if str(fault) not in before and fault.problem != "missing"]


def entry_of(field: Field, text: str) -> Entry:
    """An answer as a row. The strength of the grids may also be given as a power or an impedance."""
    name = field.name
    if name == "scr":
        for other, base in (("short_circuit_power", "VA"), ("grid_impedance", "ohm")):
            if _reads(text, base, ranged=True):
                name = other
    return Entry(name, text, "", name)


def answered_sheet(answers: Sequence[Entry]) -> Sheet:
    """All answers as a datasheet."""
    return Sheet(TERMINAL, tuple(answers), decimal_comma=_comma(answers))


def _comma(answers: Sequence[Entry]) -> bool:
    return any("," in str(entry.value) and "." not in str(entry.value) for entry in answers)


def _reads(text: str, base: str, ranged: bool = False) -> bool:
    try:
        amount = read_amount(text, (base,), decimal_comma=True, ranged=ranged)
    except AmountError:
        return False
    return not amount.bare


def _needs_connection(text: str) -> bool:
    """Whether C was given in farads without saying star or delta."""
    try:
        amount = read_amount(text, ("F", "var", "1"), decimal_comma=True)
    except AmountError:
        return False
    return amount.base == "F" and not {"star", "delta"} & amount.words
