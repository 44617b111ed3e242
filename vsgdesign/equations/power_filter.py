"""The notch in front of the power filters: what a negative sequence of the grid makes of P and Q does not pass.

A negative sequence of the grid's voltage makes P and Q ripple at twice the grid's frequency. The notch predicts this
ripple by an oscillator of exactly this frequency and takes it away. docs/theory/power-filters.md derives it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class NotchConstants(NamedTuple):
    """Constants of the notch. Zeros switch it off: then it changes no bit of what goes through."""

    gain: Any
    step: Any
    back: Any


NO_NOTCH = NotchConstants(0.0, 0.0, 0.0)


def notch(value: Any, ripple: Any, mean: Any, gain: Any, step: Any, back: Any) -> tuple[Any, Any, Any]:
    """Takes the predicted ripple from a measured power (:eq:`notch`).

    ``ripple`` and ``mean`` are what it remembers, in the unit of ``value``: the ripple that is predicted for this
    sample, and a mean that equals the value at rest. Returns (passed, ripple, mean): what goes on to the power filter,
    and what to remember.
    """
    passed = value - ripple
    error = passed - mean
    return passed, ripple - step * ripple + gain * error, mean + step * error + back * ripple


def notch_constants(omega: Any, damping: Any, T_s: Any) -> NotchConstants:
    """The notch at the angular frequency ``omega`` in rad/s, sampled every T_s in s (:eq:`notch-constants`).

    ``damping`` is the damping ratio of its poles: half its width over its frequency.
    """
    angle = omega * T_s
    half, sine = np.sin(0.5 * angle), np.sin(angle)
    gain = 2.0 * damping * sine / (1.0 + damping * sine)
    return NotchConstants(gain=gain, step=2.0 * half * half, back=sine * sine / gain)


def notch_delay(constants: NotchConstants, T_s: Any) -> Any:
    """How long the notch delays what changes slowly, s (:eq:`notch-delay`)."""
    return 0.5 * constants.gain / constants.step * T_s
