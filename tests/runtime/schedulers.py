"""Schedulers of the published table, and estimates that settle them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.gain_tables import PUBLISHED_BASE, table
from vsgdesign.equations.frames import base_impedance
from vsgdesign.runtime import (
    Answer,
    Scheduler,
    scheduler_of,
)

OMEGA = PUBLISHED_BASE.omega_n
Z_BASE = base_impedance(5e3, 110.0)
POWERS = (3e3, 500.0, 112.0)
MIDDLE = np.sqrt(1.5 * 20.0)
"""SCR of the safe place."""
SHAPED = {"k_1": np.linspace(10.0, 20.0, 16).reshape(4, 4), "share_P": np.linspace(0.2, 1.0, 16).reshape(4, 4)}


def grid(scr: float, x_over_r: float) -> tuple[float, float]:
    R = Z_BASE / scr / np.hypot(1.0, x_over_r)
    return R, R * x_over_r / OMEGA


def made(structure: str = "angle_damped", law: str = "poles", **changes: Any) -> Scheduler:
    shaped = SHAPED if law == "poles" else {"H": np.linspace(1.0, 3.0, 16).reshape(4, 4)}
    return scheduler_of(table(structure, law, parameters=shaped), **changes)


def settle(scheduler: Scheduler, scr: float, x_over_r: float, count: int = 40) -> Answer:
    answers = [scheduler.update_estimate(*grid(scr, x_over_r), *POWERS) for _ in range(count)]
    return answers[-1]
