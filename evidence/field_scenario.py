"""The paper's 60 s scenario with the field estimator, beside a schedule that is told the truth.

Every seed is another draw of the study's background and sensors. Overshoot and 5 % settling time are read from means
over 40 ms, which hold no ripple of the probe's lines. Both runs send the probe, so that they differ by the estimate
alone. ``VSGDESIGN_FIELD_SHARE=0.2`` measures a fifth of the seeds.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._kept_runs import share
from evidence._tables import leave, table
from vsgdesign.equations.field import FieldAnswer
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.metrics import cycle_mean
from vsgdesign.simulation import simulate
from vsgdesign.simulation.field_feed import FieldScheduler, MeasuredCycle
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study

STUDY = Path(__file__).resolve().parents[1] / "studies" / "field" / "study.toml"
SEEDS, FIRST_SEED = 10, 100000

BAND, MEAN_S, REST_S = 0.05, 0.04, 3.0
"""Band of the settling time, length of the means, and end of each stretch that counts as rest, s."""


class ToldTheTruth(FieldScheduler):
    """A schedule that is told the true grid, and sends the probe all the same."""

    def begin(self) -> FieldScheduler:
        """Starts on the true grid."""
        super().begin()
        self._timeline = build_timeline(self._study)
        self._first = self._answers.first(self._timeline.grid_at(0.0))
        return self

    def _followed(self, answer: FieldAnswer, measured: MeasuredCycle) -> tuple[PowerLoopGains | None, bool]:  # noqa: ARG002
        grid = self._timeline.grid_at(measured.t_s - 0.5 * self._study.converter.T_s)
        return self._answers.to(measured, grid.R_g, grid.L_g)


def run_of(study: Study, seed: int) -> list[dict[str, Any]]:
    """Figures of every event, with the truth and with the estimate."""
    if study.background is None or study.sensors is None:
        raise ValueError(f"{STUDY}: the study must have a background and sensors to draw.")
    drawn = replace(study, background=study.background.redrawn(seed), sensors=study.sensors.redrawn(seed))
    spec = next(one for one in study.controllers if one.estimate == "field")
    runs = {"truth": ToldTheTruth(drawn, spec), "field": FieldScheduler(drawn, spec)}
    rows = [{"seed": seed, "event": event.name, "t_s": event.t_s} for event in study.events]
    ends = [*(event.t_s for event in study.events[1:]), study.simulation.duration]
    for name, scheduler in runs.items():
        simulation = simulate(drawn, scheduler).to_its_end()
        t_s, step = simulation.t_s, float(simulation.t_s[1] - simulation.t_s[0])
        means = {signal: cycle_mean(simulation.column(signal), round(MEAN_S / step)) for signal in ("P", "Q")}
        for row, event, end_s in zip(rows, study.events, ends, strict=True):
            signal = "Q" if event.Q_ref is not None else "P"
            row[name] = _figures(t_s, means[signal], event.t_s, end_s, study.converter.S_rated, event.grid is None)
    return rows


def _figures(
    t_s: NDArray[np.float64], y: NDArray[np.float64], begin: float, end: float, rating: float, step: bool
) -> dict[str, float]:
    """Overshoot (%) of a step, and time until the mean stays within the band: of the step, or of 0.4 times 5 % of the
    rating after a change of the grid (100 W of 5 kW)."""
    before = float(y[(t_s > begin - 1.0) & (t_s < begin)].mean())
    after = float(y[(t_s > end - REST_S) & (t_s < end)].mean())
    rows = (t_s >= begin) & (t_s < end - REST_S)
    band = BAND * abs(after - before) if step else 0.02 * rating
    off = np.flatnonzero(np.abs(y[rows] - after) > band)
    found = {"settling_s": float(t_s[rows][off[-1]] - begin) if len(off) else 0.0}
    if step:
        found["overshoot_pct"] = 100.0 * max(float(np.max((y[rows] - before) / (after - before))) - 1.0, 0.0)
    rest = y[(t_s > end - REST_S) & (t_s < end)]
    return found | {"ripple_pct": 100.0 * float(rest.std()) / rating}


def main(folder: Path) -> None:
    study = load_study(STUDY)
    rows = [row for k in range(max(round(share() * SEEDS), 1)) for row in run_of(study, FIRST_SEED + k)]
    head = ("event", "overshoot: truth, estimate [%]", "largest difference [points]", "settling: truth, estimate [s]")
    cells = []
    for name in dict.fromkeys(row["event"] for row in rows):
        mine = [row for row in rows if row["event"] == name]

        over, settling, ripple = (
            [np.array([row[who].get(key, math.nan) for row in mine]) for who in ("truth", "field")]
            for key in ("overshoot_pct", "settling_s", "ripple_pct")
        )
        none = bool(np.isnan(over[0]).all())
        shown = (
            name,
            "–" if none else f"{np.median(over[0]):.1f}, {np.median(over[1]):.1f}",
            "–" if none else f"{np.max(over[1] - over[0]):+.1f}",
            f"{np.median(settling[0]):.2f}, {np.median(settling[1]):.2f}",
            f"{np.max(settling[1] - settling[0]):+.2f}",
            f"{np.median(ripple[0]):.2f}, {np.median(ripple[1]):.2f}",
        )
        cells.append(shown)
    words = f"{len({row['seed'] for row in rows})} seeds; medians, and the largest of the pairs."
    lines = table((*head, "largest delay [s]", "ripple at rest: truth, estimate [% of the rating]"), cells)
    leave(folder, "field_scenario", rows, [words, "", *lines])
