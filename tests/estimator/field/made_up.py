"""Made-up cycles whose features say what the true impedance is: an oracle for training and scores."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.equations.field import DOUBT, TRACK, FieldAnswer
from vsgdesign.estimator.data_set import FieldCycles
from vsgdesign.identification.field import field_settings

NAMES = ("size", "angle", "noise_size", "in_doubt")
PER_RUN = 60
SETTINGS = field_settings(T_s=5e-5, omega_n=314.159, V_base=90.0, Z_base=2.42, R_2=0.002, L_2=1e-4)
EVENT = 20
"""Cycle of a run in which its only change falls, a jump."""


def made_up_cycles(runs: int = 40, seed: int = 0, sigma: float = 0.05) -> FieldCycles:
    """Runs with one jump each. The first two features are ln(Z/Ẑ) with an error of known deviation, relative to 1.

    The deviation is ``sigma`` times e to the third feature, so that a trained network has to answer it. The held
    answer stays that of the old grid for eight cycles after the jump.
    """
    rng = np.random.default_rng(seed)
    rows: dict[str, list[Any]] = {name: [] for name in FieldCycles.array_names()}
    for run in range(runs):
        old, new = (np.exp(rng.uniform(-2.0, 0.0)) * np.exp(1j * rng.uniform(0.3, 1.4)) for _ in range(2))
        for k in range(PER_RUN):
            true = new if k >= EVENT else old
            doubt = EVENT + 1 <= k < EVENT + 8
            held = old if k < EVENT + 8 else new * (1.0 + 0.01 * rng.standard_normal())
            spread = rng.uniform(-0.7, 0.7)
            y = np.log(true / held)
            error = sigma * np.exp(spread) * rng.standard_normal(2)
            rows["features"].append([y.real + error[0], y.imag + error[1], spread, float(doubt)])
            rows["answer"].append(_answer(held, doubt=doubt, event=k == EVENT + 1))
            rows["refuted"].append(False)
            rows["truth"].append(_ohm_and_henry(true))
            rows["run"].append(run)
            rows["converter"].append(0)
            rows["t_s"].append(0.02 * (k + 1))
            rows["change"].append(1 if k >= EVENT else 0)
            rows["change_number"].append(0 if k >= EVENT else -1)
            rows["since_change"].append(0.02 * (k - EVENT) + 0.01 if k >= EVENT else np.inf)
            rows["factor"].append(max(abs(new / old), abs(old / new)) if k >= EVENT else 1.0)
            rows["current"].append(0.3)
            rows["broken"].append(False)
    header = {
        "features": list(NAMES),
        "converters": [{"name": "made up", "S_rated": 5e3, "V_rated_rms": 63.5, "f_n": 50.0, "T_s": 5e-5}],
        "settings": [SETTINGS._asdict()],
        "recipe": {"name": "made up"},
        "seed": seed,
    }
    return FieldCycles(**{name: np.array(values) for name, values in rows.items()}, header=header)


def _ohm_and_henry(Z: complex) -> list[float]:
    """R_g in Ω and L_g in H of an impedance in pu from the measured voltage on."""
    grid = Z - complex(SETTINGS.R_2, SETTINGS.X_2)
    return [grid.real * SETTINGS.Z_base, grid.imag * SETTINGS.Z_base / SETTINGS.omega_n]


def _answer(held: complex, *, doubt: bool, event: bool) -> FieldAnswer:
    R_g, L_g = _ohm_and_henry(held)
    deviation = 0.01 * abs(held) * SETTINGS.Z_base
    return FieldAnswer(
        R_g=R_g,
        L_g=L_g,
        var_R=deviation**2,
        cov_RL=0.0,
        var_L=(deviation / SETTINGS.omega_n) ** 2,
        sigma=0.014,
        valid=0.0 if doubt else 1.0,
        changed=0.0,
        event=float(event),
        doubt=float(doubt),
        mode=DOUBT if doubt else TRACK,
        limited=0.0,
        spoilt=0.0,
        amplitude=1e-3,
        foreign=0.0,
        passive=1.0,
    )


def told_cycles(runs: int = 60, seed: int = 0, sigma: float = 0.05) -> FieldCycles:
    """Cycles of which each has its own ln(Z/Ẑ), told by the features as in :func:`made_up_cycles`."""
    cycles, rng = made_up_cycles(runs, seed), np.random.default_rng(seed + 1)
    told = rng.uniform(-1.0, 1.0, (len(cycles), 4))
    y = told[:, :2] - sigma * np.exp(told[:, 2:3]) * rng.standard_normal((len(cycles), 2))
    held = np.column_stack([cycles.said("R_g"), SETTINGS.omega_n * cycles.said("L_g")]) @ (1.0, 1j) / SETTINGS.Z_base
    true = (held + complex(SETTINGS.R_2, SETTINGS.X_2)) * np.exp(y @ (1.0, 1j))
    return replace(cycles, features=told, truth=np.array([_ohm_and_henry(one) for one in true]))
