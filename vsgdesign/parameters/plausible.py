"""Values that no converter has and that a wrong unit makes: rad/s for Hz, kV for V, mH for uH."""

from __future__ import annotations

import math

from vsgdesign.errors import Fault
from vsgdesign.frames import base_impedance, rms_to_peak
from vsgdesign.parameters.converter import Converter, Filter
from vsgdesign.parameters.units import format_quantity

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
