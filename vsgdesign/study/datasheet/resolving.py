"""From rows, or answers to questions, to a converter in SI: all faults at once and every assumption listed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from vsgdesign.equations.frames import base_impedance, linear_modulation_limit, ll_to_phase, rms_to_peak
from vsgdesign.equations.grid import largest_current_after_jump
from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.datasheet.fields import BY_NAME, FILTERS, Field
from vsgdesign.study.datasheet.measured_impedance import SeriesFit
from vsgdesign.study.datasheet.quantities import RATIO, AmountError, read_amount
from vsgdesign.study.datasheet.ratings import (
    DEFAULT_X_OVER_R,
    check_resonance,
    check_voltages,
    read_capacitor,
    read_current_limit,
    read_dc_link,
    read_delay_samples,
    read_frequency,
    read_inductor,
    read_modulation,
    read_outer,
    read_range,
    read_rating,
    read_resistance,
    read_samples,
    read_scr,
    read_voltage,
    strongest_inductance,
)
from vsgdesign.study.datasheet.reading import Assumption, Entry, Rows, Sheet
from vsgdesign.study.parameters.inner_loops import ENOUGH_SAMPLING
from vsgdesign.study.parameters.reader import format_quantity

INDUCTOR_X_OVER_R = 30.0
"""X/R of an inductor whose resistance is not given: large, so that it adds little damping to the loops."""

_JUMP_DEG = 60.0
_LITTLE_HEADROOM = 1.1
"""Smallest ratio of the bridge voltage to the rated voltage."""


@dataclass(frozen=True, kw_only=True)
class Datasheet:
    """Everything that a study of a converter needs, in SI, and where each value comes from."""

    title: str
    source: str
    S_rated: float
    V_rated_ll_rms: float
    f_n: float
    V_dc: float
    f_sw: float
    samples_per_carrier: int
    delay_samples: int
    modulation: str
    """``sine_triangle`` or ``min_max``."""
    current_limit_pu: float
    L_1: float
    R_1: float
    C: float
    """Per phase in star, F."""
    R_c: float
    """In series with each star capacitor."""
    L_2: float
    """0: an LC filter."""
    R_2: float
    scr: tuple[float, float]
    """Smallest and largest short-circuit ratio of its grids, on the impedance."""
    x_over_r: tuple[float, float]
    remarks: dict[str, str]
    """How a field was read, if the datasheet writes it differently from a study."""
    assumptions: tuple[Assumption, ...]
    notes: tuple[str, ...]
    """Facts that a user should know before anything is designed."""
    unused: tuple[str, ...]
    """Rows of the datasheet that no study needs."""
    measured: SeriesFit | None = None
    """The measured impedance of its grids, where there is one."""
    dc: DcSheet | None = None
    """The dc side; None: the link is ideal."""


def resolve(sheet: Sheet) -> Datasheet:
    """The converter of a datasheet. Raises StudyError with all its faults."""
    rows = Rows(sheet)
    S = read_rating(rows)
    V = read_voltage(rows)
    f_n = read_frequency(rows)
    Z, omega = base_impedance(S, ll_to_phase(V)), 2.0 * math.pi * f_n
    V_dc = read_dc_link(rows)
    dc = read_dc_side(rows, S, V_dc)
    modulation = read_modulation(rows)
    check_voltages(rows, V, V_dc, modulation)
    f_sw = rows.plain("carrier", "Hz", math.nan)
    samples = read_samples(rows, f_sw, f_n)
    delay = read_delay_samples(rows)
    limit = read_current_limit(rows, S, V)
    kind = rows.word("filter", FILTERS)
    q = rows.plain("inductor_x_over_r", RATIO, INDUCTOR_X_OVER_R)
    L_1 = read_inductor(rows, "L_1", Z, omega)
    R_1 = read_resistance(rows, "R_1", "L_1", L_1 * omega / q, Z, q)
    C, R_c = read_capacitor(rows, Z, omega, V)
    L_2, R_2 = read_outer(rows, kind, Z, omega, q)
    check_resonance(rows, L_1, C, 1.0 / (f_sw * samples) if samples else math.nan)
    scr = read_scr(rows, S, V)
    x_over_r = read_range(rows, "x_over_r", DEFAULT_X_OVER_R)
    title, source = rows.text("title"), rows.text("source")
    if rows.faults:
        raise StudyError(sheet.source, rows.faults)
    if not title:
        rated, voltage = format_quantity(float(f"{S:.4g}"), "VA"), format_quantity(float(f"{V:.4g}"), "V")
        title = f"{rated}, {voltage}, {f_n:.4g} Hz converter"
    outer = L_2 + strongest_inductance(scr, x_over_r, Z, omega)
    return Datasheet(
        title=title, source=source, S_rated=S, V_rated_ll_rms=V, f_n=f_n, V_dc=V_dc, f_sw=f_sw,
        samples_per_carrier=samples, delay_samples=delay, modulation=modulation, current_limit_pu=limit,
        L_1=L_1, R_1=R_1, C=C, R_c=R_c, L_2=L_2, R_2=R_2, scr=scr, x_over_r=x_over_r,
        notes=(
            *_notes(V, V_dc, modulation, f_sw * samples, delay, L_1, C, outer),
            _jump_note(limit, omega * (delay + 1) / (f_sw * samples), omega * L_1 / Z),
        ),
        remarks=rows.remarks, assumptions=tuple(rows.assumptions), unused=tuple(rows.unused), dc=dc,
    )  # fmt: skip


def _notes(
    V: float, V_dc: float, modulation: str, f_s: float, delay: int, L_1: float, C: float, outer: float
) -> tuple[str, ...]:
    """Facts that make a converter difficult to control, told before the design begins. ``outer``: L_2 and the
    smallest L_g, H.
    """
    notes = []
    resonance = math.sqrt((L_1 + outer) / (L_1 * outer * C)) / (2.0 * math.pi)
    if delay and f_s < ENOUGH_SAMPLING * resonance:
        notes.append(
            f"the controller samples {f_s / resonance:.3g} times in a period of the filter's highest resonance "
            f"({resonance:.4g} Hz on the strongest grid); below {ENOUGH_SAMPLING:g} inner loops are hard to damp. "
            "Twice the sampling, no delay or a larger L_2 helps"
        )
    headroom = linear_modulation_limit(V_dc, modulation == "min_max") / rms_to_peak(ll_to_phase(V))
    if headroom < _LITTLE_HEADROOM:
        notes.append(
            f"the bridge makes at most {headroom:.3g} times the rated voltage; weak grids and inductive power need more"
        )
    return tuple(notes)


def _jump_note(limit_pu: float, turn: float, X_1: float) -> str:
    """What a jump of the grid's phase may do, by hand. ``turn``: ω (d + 1) T_s, rad; ``X_1`` in pu."""
    bound = float(largest_current_after_jump(limit_pu, math.radians(_JUMP_DEG), turn, X_1))
    return (
        f"a phase jump of {_JUMP_DEG:g} deg may make a current of up to {bound:.3g} pu by hand, beside a limit of "
        f"{limit_pu:.3g} pu: its voltage drives it through L_1 until the bridge answers; vsgdesign inner simulates this"
    )


def faults_of(sheet: Sheet) -> list[Fault]:
    """The faults of a datasheet, also of one that is not complete."""
    try:
        resolve(sheet)
    except StudyError as error:
        return list(error.faults)
    return []


_ORDER = (
    "rating", "power_factor", "voltage", "frequency", "pwm", "dc_link", "carrier", "sampling", "delay", "current_limit",
    "L_1", "R_1", "C", "capacitor_connection", "R_c", "L_2", "transformer", "R_2", "scr", "x_over_r",
    "dc_power", "dc_charge_power", "dc_capacitor", "dc_energy", "title", "source",
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
        if name in ("dc_charge_power", "dc_capacitor", "dc_energy") and "dc_power" not in given:
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


STORED_S = 0.01
"""What a capacitor that is not given stores, as a time at the rated power, s."""

_SECONDS_AN_HOUR = 3600.0


@dataclass(frozen=True, kw_only=True)
class DcSheet:
    """A source behind a dc–dc stage, in SI."""

    power: float
    """Largest power that it gives, W."""
    charge_power: float
    """Largest power that it takes, W."""
    C: float
    """Of the link, F."""
    energy: float | None
    """Usable energy, J; None: without a limit."""


def read_dc_side(rows: Rows, S: float, V_dc: float) -> DcSheet | None:
    """The dc side; None where the datasheet has no power of a source: the link is ideal. Its other rows are then listed
    as not used."""
    own = ("dc_charge_power", "dc_capacitor", "dc_energy")
    if "dc_power" not in rows.given:
        rows.unused += [rows.given[name].key for name in own if name in rows.given]
        return None
    power = _of(rows, "dc_power", ("W", "VA"), S)
    taken = 0.0
    if "dc_charge_power" in rows.given:
        taken = _of(rows, "dc_charge_power", ("W", "VA"), S)
    else:
        rows.assume("dc_charge_power", "none: the source takes no power from the grid")
    second = 2.0 * S / (V_dc * V_dc)  # what stores the rating for a second
    C = STORED_S * second
    if "dc_capacitor" in rows.given:
        C = _of(rows, "dc_capacitor", ("F",), second)
    elif math.isfinite(C):
        C = float(f"{C:.3g}")
        shown = format_quantity(C, "F")
        rows.assume(
            "dc_capacitor", f"{shown}, which stores {STORED_S * 1e3:g} ms of the rating; size finds the least one"
        )
    energy = None
    if "dc_energy" in rows.given:
        energy = _of(rows, "dc_energy", ("Wh", "J"), S)
    else:
        rows.assume("dc_energy", "without a limit")
    rows.assume("dc source", "behind a dc-dc stage that follows with 5 ms, and half full at the start")
    return DcSheet(power=power, charge_power=taken, C=C, energy=energy)


def _of(rows: Rows, name: str, bases: tuple[str, ...], scale: float) -> float:
    """A row in SI, within its limits times ``scale``; NaN where it is faulty."""
    amount = rows.amount(name, bases)
    if amount is None:
        return math.nan
    value = amount.value * (_SECONDS_AN_HOUR if amount.base == "Wh" else 1.0)
    return rows.within(name, value, {"Wh": "J", "VA": "W"}.get(amount.base, amount.base), scale)
