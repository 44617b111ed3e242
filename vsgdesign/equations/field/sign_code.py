"""The sign of the probe and its size: what is sent in the next cycle."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.data import DOUBT, TRACK, FieldSettings
from vsgdesign.equations.field.noise import CHIP_CYCLES
from vsgdesign.equations.field.tracks import Fit
from vsgdesign.equations.field.windows import NU_1, NU_2

FORCED_AT = 3.0
"""Cycles of the fast track in doubt at which the sign is changed once, whatever the code says."""


class SignCode(NamedTuple):
    """Manchester code of a shift register: of two chips the second has the other sign, that of the first is random."""

    bits: Any
    """Whole number from 1 to 511: nine bits with the feedback x⁹ + x + 1."""
    second: Any
    """0 in the first chip of a pair, 1 in the second."""
    cycles: Any
    """Cycles of the running chip."""
    sign: Any
    """+1 or −1."""
    since_flip: Any
    """Cycles since the sign changed."""


def first_code(settings: FieldSettings) -> SignCode:
    """The code of the first cycle."""
    return SignCode(bits=settings.seed, second=1.0, cycles=1.0, sign=1.0, since_flip=50.0)


def code_moved(code: SignCode, mode: Any, used: Any) -> SignCode:
    """The code of the next cycle; ``used`` are the cycles of the fast track in doubt."""
    forced = mode == DOUBT and used == FORCED_AT and code.cycles > 2.5
    due = forced or code.cycles > CHIP_CYCLES - 0.5
    half = np.floor(0.5 * code.bits)
    lowest = code.bits - 2.0 * half
    next_bit = half - 2.0 * np.floor(0.5 * half)
    bits = half + 256.0 * np.abs(lowest - next_bit)
    drawn = 2.0 * (bits - 2.0 * np.floor(0.5 * bits)) - 1.0
    second = 1.0 - code.second
    new = -code.sign if forced or second > 0.5 else drawn
    sign = new if due else code.sign
    since_flip = 1.0 if sign * code.sign < 0.0 else np.minimum(code.since_flip + 1.0, 50.0)
    new_bits = bits if due else code.bits
    new_second = second if due else code.second
    new_cycles = 1.0 if due else code.cycles + 1.0
    return SignCode(bits=new_bits, second=new_second, cycles=new_cycles, sign=sign, since_flip=since_flip)


def line_amplitude(
    noise: Any, turns: Any, cycles: Any, sigma: Any, top: Any, calm: Any, fit: Fit, settings: FieldSettings
) -> Any:
    """Amplitude of a line (:eq:`field-amplitude`): what the wanted standard deviation needs, within the limits."""
    R, X = fit.R, turns * fit.X
    size = np.sqrt(R * R + X * X)
    # Both lines have the same current where only the ripple of the power limits them.
    ripple = np.minimum(settings.current_rest, settings.ripple_rest)
    top = np.minimum(top, ripple * size) if calm > 0.5 else top
    wanted = np.sqrt(noise / (2.0 * cycles)) / sigma
    return np.minimum(np.maximum(wanted, settings.amplitude_least), top)


def amplitudes(mode: Any, noise: Any, fit: Fit, settings: FieldSettings) -> tuple[Any, Any]:
    """Amplitudes of both lines in the next cycle, without the sign. Returns (a_1, a_2)."""
    calm = 1.0 if mode == TRACK else 0.0
    cycles = 60.0 if mode == TRACK else 4.0
    sigma = settings.sigma_rest if mode == TRACK else settings.sigma_burst
    top = settings.amplitude_rest if mode == TRACK else settings.amplitude_burst
    a_1 = line_amplitude(noise, 1.0 + NU_1, cycles, sigma, top, calm, fit, settings)
    a_2 = line_amplitude(noise, 1.0 + NU_2, cycles, sigma, top, calm, fit, settings)
    return a_1, a_2
