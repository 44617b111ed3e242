"""The grid's source: how its phase and magnitude wander and the phasors that this moves (:eq:`wander`), and sags by
their types A to G."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.frames import PHASES, rotate


class WanderPath(NamedTuple):
    """Where a wandering source is."""

    frequency: Any = 0.0
    """Hz."""
    turned: Any = 0.0
    """Its angle without noise, rad."""
    slow: Any = 0.0
    """ln of the magnitude: steps and walk."""
    magnitude: Any = 0.0
    """ln of the magnitude: its wander."""
    phase_noise: Any = 0.0
    voltage_noise: Any = 0.0


class WanderDrive(NamedTuple):
    """What random numbers add to the path in a sample."""

    frequency: Any
    turned: Any
    """Walk and jumps."""
    slow: Any
    """Walk and steps."""
    magnitude: Any
    phase_noise: Any
    voltage_noise: Any


class WanderPace(NamedTuple):
    """What of the path is left after a sample, and how far a frequency turns in it."""

    frequency: Any
    slow: Any
    magnitude: Any
    noise: Any
    turn: Any
    """rad/Hz."""


def wandered(path: WanderPath, drive: WanderDrive, pace: WanderPace) -> Any:
    """A sample of the path (:eq:`wander`). Returns (following, exponent, angle): the path at the next one, and ln of
    the magnitude and the angle (rad) at this one."""
    following = WanderPath(
        frequency=pace.frequency * path.frequency + drive.frequency,
        turned=path.turned + (pace.turn * path.frequency + drive.turned),
        slow=pace.slow * path.slow + drive.slow,
        magnitude=pace.magnitude * path.magnitude + drive.magnitude,
        phase_noise=pace.noise * path.phase_noise + drive.phase_noise,
        voltage_noise=pace.noise * path.voltage_noise + drive.voltage_noise,
    )
    exponent = path.slow + path.magnitude + path.voltage_noise
    return following, exponent, path.turned + path.phase_noise


def moved_phasor(gain: Any, angle: Any, turned: Any, cosine: Any, sine: Any) -> Any:
    """The phasor of a source that has turned by an angle (rad) from a direction (cosine, sine) on, and is moved by a
    gain and an angle (rad). Returns (moved_re, moved_im, change_re, change_im): of length 1, and by how much the
    fundamental differs from the one that is not moved."""
    turn_re, turn_im = rotate(np.cos(turned), np.sin(turned), cosine, sine)
    moved_re, moved_im = rotate(turn_re, turn_im, np.cos(angle), np.sin(angle))
    return moved_re, moved_im, gain * moved_re - turn_re, gain * moved_im - turn_im


_HALF, _THIRD = 0.5, 1.0 / PHASES

SAG_TYPES: dict[str, tuple[float, float]] = {
    "A": (1.0, 0.0),
    "B": (_THIRD, -_THIRD),
    "C": (_HALF, _HALF),
    "D": (_HALF, -_HALF),
    "E": (1.0 - _THIRD, _THIRD),
    "F": (1.0 - _THIRD, -_THIRD),
    "G": (1.0 - _THIRD, _THIRD),
}
"""Shares p and n of each type (:eq:`sag-types`). Without a zero sequence, E and G are the same."""


def sag_sequences(kind: str, V: complex) -> tuple[complex, complex]:
    """Positive and negative sequence of a sag over the voltage before it, as phasors of phase a (:eq:`sag-types`).

    ``kind`` is a name of :data:`SAG_TYPES`, and ``V`` is the characteristic voltage over the voltage before. Phase a is
    the phase of symmetry. The zero sequence is left out: three wires carry none.
    """
    p, n = SAG_TYPES[kind]
    return 1.0 - p * (1.0 - V), n * (1.0 - V)
