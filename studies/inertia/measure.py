"""Inertia and damping of the constant-inertia table: python studies/inertia/measure.py TABLE.json [FIGURE.png]"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.artifacts.gain_table_file import read_table_file
from vsgdesign.design.box import scenarios_of_truth
from vsgdesign.design.evaluation import evaluate_gains
from vsgdesign.design.verification import full_order_figures
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.report.drawing.style import COLOURS, COLUMN_IN, REFERENCE, add_axes, look, new_figure
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.runtime.table import table_schedule
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.steps import references_at
from vsgdesign.study.parameters import Event, GridSource, Study, load_study
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.specification import Specification

HERE = Path(__file__).resolve().parent
CELLS = [(scr, ratio) for scr in (1.2, 3.0, 20.0) for ratio in (0.5, 5.0, 20.0)]
RATES = (0.1, 0.25, 0.5)
"""Hz/s."""
DASHES = ("-", (0, (5, 1.2)), (0, (1.3, 1.1)))
"""Lines of the three X/R; an SCR has one colour."""

START, RAMP = 0.2, 3.0
P_0, Q_0 = 300e3, 0.0


def ramp(study: Study, gains: PowerLoopGains, scr: float, x_over_r: float, rate_hz_s: float) -> tuple[Any, Any]:
    """Time from the start of a falling ramp in s and what P gains in W."""
    grid = Place(scr, x_over_r, "impedance").grid(study.converter)
    omega_0 = study.converter.omega_n
    P_ref, Q_ref = references_at(study, grid, gains, P_0, Q_0)
    fall = Event(START, "ramp", omega_g=omega_0 - 2.0 * np.pi * rate_hz_s * RAMP, over=RAMP)
    spec = replace(
        study.simulation, duration=START + RAMP, start="steady_state", bridge="averaged", P_ref=P_ref, Q_ref=Q_ref
    )
    source = GridSource(study.grid_source.V_g_rms, omega_0)
    study = replace(study, grid=grid, grid_source=source, simulation=spec, events=(fall,))
    run = simulate(study, [GainChange(0.0, gains)])
    return run.t_s - START, run.column("P") - P_0


def specification_of(study: Study) -> Specification:
    """What the study's table was asked for."""
    if study.specification is None:
        raise SystemExit("specification: the study asks for no table")
    return study.specification


def damping(study: Study, schedule: Schedule, scr: float, x_over_r: float) -> tuple[float, float, float]:
    """Least over the box: damping ratio of the power loops, of every mode of the full order, full-order disk margin."""
    s = scenarios_of_truth(study, specification_of(study), scr, x_over_r, P_0, Q_0)
    gains = schedule.gains_measured(s.R_hat - schedule.R_2, s.X_hat / schedule.omega - schedule.L_2, s.P, s.Q, s.V_rms)
    loops = evaluate_gains(gains, s, 1.0, study.power_lags)
    full = full_order_figures(study, gains, s, 1.0)
    return float(loops.damping_ratio.min()), float(full.damping_ratio.min()), float(full.disk_margin.min())


def main() -> None:
    """Print a line for every cell and rate, and draw the ramps of 0.25 Hz/s."""
    study = load_study(HERE / "study.toml")
    schedule = table_schedule(read_table_file(sys.argv[1]))
    # Without droop: with it the droop's own power grows along the ramp, and lags behind.
    plain = replace(schedule, P=P_0, Q=Q_0, D_p=0.0)
    H, c = specification_of(study).H, study.converter
    if H is None:
        raise SystemExit("specification.H: the study holds no inertia")
    print(
        " SCR  X/R | inertial power at 0.1, 0.25, 0.5 Hz/s, off by [%] | least damping: loops, full order | disk margin"
    )
    curves = []
    for scr, ratio in CELLS:
        grid = Place(scr, ratio, "impedance").grid(c)
        gains = plain.gains(grid.R_g, grid.L_g)
        off = []
        for rate in RATES:
            t_s, power = ramp(study, gains, scr, ratio, rate)
            asked = 2.0 * H * c.S_rated / c.omega_n * 2.0 * np.pi * rate
            off.append(100.0 * (float(power[t_s > RAMP - 0.1].mean()) / asked - 1.0))
            if rate == RATES[1]:
                curves.append((f"SCR {scr:g}, X/R {ratio:g}", t_s, power, asked))
        loops, full, margin = damping(study, schedule, scr, ratio)
        shown = "  ".join(f"{value:+.2f}" for value in off)
        print(f"{scr:4g} {ratio:4g} |  {shown}  |  {loops:.2f}  {full:.3f}  |  {margin:.2f}")
    if len(sys.argv) > 2:
        draw(curves, Path(sys.argv[2]))


def draw(curves: list[tuple[str, Any, Any, float]], path: Path) -> None:
    """What P gains during a ramp, on every cell, against 2HS/ω_0·RoCoF."""
    with look():
        figure = new_figure(COLUMN_IN, 2.6)
        axes = add_axes(figure, 0.45, 0.37, 2.97, 2.15)
        for k, (name, t_s, power, _) in enumerate(curves):
            axes.plot(t_s, power / 1e3, label=name, color=COLOURS[k // 3], linestyle=DASHES[k % 3], linewidth=1.0)
        axes.axhline(curves[0][3] / 1e3, **REFERENCE)
        axes.annotate("$2HS/ω_0$·RoCoF", (1.5, curves[0][3] / 1e3), (0, 3), textcoords="offset points")
        axes.set_xlim(-START, RAMP)
        axes.set_xlabel("time from the start of the ramp [s]")
        axes.set_ylabel("ΔP [kW]")
        axes.legend(loc="lower right", bbox_to_anchor=(0.97, 0.04))
        figure.savefig(path)


if __name__ == "__main__":
    main()
