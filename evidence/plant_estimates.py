"""What the field estimators of a plant's units find at rest, each with its probe on its own lines.

Two, three and four equal units at one node, with sensors and harmonics; the gains are those of the true plant. The
truth of a unit is what it finds in the mean where it alone sends its probe, in the same plant with other draws of the
noise: the grid beside its neighbours. Errors are relative to what its voltage and its current say, its own transformer
included. Beside it stands how soon units that wrongly have one pair of lines hear each other.
``VSGDESIGN_FIELD_SHARE=0.5`` measures half of the draws.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._kept_runs import EVIDENCE_SEED, share
from evidence._tables import leave, table
from evidence.field_scenario import ToldTheTruth
from vsgdesign.metrics.answers import Answers, answers_of, inside_ellipse
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.units import plant_timeline, simulate_plant
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.background import draw_background
from vsgdesign.study.parameters.sensors import draw_sensors
from vsgdesign.study.parameters.study import Study

CASES = {"12.5 kVA": "lab_12kva_lcl", "1 MVA": "utility_1mva_60hz"}
PLANTS = ((2, 6.0), (2, 16.0), (3, 9.0), (4, 12.0))
"""Units, and the short-circuit ratio on the rating of one unit (:eq:`plant-grid`)."""
DRAWS, FROM_S, DURATION_S = 8, 2.0, 12.0
ALONE_SEEDS = (1, 2, 3)
X_T = complex(0.0075, 0.06)
"""Transformer and feeder of a unit, pu."""
STRIDE = 10
"""Every tenth cycle counts, of which each remembers a hundred."""

STUDY = """
base = "case:{case}"
grid = {{ scr = {scr}, x_over_r = 4 }}
simulation = {{ duration = {duration}, P_ref = "0 W", Q_ref = "0 var", log_interval = "20 ms" }}
controllers = [{{ name = "field", kind = "scheduled", estimate = "field" }}]
plant = {{ units = {units}, reactance = {reactance}, resistance = {resistance} }}
"""


def study_of(case: str, units: int, scr: float, duration_s: float) -> Study:
    """A plant at 0.4 pu. ``scr`` is on one unit."""
    paths = {"reactance": X_T.imag, "resistance": X_T.real}
    text = STUDY.format(case=CASES[case], units=units, scr=scr / units, duration=duration_s, **paths)
    found = study_from_text(text)
    plant = found.plant
    if plant is None:
        raise ValueError("no plant")
    P = 0.4 * found.converter.S_rated
    some = tuple(replace(one, P_ref=P) for one in plant.units)
    return replace(found, plant=replace(plant, units=some))


def answers(study: Study, log: EstimateLog, Z: tuple[float, float]) -> Answers:
    """The answers of a unit beside what it sees (Ω, H)."""
    cycles = log.cycles
    if cycles is None:
        raise ValueError("these answers are not the field estimator's.")
    truth = np.full(len(log.t_s), Z[0]), np.full(len(log.t_s), Z[1])
    spread = cycles.var_R, cycles.cov_RL, cycles.var_L
    return answers_of(
        log.t_s, truth, (cycles.R_g, cycles.L_g), spread, cycles.valid, cycles.changed,
        omega_n=study.converter.omega_n, end_s=study.simulation.duration,
    )  # fmt: skip


def logs_of(study: Study, sending: int | None = None) -> list[EstimateLog]:
    """The answers of all units. ``sending``: the only one that sends its probe; None: all do."""
    timeline, spec = plant_timeline(study), study.controllers[0]
    feeds = [ToldTheTruth(one, spec, probe=sending in (None, k)) for k, one in enumerate(timeline.units)]
    simulate_plant(study, feeds, timeline=timeline)  # the feeds keep the answers
    return [feed.log(one) for feed, one in zip(feeds, timeline.timelines, strict=True)]


def seen_alone(study: Study) -> list[tuple[float, float]]:
    """What each unit finds where it alone sends, Ω and H."""
    found = []
    for k in range(len(plant_timeline(study).units)):
        own = []
        for seed in ALONE_SEEDS:
            log = logs_of(drawn(study, seed), k)[k]
            if log.cycles is not None:
                rows = log.t_s > FROM_S
                own.append((np.mean(log.cycles.R_g[rows]), np.mean(log.cycles.L_g[rows])))
        R, L = np.mean(own, axis=0)
        found.append((float(R), float(L)))
    return found


def drawn(study: Study, seed: int) -> Study:
    """With noise of 0.2 % in the sensors, and a fifth and a seventh harmonic."""
    ranges = {"harmonic_5": (0.01, 0.03), "harmonic_7": (0.01, 0.03), "negative_sequence": (0.0, 0.01)}
    noise = {"noise": (0.002, 0.002)}
    return replace(
        study, background=draw_background(ranges, seed, "clean"), sensors=draw_sensors(noise, seed, "ideal", bits=12)
    )


def of_plant(case: str, units: int, scr: float, draws: int) -> dict[str, Any]:
    """Figures of a plant over all its units and draws."""
    base = study_of(case, units, scr, DURATION_S)
    truths, pools = seen_alone(base), []
    changes = heard = cycles = 0
    for seed in range(EVIDENCE_SEED, EVIDENCE_SEED + draws):
        study = drawn(base, seed)
        for log, Z in zip(logs_of(study), truths, strict=True):
            own = answers(study, log, Z)
            rows = (own.t_s > FROM_S) & (np.arange(len(own.t_s)) % STRIDE == 0)
            size = np.abs(own.Z + X_T * study.converter.Z_base)
            error = np.abs(own.Z_hat - own.Z) / size
            sigma = np.sqrt(np.trace(own.covariance, axis1=1, axis2=2)) / size
            pools.append(np.stack([error, sigma, own.valid, inside_ellipse(own)], axis=1)[rows])
            if log.cycles is not None:
                changes += int(log.cycles.changed[own.t_s > FROM_S].sum())
                heard += int(log.cycles.foreign.sum())
                cycles += len(log.cycles.foreign)
    error, sigma, valid, inside = np.concatenate(pools).T
    told = valid > 0.5
    rms = float(np.sqrt(np.mean(error[told] ** 2)))
    return {
        "case": case,
        "units": units,
        "scr": scr,
        "Z_pu": [[R / base.converter.Z_base, base.converter.omega_n * L / base.converter.Z_base] for R, L in truths],
        "p50": _percent(error[told], 0.5),
        "p95": _percent(error[told], 0.95),
        "coverage": 100.0 * float(inside[told].mean()),
        "sigma": 100.0 * float(np.median(sigma[told])),
        "sigma_over_rms": float(np.median(sigma[told])) / rms,
        "valid": 100.0 * float(valid.mean()),
        "false_changes": changes,
        "heard": heard,
        "seconds": draws * units * (DURATION_S - FROM_S),
    }


def on_one_pair(case: str, units: int, scr: float, draws: int) -> dict[str, Any]:
    """Units that all have pair 1, which no study may say: after how long each hears another one."""
    base = study_of(case, units, scr, DURATION_S)
    plant = base.plant
    if plant is None:
        raise ValueError("no plant")
    base = replace(base, plant=replace(plant, units=tuple(replace(one, pair=1) for one in plant.units)))
    waits, wrong = [], []
    for seed in range(EVIDENCE_SEED, EVIDENCE_SEED + draws):
        for log in logs_of(drawn(base, seed)):
            if log.cycles is None:
                continue
            at = np.flatnonzero(log.cycles.foreign > 0.5)
            waits.append(float(log.t_s[at[0]]) if len(at) else np.inf)
            wrong.append(float(log.cycles.valid[log.t_s > FROM_S].mean()))
    return {
        "case": case,
        "units": units,
        "scr": scr,
        "heard_s": float(np.median(waits)),
        "latest_s": float(np.max(waits)),
        "never": int(np.isinf(waits).sum()),
        "runs": len(waits),
        "valid": 100.0 * float(np.mean(wrong)),
    }


def _percent(values: NDArray[np.float64], at: float) -> float:
    return 100.0 * float(np.quantile(values, at))


def main(folder: Path) -> None:
    draws = max(round(share() * DRAWS), 1)
    rows = [of_plant(case, units, scr, draws) for case in CASES for units, scr in PLANTS]
    same = [on_one_pair(case, units, scr, max(draws // 2, 1)) for case in CASES for units, scr in PLANTS[:3]]
    head = ("converter", "units, SCR of one", "error of Z: median, p95", "coverage", "median σ", "σ over rms error")
    cells = [
        (
            one["case"],
            f"{one['units']}, {one['scr']:g}",
            f"{one['p50']:.1f}, {one['p95']:.1f} %",
            f"{one['coverage']:.1f} %",
            f"{one['sigma']:.1f} %",
            f"{one['sigma_over_rms']:.2f}",
            f"{one['valid']:.1f} %",
            str(one["false_changes"]),
            str(one["heard"]),
            f"{one['seconds']:.0f} s",
        )
        for one in rows
    ]
    first = table((*head, "valid", "false changes", "heard another", "of"), cells)
    head = ("converter", "units, SCR of one", "heard after: median, latest", "never within 12 s", "valid after 2 s")
    cells = [
        (
            one["case"],
            f"{one['units']}, {one['scr']:g}",
            f"{one['heard_s']:.1f} s, {one['latest_s']:.1f} s",
            f"{one['never']} of {one['runs']}",
            f"{one['valid']:.0f} %",
        )
        for one in same
    ]
    words = f"{draws} draws each; each unit on its own lines."
    wrong = "All units on pair 1, which a study may not say:"
    leave(folder, "plant_estimates", rows + same, [words, "", *first, "", wrong, "", *table(head, cells)])
