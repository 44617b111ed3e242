"""Known answers of the field estimator: its cycles on a small circuit that the self-test simulates itself.

Both simulate the same circuit: a voltage V e^{jθ}(1 + u) on R and L to a grid that stays 0.3 rad behind, with noise
from whole numbers. A record of samples would take many times the flash.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vsgdesign.equations.field import FieldAnswer, FieldSettings, conclude, first_lock_in, first_track, listen
from vsgdesign.equations.field import probe_value as probe_of
from vsgdesign.identification.field_network import FieldNetwork

CYCLES = 17
"""From learning to the second valid answer and some more. The last one has a sample that is no number."""
OFF_NOMINAL = 1.003
"""Frequency of the circuit over nominal."""
LOAD = 0.3
"""Angle of the grid behind the converter, rad."""
NOISE = 3e-4
"""Largest noise of a sample over rated."""
IMPEDANCE = (0.06, 0.2)
"""R and X of the grid over the base impedance."""


class KnownPlant(NamedTuple):
    """Constants of the circuit, SI."""

    turn_re: float
    turn_im: float
    """e^{jωT_s}."""
    decay: float
    gain: float
    """i ← decay i + gain (v − g) in one sample."""
    grid_re: float
    grid_im: float
    """g over v, without the probe."""
    V_pk: float
    v_noise: float
    i_noise: float
    """V and A for the smallest whole number."""
    omega: float
    Z_size: float
    L_size: float
    """What errors of R_g and L_g are relative to."""


@dataclass(frozen=True)
class KnownCycles:
    """The circuit, and the estimator's answers in order."""

    plant: KnownPlant
    answers: list[FieldAnswer]


def known_posteriors(network: FieldNetwork) -> tuple[np.ndarray, np.ndarray]:
    """(3, n) features that no single precision rounds, and the (3, 5) outputs of the network for them."""
    inputs = np.round(64.0 * np.random.default_rng(14).normal(size=(3, network.W_1.shape[1]))) / 64.0
    return inputs, network.outputs(inputs)


class Noise:
    """Whole numbers from −32768 to 32767 that every processor draws alike."""

    def __init__(self) -> None:
        self._state = 1

    def next(self) -> int:
        self._state = (self._state * 1664525 + 1013904223) & 0xFFFFFFFF
        return (self._state >> 16) - 32768


def known_cycles(settings: FieldSettings) -> KnownCycles:
    """The answers of the first cycles."""
    Z, omega_n, T_s = settings.Z_base, settings.omega_n, settings.T_s
    V_pk = 1.0 / settings.per_volt
    R, L = IMPEDANCE[0] * Z + settings.R_2 * Z, (IMPEDANCE[1] + settings.X_2) * Z / omega_n
    decay = math.exp(-R * T_s / L)
    turn, grid = cmath.rect(1.0, OFF_NOMINAL * omega_n * T_s), cmath.rect(1.0, -LOAD)
    plant = KnownPlant(
        turn.real, turn.imag, decay, (1.0 - decay) / R, grid.real, grid.imag, V_pk, NOISE * V_pk / 32768.0,
        NOISE / settings.per_ampere / 32768.0, OFF_NOMINAL * omega_n, math.hypot(*IMPEDANCE) * Z,
        math.hypot(*IMPEDANCE) * Z / omega_n,
    )  # fmt: skip
    lock, track, answers, noise = first_lock_in(settings, plant.omega), first_track(settings), [], Noise()
    frame, i = 1.0 + 0.0j, 0.0 + 0.0j
    while len(answers) < CYCLES:
        u = complex(*probe_of(lock, 1.0, settings))
        sent = u * frame
        v = V_pk * (frame + sent)
        v_seen = v + complex(plant.v_noise * noise.next(), plant.v_noise * noise.next())
        i_seen = i + complex(plant.i_noise * noise.next(), plant.i_noise * noise.next())
        if len(answers) == CYCLES - 1 and lock.spoilt < 0.5:
            v_seen = complex(math.nan, v_seen.imag)
        lock = listen(lock, v_seen.real, v_seen.imag, i_seen.real, i_seen.imag, sent.real, sent.imag, 0.0, settings)
        if lock.closed > 0.5:
            lock, track, answer = conclude(lock, track, settings)
            answers.append(FieldAnswer(*map(float, answer)))
        i = plant.decay * i + plant.gain * (v - V_pk * grid * frame)
        frame *= turn
    return KnownCycles(plant, answers)
