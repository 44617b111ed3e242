"""A source that wanders: the path of its phase and magnitude, and the phasors that it moves (:eq:`wander`)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.frames import rotate


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
