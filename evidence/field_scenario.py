"""The paper's 60 s scenario with the field estimator, beside a schedule that is told the truth.

Every seed is another draw of the study's background, without its wander, and sensors. Steps are judged beside their
twins, as ``vsgdesign simulate`` does it. Both runs send the probe, so that they differ by the estimate alone.
``VSGDESIGN_FIELD_SHARE=0.2`` measures a fifth of the seeds.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from evidence._kept_runs import share
from evidence._tables import leave, table
from evidence.twin import WANDER
from vsgdesign.equations.field import FieldAnswer
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.metrics import EndState, EventWindow, cycle_mean, measure_event
from vsgdesign.simulation import simulate
from vsgdesign.simulation.every_sample import SignalsAtPcc, signals_at_pcc, with_every_sample, without_steps
from vsgdesign.simulation.field_feed import FieldScheduler, MeasuredCycle
from vsgdesign.simulation.scenario import samples_per_mean
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.simulation.twin import steps_with_twin
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.background import draw_background
from vsgdesign.study.parameters.study import Study

STUDY = Path(__file__).resolve().parents[1] / "studies" / "field" / "study.toml"
SEEDS, FIRST_SEED = 10, 100000

REST_S = 3.0
"""End of each stretch that counts as rest, s."""


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
    ranges = dict(study.background.ranges) | dict.fromkeys(WANDER, (0.0, 0.0))
    background = draw_background(ranges, seed, study.background.level)
    drawn = replace(study, background=background, sensors=study.sensors.redrawn(seed))
    spec = next(one for one in study.controllers if one.estimate == "field")
    runs = {"truth": ToldTheTruth, "field": FieldScheduler}
    rows = [{"seed": seed, "event": event.name, "t_s": event.t_s} for event in study.events]
    ends = [*(event.t_s for event in study.events[1:]), study.simulation.duration]
    own = with_every_sample(drawn.with_limit_of(spec))
    for name, scheduler in runs.items():
        simulation = simulate(own, scheduler(own, spec), twins=steps_with_twin(own, spec)).to_its_end()
        seen = signals_at_pcc(own, simulation)
        without = without_steps(own, simulation, seen)
        for row, event, end_s in zip(rows, study.events, ends, strict=True):
            signal = "Q_pcc" if event.Q_ref is not None else "P_pcc"
            window = EventWindow(event.name, event.t_s, end_s, event.grid is None)
            row[name] = _figures(own, seen, without.get(event.t_s), signal, window)
    return rows


def _figures(
    study: Study, seen: SignalsAtPcc, without: SignalsAtPcc | None, signal: str, window: EventWindow
) -> dict[str, float]:
    """Overshoot (%) of a step, and the settling time: of a step beside its twin, or after a change of the grid until
    the mean stays within 2 % of the rating. A schedule that moves on all the time has no model of how it goes on."""
    S, per_mean = study.converter.S_rated, samples_per_mean(study, seen.t_s)
    y, twin = getattr(seen, signal), None if without is None else getattr(without, signal)
    end = EndState(None, math.inf)
    figures = measure_event(window, signal, seen.t_s, y, S, per_mean, end, twin)
    settled, over = figures.cycle_mean.settling_time_s, figures.cycle_mean.overshoot_pct
    found = {"settling_s": math.inf if settled is None else settled}
    if over is not None and figures.noise is not None:
        found |= {"overshoot_pct": over, "noise_pct": 100.0 * figures.noise.share}
    rest = cycle_mean(y, per_mean)[(seen.t_s > window.end_s - REST_S) & (seen.t_s < window.end_s)]
    return found | {"ripple_pct": 100.0 * float(rest.std()) / S}


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
