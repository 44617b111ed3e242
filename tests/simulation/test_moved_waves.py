"""What a wandering source adds, from machine code, against complex numbers and a recursion of its own."""

from __future__ import annotations

import math
import zlib

import numpy as np
import pytest

from vsgdesign.simulation.background import LANES, MovedWaves
from vsgdesign.simulation.wander import BLOCK, FORGOTTEN_S, NOISE_TIME, Wander
from vsgdesign.study.parameters.background import draw_background

OMEGA, T_S, PHASE = 2.0 * math.pi * 50.2, 50e-6, 1.3


@pytest.mark.parametrize("count", [1, 7, LANES, 3 * LANES + 5, 1000])
def test_waves_are_powers_of_the_moved_phasor(count: int) -> None:
    rng, orders = np.random.default_rng(count), (-1, -5, 7, 1, 19)
    gain, angle = 1.0 + 0.05 * rng.standard_normal(count), rng.standard_normal(count)
    parts = rng.standard_normal((2 * len(orders) + 2, 8))
    waves = MovedWaves(orders, 8)
    waves.over((np.ones(2000), np.ones(2000)), (1.0, 1.0, 0.0), T_S, parts)  # what was there before leaves nothing
    added = waves.over((gain, angle), (OMEGA, math.cos(PHASE), math.sin(PHASE)), T_S, parts)
    turn = np.exp(1j * (PHASE + OMEGA * T_S * np.arange(count)))
    moved = turn * np.exp(1j * angle)
    of = np.stack([gain * moved - turn, *(moved**n for n in orders)], axis=1)
    assert added.shape == (count, 8)
    assert added == pytest.approx(of.view(np.float64) @ parts, abs=1e-11)
    before = added.copy()
    waves.over((gain[:1], angle[:1] + 1.0), (OMEGA, 1.0, 0.0), T_S, parts)
    assert added.tobytes() == before.tobytes()  # no later call changes it


def test_the_path_follows_its_recursion() -> None:
    """:eq:`wander`, sample by sample in Python, across the border of two blocks."""
    given = {"phasor_walk": (3e-4, 3e-4), "phase_jumps_per_minute": (0.0, 0.0), "voltage_steps_per_minute": (0.0, 0.0)}
    spec = draw_background(given, 4, "measured")
    gain, angle = Wander(spec, T_S, 100.0 * math.pi).factors(0, BLOCK + 50)
    wander = Wander(spec, T_S, 100.0 * math.pi)

    def normal(name: str) -> np.ndarray:
        streams = (np.random.default_rng([spec.seed, _crc(name), k]).standard_normal(BLOCK) for k in range(2))
        return np.concatenate(list(streams))

    def rms(name: str) -> float:
        return wander._rms(name)

    drawn = {
        name: normal(name)
        for name in ("frequency", "voltage", "phase walk", "voltage walk", "phase_noise", "voltage_noise")
    }
    keeps_f = math.exp(-0.5 * T_S * (spec.frequency_wander / spec.frequency_deviation) ** 2)
    keeps_v = math.exp(-0.5 * T_S * (spec.voltage_wander / spec.voltage_deviation) ** 2)
    keeps_n = math.exp(-T_S / (NOISE_TIME * 0.02))
    walk = spec.phasor_walk * math.sqrt(0.5 * T_S / 0.02)
    frequency = turned = slow = magnitude = 0.0
    noise = {name: rms(name) * _first(spec.seed, name) for name in ("phase_noise", "voltage_noise")}
    for k in range(BLOCK + 50):
        assert angle[k] == pytest.approx(turned + noise["phase_noise"], abs=1e-12)
        assert gain[k] == pytest.approx(math.exp(slow + magnitude + noise["voltage_noise"]), rel=1e-12)
        turned += 2.0 * math.pi * T_S * frequency + walk * drawn["phase walk"][k]
        slow = math.exp(-T_S / FORGOTTEN_S) * slow + walk * drawn["voltage walk"][k]
        frequency *= keeps_f
        frequency += spec.frequency_deviation * math.sqrt(1.0 - keeps_f**2) * drawn["frequency"][k]
        magnitude *= keeps_v
        magnitude += spec.voltage_deviation * math.sqrt(1.0 - keeps_v**2) * drawn["voltage"][k]
        for name in noise:
            noise[name] = keeps_n * noise[name] + rms(name) * math.sqrt(1.0 - keeps_n**2) * drawn[name][k]


def _crc(name: str) -> int:
    return zlib.crc32(name.encode())


def _first(seed: int, name: str) -> float:
    return float(np.random.default_rng([seed, _crc(name), _crc("first")]).standard_normal())
