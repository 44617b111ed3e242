"""The field estimator where the grid is not a series R and L: capacitors, cables, loads and inverters at its node.

Errors are relative to the grid's own impedance at nominal frequency, loads and capacitances included, inverters not
(:eq:`plant-grid`). Gains are told the true grid, but beside inverters the estimate drives them.
``VSGDESIGN_FIELD_SHARE=0.5`` measures half of the draws.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from evidence._field_converters import CONVERTERS
from evidence._field_other_grids import OtherGrid, run_other_grid
from evidence._kept_runs import first_seed, kept_runs, share
from evidence._tables import leave, table

DRAWS = 20
"""Of each group and converter."""

Draw = Callable[[np.random.Generator], dict[str, Any]]


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Logarithmically."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _capacitor(low: float, high: float) -> Draw:
    """Its susceptance is at most 0.5 pu."""

    def draw(rng: np.random.Generator) -> dict[str, Any]:
        f = _between(rng, low, high)
        return {"kind": "resonance", "size": f, "scr": _between(rng, max(1.5, 2.0 * (60.0 / f) ** 2), 15.0)}

    return draw


def _inverter(sizes: tuple[float, float], scr: tuple[float, float]) -> Draw:
    return lambda rng: {
        "kind": "inverter",
        "size": _between(rng, *sizes),
        "scr": _between(rng, *scr),
        "pll_hz": _between(rng, 20.0, 50.0),
        "drives": True,
    }


GROUPS: dict[str, Draw] = {
    "R–L": lambda rng: {"kind": "plain", "size": 0.0, "scr": _between(rng, 1.5, 15.0)},
    "capacitor, resonance 250–350 Hz": _capacitor(250.0, 350.0),
    "capacitor, resonance 350–500 Hz": _capacitor(350.0, 500.0),
    "cable of 5–10 km": lambda rng: {"kind": "cable", "size": _between(rng, 5, 10), "scr": _between(rng, 2.5, 15.0)},
    "load of 0.1–0.6 pu": lambda rng: {
        "kind": "load", "size": _between(rng, 0.1, 0.6), "scr": _between(rng, 1.5, 15.0),
    },
    "the same, a step": lambda rng: {
        "kind": "load step", "size": _between(rng, 0.1, 0.6), "scr": _between(rng, 1.5, 15.0),
    },
    "inverter of 0.5–1, SCR 5–15": _inverter((0.5, 1.0), (5.0, 15.0)),
    "inverter of 0.5–1, SCR 2–5": _inverter((0.5, 1.0), (2.0, 5.0)),
    "inverter of 1–2, SCR 2.5–15": _inverter((1.0, 2.0), (2.5, 15.0)),
}  # fmt: skip


def draws(count: int) -> list[tuple[str, OtherGrid]]:
    """All runs with their groups."""
    found = []
    for at, (name, draw) in enumerate(GROUPS.items()):
        for converter in CONVERTERS:
            for seed in range(first_seed(), first_seed() + count):
                rng = np.random.default_rng([seed, at])
                drawn = draw(rng)
                found.append((name, OtherGrid(converter, x_over_r=_between(rng, 1.0, 15.0), seed=seed, **drawn)))
    return found


def figures(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Of a group of runs."""
    done = [one for one in runs if "left_out" not in one]
    rows = np.concatenate([np.array(one["rows"]) for one in done]) if done else np.zeros((0, 5))
    error, sigma, valid, inside, measured = rows.T
    told = valid > 0.5
    most = [np.mean(np.array(one["rows"])[:, 2]) > 0.5 for one in done]
    settled = [one.get("settling_s") for one in done if "settling_s" in one]
    return {
        "runs": len(done),
        "left_out": len(runs) - len(done),
        "valid": float(valid.mean()),
        "valid_runs": float(np.mean(most)),
        "coverage": float(inside[told].mean()) if told.any() else None,
        "p50": _quantile(error[told], 0.5),
        "p95": _quantile(error[told], 0.95),
        "measured_p95": _quantile((error * measured)[told], 0.95),
        "sigma": _quantile(sigma[told], 0.5),
        "said": float(np.mean([1.0 - one["passive"] for one in done])),
        "changes": sum(one["changes"] for one in done),
        "events": sum(one["events"] for one in done),
        "slowest_s": None if not settled else max((np.inf if one is None else one) for one in settled),
    }


def _quantile(values: Any, at: float) -> float | None:
    return float(np.quantile(values, at)) if len(values) else None


def main(folder: Path) -> None:
    every = draws(max(round(share() * DRAWS), 1))
    found = kept_runs(run_other_grid, [grid for _, grid in every], folder / "other_grids.journal", "other grids")
    rows = []
    for group in GROUPS:
        for converter in CONVERTERS:
            mine = [
                run for (name, grid), run in zip(every, found, strict=True)
                if name == group and grid.converter == converter
            ]  # fmt: skip
            rows.append({"group": group, "converter": converter} | figures(mine))
    head = (
        "grid", "converter", "runs", "valid; in more than half of the time", "coverage", "error: median, p95",
        "of what is measured: p95", "σ", "said: no R–L–C", "events, changes", "slowest step",
    )  # fmt: skip
    cells = [
        (
            one["group"],
            one["converter"],
            f"{one['runs']}" + (f", {one['left_out']} not possible" if one["left_out"] else ""),
            f"{_percent(one['valid'], 0)}; {_percent(one['valid_runs'], 0)}",
            _percent(one["coverage"]),
            f"{_percent(one['p50'])}, {_percent(one['p95'])}",
            _percent(one["measured_p95"]),
            _percent(one["sigma"]),
            _percent(one["said"], 0),
            f"{one['events']}, {one['changes']}",
            "–" if one["slowest_s"] is None else f"{one['slowest_s']:.2f} s",
        )
        for one in rows
    ]
    leave(folder, "other_grids", rows, table(head, cells))


def _percent(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{100 * value:.{digits}f} %"
