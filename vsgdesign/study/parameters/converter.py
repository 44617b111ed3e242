"""A converter with its filter: ratings, sampled bridge, limits; the sections [converter] and [filter]."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.equations.frames import (
    base_impedance,
    linear_modulation_limit,
    ll_to_phase,
    rated_current_rms,
    rms_to_peak,
)
from vsgdesign.equations.limiters import CIRCULAR, LIMITERS, LimiterParameter, LimiterRatings
from vsgdesign.equations.power_loops import References
from vsgdesign.errors import Fault
from vsgdesign.study.parameters.fields import (
    C_BASE,
    F_N,
    L_BASE,
    MOST_REFERENCE,
    S_RATED,
    T_S,
    V_MAX,
    V_MIN,
    V_RATED,
    Z_BASE,
    Field,
    Times,
    fields_of,
    inserted,
    number,
    picked,
    read,
    section,
    subtable,
    values,
    whole,
    word,
)
from vsgdesign.study.parameters.reader import TableReader, format_quantity

UNLIMITED_PU = 1e6
"""A current limit so far out of reach that the limiter never acts (infinity would make NaN of 0·∞)."""


_V_LL, _V_PHASE = "required, or `V_rated_rms`", "required, or `V_rated_ll_rms`"


def current_limit(**more: str) -> Any:
    """The field of a current limit in pu of the rated peak."""
    return number("1", 0.5, 20.0, default=None, name="current_limit_pu", **more)


@section
class Converter:
    """Ratings and the sampled bridge."""

    S_rated: float = number("VA", 10.0, 1e10)
    """Rating, base of all pu."""
    V_rated_rms: float = number("V", 5.0, 5e5, shown=_V_PHASE)
    """Rated phase-to-neutral voltage."""
    omega_n: float = number("Hz", 10.0, 1000.0, name="f_n", scale=2.0 * math.pi)
    """Nominal frequency."""
    V_dc: float = number("V", 10.0, 1e6)
    """DC link, ideal."""
    f_sw: float = number("Hz", 300.0, 1e6)
    """Carrier frequency."""
    samples_per_carrier: int = whole(1, 64, default=2)
    """Controller samples in a carrier period, so T_s = 1/(f_sw · samples_per_carrier)."""
    delay_samples: int = whole(0, 1, default=1)
    """Samples between measuring and applying; 0 as in the published model."""
    zero_sequence: bool = word(("sine_triangle", "min_max"), default="sine_triangle", name="modulation", true="min_max")
    """Bridge limit V_dc/2, or V_dc/√3 with zero sequence."""
    current_limit_pu: float | None = current_limit(shown="no limit")
    """Limit of the converter-current reference, pu of the rated peak."""
    V_min_pu: float = number("1", 0.0, 1.0, default=0.85)
    """Operating points below are flagged."""
    V_max_pu: float = number("1", 1.0, 3.0, default=1.25)
    """Operating points above are flagged."""

    @property
    def T_s(self) -> float:
        """Sampling period of the controller, s."""
        return 1.0 / (self.f_sw * self.samples_per_carrier)

    @property
    def Z_base(self) -> float:
        """Base impedance, Ω."""
        return base_impedance(self.S_rated, self.V_rated_rms)

    @property
    def I_rated_pk(self) -> float:
        """Rated phase current, A peak."""
        return rms_to_peak(rated_current_rms(self.S_rated, self.V_rated_rms))

    @property
    def V_limits_rms(self) -> tuple[float, float]:
        """Least and largest phase voltage that is not flagged, V rms."""
        return self.V_min_pu * self.V_rated_rms, self.V_max_pu * self.V_rated_rms

    def references(self, P_ref: float = 0.0, Q_ref: float = 0.0) -> References:
        """Set points of the power loops, W and var, at nominal frequency and rated voltage."""
        return References(P_ref, Q_ref, self.omega_n, self.V_rated_rms)

    @property
    def v_max_pk(self) -> float:
        """Bridge-voltage limit, V peak."""
        return linear_modulation_limit(self.V_dc, self.zero_sequence)


_LCL = "required for `LCL`"


@section
class Filter:
    """LC or LCL filter. An LC filter has L_2 = R_2 = 0."""

    L_1: float = number("H", 1e-7, 0.5)
    """Converter-side inductor."""
    R_1: float = number("ohm", 0.0, 100.0)
    """Its resistance, switches included."""
    C: float = number("F", 1e-8, 0.1)
    """Capacitor, star."""
    R_c: float = number("ohm", 0.0, 1000.0, default=0.0)
    """Damping resistor in series with C."""
    L_2: float = number("H", 1e-7, 0.5, shown=_LCL)
    """Grid-side inductor, transformer leakage included."""
    R_2: float = number("ohm", 0.0, 100.0, shown=_LCL)
    """Its resistance."""


class _Kind:
    """Which filter it is."""

    kind: str = word(("LC", "LCL"))
    """With or without grid-side inductor."""


FILTER = (*fields_of(_Kind), *fields_of(Filter))
"""The fields of [filter]."""


def limiter_ratings(converter: Converter, filter_: Filter) -> LimiterRatings:
    """Ratings from which a current limiter computes its constants."""
    c = converter
    limit_pu = UNLIMITED_PU if c.current_limit_pu is None else c.current_limit_pu
    return LimiterRatings(
        T_s=c.T_s,
        V_rated_pk=rms_to_peak(c.V_rated_rms),
        I_rated_pk=c.I_rated_pk,
        i_max_pk=limit_pu * c.I_rated_pk,
        Z_base=c.Z_base,
        omega_0=c.omega_n,
        R_2=filter_.R_2,
        L_2=filter_.L_2,
        V_low_pu=c.V_min_pu,
        V_high_pu=c.V_max_pu,
    )


class _LineToLine:
    """Fields of this section."""

    V_rated_ll_rms: float = number("V", 10.0, 1e6, shown=_V_LL)
    """Rated line-to-line voltage."""


def limiter_fields() -> tuple[Field, ...]:
    """The parameters of all current limiters, each once."""
    limiters: dict[LimiterParameter, list[str]] = {}
    for limiter in LIMITERS.values():
        for one in limiter.parameters:
            limiters.setdefault(one, []).append(f"`{limiter.name}`")
    return tuple(
        Field(
            kind="number",
            name=one.name,
            unit=one.unit,
            low=Times(1.0, one.low.words) if one.low.value is None else one.low.value,
            high=Times(1.0, one.high.words) if one.high.value is None else one.high.value,
            default=one.default.value,
            shown=one.default.words,
            explained=f"{', '.join(names)}: {one.meaning}",
        )
        for one, names in limiters.items()
    )


class LimiterChoice:
    """The fields of [converter] that name its current limiter."""

    current_limiter: str = word(lambda: tuple(LIMITERS), default=CIRCULAR.name)
    """How that limit acts ([laws](theory/limiters.md)); a controller may have its own."""
    limiter: Any = subtable(limiter_fields)
    """[`[converter.limiter]`](#converterlimiter)."""


CONVERTER = inserted(
    inserted(fields_of(Converter), "S_rated", *fields_of(_LineToLine)), "current_limit_pu", *fields_of(LimiterChoice)
)
"""The fields of [converter]."""


def scope_of(converter: Converter, reference_limit_pu: float = math.nan) -> dict[str, float]:
    """What limits of other sections follow from, by the names of :mod:`vsgdesign.study.parameters.fields`.

    ``reference_limit_pu``: the largest reference of a study, over the rating.
    """
    Z, omega = converter.Z_base, converter.omega_n
    return {
        MOST_REFERENCE.of: reference_limit_pu * converter.S_rated,
        V_MIN.of: converter.V_min_pu,
        V_MAX.of: converter.V_max_pu,
        S_RATED.of: converter.S_rated,
        V_RATED.of: converter.V_rated_rms,
        F_N.of: float(f"{omega / (2.0 * math.pi):.15g}"),  # 60 Hz, which 2π and back makes 59.99999999999999
        T_S.of: converter.T_s,
        Z_BASE.of: Z,
        L_BASE.of: Z / omega,
        C_BASE.of: 1.0 / (omega * Z),
    }


def read_converter(table: TableReader) -> Converter:
    """The section without its limiter."""
    S_rated = values(picked(Converter, "S_rated"), table)["S_rated"]
    if table.one_of(("V_rated_ll_rms",), ("V_rated_rms",)) == ("V_rated_rms",):
        V_rated_rms = values(picked(Converter, "V_rated_rms"), table)["V_rated_rms"]
    else:
        V_rated_rms = ll_to_phase(values(_LineToLine, table)["V_rated_ll_rms"]) if table.table else math.nan
    known = {"S_rated": S_rated, "V_rated_rms": V_rated_rms}
    rest = tuple(one for one in fields_of(Converter) if one.attribute not in known)
    converter = Converter(**known, **values(rest, table))
    V_dc, f_sw, f_n = converter.V_dc, converter.f_sw, converter.omega_n / (2.0 * math.pi)
    if rms_to_peak(V_rated_rms) > converter.v_max_pk:
        table.fault(
            "V_dc",
            f"{V_dc:.6g} V",
            f"too low: the bridge makes at most {converter.v_max_pk:.4g} V peak and the rated voltage is "
            f"{rms_to_peak(V_rated_rms):.4g} V peak",
            'Raise V_dc, or set modulation = "min_max" (+15 %).',
        )
    if f_sw * converter.samples_per_carrier < 20.0 * f_n:
        table.fault("f_sw", f"{f_sw:.6g} Hz", f"samples fewer than 20 times a cycle of {f_n:.6g} Hz", "Raise f_sw.")
    table.finish()
    return converter


def read_filter(table: TableReader) -> Filter:
    """The section."""
    if values(_Kind, table)["kind"] == "LCL":
        return read(Filter, table)
    for field, unit in (("L_2", "H"), ("R_2", "ohm")):
        if table.has(field):
            table.fault(field, table.table[field], "an LC filter has none", 'Set kind = "LCL" or remove it.')
            table.quantity(field, unit)
    return read(Filter, table, L_2=0.0, R_2=0.0)


_LARGEST_DC = 30.0
"""Largest voltage of the bridge over the rated peak voltage; 1.0 to 1.5 are usual."""

_LARGEST_PU = {"L_1": 4.0, "L_2": 4.0, "R_1": 2.0, "R_2": 2.0, "R_c": 20.0, "C": 20.0}
"""Largest parts of a filter in per unit, ten times those of any converter that was built."""

_BASES = {"L": "H", "R": "ohm", "C": "F"}


def frequency_of_angular(f: float) -> float | None:
    """The nominal frequency in Hz, if ``f`` is its angular frequency in rad/s; otherwise None."""
    return next((f_n for f_n in (50.0, 60.0) if abs(f - 2.0 * math.pi * f_n) < 0.5), None)


def angular_advice(f_n: float) -> str:
    """What to do with an angular frequency."""
    return f"That is 2π times {f_n:g} Hz: did you mean {f_n:g} Hz?"


def check_plausible(converter: Converter, filter_: Filter, faults: list[Fault]) -> None:
    """Append a fault for each value that only a wrong unit can explain. The values must be numbers."""
    f_n = converter.omega_n / (2.0 * math.pi)
    meant = frequency_of_angular(f_n)
    if meant is not None:
        faults.append(Fault("converter.f_n", f"{f_n:.6g} Hz", "is in rad/s, it seems", angular_advice(meant)))
    ratio = converter.v_max_pk / rms_to_peak(converter.V_rated_rms)
    if ratio > _LARGEST_DC:
        problem = f"the bridge makes {ratio:.3g} times the rated voltage, more than {_LARGEST_DC:g} times"
        shown = format_quantity(converter.V_dc, "V")
        faults.append(Fault("converter.V_dc", shown, problem, "Check the units of V_dc and of the rated voltage."))
    Z = base_impedance(converter.S_rated, converter.V_rated_rms)
    for field, largest in _LARGEST_PU.items():
        value, base = getattr(filter_, field), _BASES[field[0]]
        unit = {"H": Z / converter.omega_n, "ohm": Z, "F": 1.0 / (Z * converter.omega_n)}[base]
        if value > largest * unit:
            problem = f"is {value / unit:.4g} pu of the converter, more than {largest:g} pu"
            advice = f"Check its unit, and those of S_rated and the rated voltage; {largest:g} pu are "
            advice += f"{format_quantity(float(f'{largest * unit:.3g}'), base)}."
            faults.append(Fault(f"filter.{field}", format_quantity(value, base), problem, advice))
