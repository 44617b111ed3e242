"""From rows as people write them to a converter in SI, with all faults at once and every assumption listed."""

from __future__ import annotations

import math

from vsgdesign.datasheet.converter_sheet import Datasheet
from vsgdesign.datasheet.filter_parts import check_resonance, read_capacitor, read_inductor, read_outer, read_resistance
from vsgdesign.datasheet.grids import DEFAULT_X_OVER_R, read_range, read_scr, strongest_inductance
from vsgdesign.datasheet.quantities import RATIO
from vsgdesign.datasheet.ratings import (
    check_voltages,
    read_current_limit,
    read_dc_link,
    read_delay_samples,
    read_frequency,
    read_modulation,
    read_rating,
    read_samples,
    read_voltage,
)
from vsgdesign.datasheet.reading import Sheet
from vsgdesign.datasheet.rows import Rows
from vsgdesign.datasheet.words import FILTERS
from vsgdesign.errors import Fault, StudyError
from vsgdesign.frames import base_impedance, linear_modulation_limit, ll_to_phase, rms_to_peak
from vsgdesign.parameters.inner_loops import ENOUGH_SAMPLING
from vsgdesign.parameters.units import format_quantity

INDUCTOR_X_OVER_R = 30.0
"""X/R of an inductor whose resistance is not given: large, so that it adds little damping to the loops."""

_LITTLE_HEADROOM = 1.1
"""Smallest ratio of the bridge voltage to the rated voltage."""


def resolve(sheet: Sheet) -> Datasheet:
    """The converter of a datasheet. Raises StudyError with all its faults."""
    rows = Rows(sheet)
    S = read_rating(rows)
    V = read_voltage(rows)
    f_n = read_frequency(rows)
    Z, omega = base_impedance(S, ll_to_phase(V)), 2.0 * math.pi * f_n
    V_dc = read_dc_link(rows)
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
        notes=_notes(V, V_dc, modulation, f_sw * samples, delay, L_1, C, outer),
        remarks=rows.remarks, assumptions=tuple(rows.assumptions), unused=tuple(rows.unused),
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


def faults_of(sheet: Sheet) -> list[Fault]:
    """The faults of a datasheet, also of one that is not complete."""
    try:
        resolve(sheet)
    except StudyError as error:
        return list(error.faults)
    return []
