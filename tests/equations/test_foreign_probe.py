"""Another converter's probe on the same lines is heard, and nothing else is taken for one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vsgdesign.equations.field import TRACK
from vsgdesign.equations.field.sign_code import SignCode, code_moved, foreign_with, no_foreign, towards
from vsgdesign.equations.field.tracks import Lines, no_window

CYCLES, R, X, NOISE = 400, 0.1, 0.3, 2e-4
PHASES = (0.7, -1.9)
"""Where the other's lines lie to the own ones, rad."""


def signs(seed: float, begun: int = 0) -> Any:
    """A sign code behind the third difference over four cycles, as sent at rest."""
    code, sent, found = SignCode(bits=seed, second=1.0, cycles=1.0, sign=1.0, since_flip=50.0), 0.0, []
    for _ in range(CYCLES + begun + 3):
        code = code_moved(code, TRACK, 0.0)
        sent = towards(sent, code.sign, 1.0, 1.0)
        found.append(float(sent))
    return np.convolve(found, [0.125, 0.375, 0.375, 0.125], "valid")[begun:]


def coloured(rng: np.random.Generator) -> Any:
    """White noise of cycles behind the third difference."""
    white = rng.normal(size=(CYCLES + 3, 2)) @ np.array([1.0, 1j])
    return np.convolve(white, [0.125, -0.375, 0.375, -0.125], "valid")


def heard(residuals: list[Any], own: Any) -> list[float]:
    """Whether another probe is heard, cycle by cycle; ``residuals`` of both lines."""
    foreign, found = no_foreign(), []
    for m in range(CYCLES):
        lines = []
        for e, axis in zip(residuals, (1.0, 1j), strict=True):
            i, x, u = 0.5 - 0.2j, 0.3 + 0.8j, 2e-3 * own[m] * axis
            v = R * i + X * x + e[m]
            lines.append(
                no_window()._replace(
                    v_re=v.real, v_im=v.imag, i_re=i.real, i_im=i.imag, x_re=x.real, x_im=x.imag,
                    u_re=u.real, u_im=u.imag,
                )
            )  # fmt: skip
        foreign = foreign_with(foreign, lines[0], lines[1], Lines(R, X, R, X), NOISE**2, NOISE**2)
        found.append(float(foreign.heard))
    return found


def probe(begun: int) -> list[Any]:
    """Another probe on both lines."""
    return [1e-3 * np.exp(1j * phase) * signs(77.0, begun) for phase in PHASES]


@pytest.mark.parametrize("begun", [0, 2, 13])
@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_a_probe_on_the_same_lines_is_heard(begun: int, noise: float) -> None:
    """Within a second and a half, and from then on, also where the answer leaves a part of the own probe."""
    rng, own = np.random.default_rng(3), signs(5.0)
    for share in (0.0, 0.5):
        left = [
            e + noise * coloured(rng) + share * 1e-3 * own * np.exp(1j * at)
            for e, at in zip(probe(begun), (0.2, 2.0), strict=True)
        ]
        said = heard(left, own)
        assert 1.0 in said[:75]
        assert min(said[75:]) == 1.0


def test_nothing_else_is_taken_for_a_probe() -> None:
    """Noise, what the answer leaves of the own probe, lines that keep their signs or turn slowly, and a transient."""
    rng, own, m = np.random.default_rng(4), signs(5.0), np.arange(CYCLES)
    noise = [NOISE * coloured(rng) for _ in PHASES]
    others = {
        "noise": noise,
        "misfit": [1e-3 * own * np.exp(1j * phase) + e for phase, e in zip(PHASES, noise, strict=True)],
        "transient": [e + 0.1 * np.exp(-m + 1j * phase) for phase, e in zip(PHASES, noise, strict=True)],
    }
    for beat_hz in (0.0, 0.05, 0.1, 0.2, 0.4, 1.7):
        turn = np.exp(2j * np.pi * beat_hz * 0.02 * m)
        others[f"{beat_hz} Hz"] = [1e-3 * np.exp(1j * phase) * turn + e for phase, e in zip(PHASES, noise, strict=True)]
    for name, left in others.items():
        assert 1.0 not in heard(left, own), name


def test_noise_alone_is_no_probe() -> None:
    """20 spells of 8 s, each with other noise on both lines."""
    rng, own = np.random.default_rng(5), signs(5.0)
    assert not any(1.0 in heard([NOISE * coloured(rng), NOISE * coloured(rng)], own) for _ in range(20))
