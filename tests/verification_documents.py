"""Documents of a verification as ``vsgdesign verify`` writes them, made from drawn numbers without any simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

Array = NDArray[np.float64]

SCR_EDGES = np.geomspace(1.5, 20.0, 13)
RATIO_EDGES = np.geomspace(0.3, 20.0, 11)
QUANTILES = ("50", "90", "99", "99.9")
PROMISES = {
    "overshoot": ("overshoot", 0.05),
    "settling": ("settling_s", 1.3),
    "survival": ("recovery_s", 2.8),
    "current": ("peak_pu", 1.26),
}


def document(*, runs: int = 6000, seed: int = 1, broken: bool = True, confidence: float = 0.99) -> dict[str, Any]:
    """Steps and jumps of the grid. Without ``broken``, no promise is broken in any case."""
    draw = np.random.default_rng(seed)
    scr: Any = np.exp(draw.uniform(np.log(1.5), np.log(20.0), runs))
    ratio: Any = np.exp(draw.uniform(np.log(0.3), np.log(20.0), runs))
    powers = draw.uniform(-0.9, 0.9, (2, runs)) * np.array([[1.0], [0.4]])
    errors = draw.uniform(-0.2, 0.2, (2, runs))
    is_step = draw.random(runs) < 0.6
    left_out = (scr < 1.8) & (np.abs(powers[0]) > 0.75)
    diverged = broken & ~is_step & (scr > 19.0) & (ratio > 15.0)
    weak = np.log(20.0 / scr) / np.log(20.0 / 1.5)
    largest = 0.068 if broken else 0.046
    overshoot = largest * weak**2 * (1.0 - np.log(ratio / 0.3) / 6.0) * draw.uniform(0.2, 1.0, runs)
    settling = 0.8 + 0.45 * draw.beta(4.0, 4.0, runs) * (0.6 + 0.4 * weak)
    peak = 0.5 + 0.72 * draw.beta(6.0, 2.0, runs)
    recovery = np.where(diverged, np.nan, 0.6 + 1.4 * draw.beta(2.0, 6.0, runs))
    families: dict[str, Any] = {}
    bins: dict[str, Any] = {}
    values = {"overshoot": overshoot, "settling": settling, "survival": recovery, "current": peak}
    for name, member, promised in (
        ("step", is_step, ("overshoot", "settling", "current")),
        ("grid", ~is_step, ("survival", "current")),
    ):
        judged = member & ~left_out
        families[name] = {
            "drawn": int(member.sum()),
            "judged": int(judged.sum()),
            "left_out": {
                "over limit": int((member & left_out & (powers[1] > 0.0)).sum()),
                "kept apart: no rest": int((member & left_out & (powers[1] <= 0.0)).sum()),
            },
            "lost": {"diverged": int((judged & diverged).sum())},
            "promises": {key: _promise(key, values[key][judged], confidence) for key in promised},
        }
        is_broken = judged & np.any([~(values[key] <= PROMISES[key][1]) for key in promised], axis=0)
        bins[name] = {
            "judged": _counts(scr[judged], ratio[judged]),
            "broken": _counts(scr[is_broken], ratio[is_broken]),
            "worst_of": {PROMISES[key][0]: _worst(scr[judged], ratio[judged], values[key][judged]) for key in promised},
        }
    scores = np.where(left_out | ~is_step, -1.0, overshoot)
    worst = [
        _case(
            rank, int(k), "step", "overshoot", overshoot[k], settling[k], scr[k], ratio[k], powers[:, k], errors[:, k]
        )
        for rank, k in enumerate(np.argsort(-scores)[:20], start=1)
    ]
    found = _case(1, 7, "step", "overshoot", 0.0561, 1.21, 1.5, 0.3, np.array([-0.9, 0.4]), np.array([0.2, -0.2]))
    return {
        "study": "table",
        "controller": "table",
        "title": "Published 5 kVA system: a gain table robust to 20 % estimate error",
        "seed": seed,
        "confidence": confidence,
        "runs": runs,
        "judged": int((~left_out).sum()),
        "families": families,
        "map": {
            "scr_basis": "impedance",
            "scr_edges": SCR_EDGES.tolist(),
            "x_over_r_edges": RATIO_EDGES.tolist(),
            "families": bins,
        },
        "worst": worst,
        "search": {"evaluations": 640, "found": [found | {"study": "found/01.toml"}]},
        "distributions": [
            {"quantity": "SCR", "words": "uniform in the logarithm, 1.5 to 20"},
            {"quantity": "X/R", "words": "uniform in the logarithm, 0.3 to 20"},
            {"quantity": "P", "words": "uniform, −0.9 to 0.9 pu"},
            {"quantity": "errors of R_g and L_g", "words": "uniform, −20 % to 20 %, each by itself"},
        ],
        "timing_s": {"compile": 0.31, "rests": 5.2, "simulate": 31.4, "search": 2.8},
        "instruction_set": "AVX-512",
        "strict": False,
        "workers": 2,
        "provenance": {"vsgdesign": "0.4.0"},
    }


def _promise(name: str, values: Array, confidence: float) -> dict[str, Any]:
    figure, limit = PROMISES[name]
    known = np.sort(np.where(np.isnan(values), np.inf, values))
    broken, judged = int((known > limit).sum()), len(known)
    bound = 1.0 if broken == judged else float(beta.ppf(confidence, broken + 1, judged - broken))
    one_in = int(1.0 / bound)
    quantiles = {q: float(np.quantile(known, float(q) / 100.0, method="higher")) for q in QUANTILES}
    return {
        "figure": figure,
        "survival": name == "survival",
        "limit": limit,
        "unit": {"overshoot": "1", "peak_pu": "pu"}.get(figure, "s"),
        "at_least": False,
        "broken": broken,
        "judged": judged,
        "share": broken / judged,
        "bound": bound,
        "one_in": int(f"{one_in}"[:3].ljust(len(f"{one_in}"), "0")),
        "worst": _finite(known[-1]),
        "quantiles": {q: _finite(value) for q, value in quantiles.items()},
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _counts(scr: Array, ratio: Array) -> list[list[int]]:
    return np.histogram2d(scr, ratio, (SCR_EDGES, RATIO_EDGES))[0].astype(int).tolist()


def _worst(scr: Array, ratio: Array, values: Array) -> list[list[float | None]]:
    found: list[list[float | None]] = [[None] * (len(RATIO_EDGES) - 1) for _ in SCR_EDGES[1:]]
    for i in range(len(SCR_EDGES) - 1):
        for j in range(len(RATIO_EDGES) - 1):
            inside = (scr >= SCR_EDGES[i]) & (scr <= SCR_EDGES[i + 1])
            inside &= (ratio >= RATIO_EDGES[j]) & (ratio <= RATIO_EDGES[j + 1])
            if inside.any():
                found[i][j] = _finite(float(values[inside].max()))  # NaN where one is: null, but judged
    return found


def _case(
    rank: int,
    case: int,
    family: str,
    promise: str,
    overshoot: float,
    settling: float,
    scr: float,
    ratio: float,
    powers: Array,
    errors: Array,
) -> dict[str, Any]:
    P, Q = (float(value) for value in powers)
    study = f"worst/{rank:02d}-case-{case}.toml"
    return {
        "rank": rank,
        "case": case,
        "family": family,
        "promise": promise,
        "figures": {"overshoot": float(overshoot), "settling_s": float(settling), "peak_pu": 1.01},
        "start": {
            "scr": float(scr),
            "x_over_r": float(ratio),
            "P_pu": P,
            "Q_pu": Q,
            "V_g_pu": 1.0,
            "f_hz": 50.0,
            "error_R": float(errors[0]),
            "error_X": float(errors[1]),
        },
        "what": f"P_ref {P:+.2f} → {P + 0.05:+.2f} pu at 0.1 s",
        "broken": [promise] if overshoot > PROMISES["overshoot"][1] else [],
        "why": "the voltage clips at its limit" if overshoot > PROMISES["overshoot"][1] else None,
        "study": study,
    }
