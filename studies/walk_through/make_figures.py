"""Draws the figures of docs/walk-through.md: `python studies/walk_through/make_figures.py [FOLDER]`."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray
from scipy.optimize import least_squares

from vsgdesign.linear.model.full_order import PARAMETERS
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.loci import modes
from vsgdesign.linear.stability.maps import cells_under, full_order_cells, grid_arrays, margin_map
from vsgdesign.report.drawing.style import COLOURS, PAGE_IN, add_axes, look, new_figure
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Event

ROOT = Path(__file__).resolve().parents[2]
Array = NDArray[np.float64]

P, Q = 2000.0, 0.0
SCR = (2.0, 3.0, 5.0, 8.0, 12.5, 20.0)
X_OVER_R = (0.3, 0.5, 0.7, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0)
SLOW_CELL, FAST_CELL = (5.0, 0.3), (20.0, 20.0)
UNSTABLE = "#D55E00"
ENVELOPE = "$e^{\\sigma t}$ of the eigenvalue"


def published() -> Study:
    """The published study with its scheduled controller alone."""
    study = load_study(ROOT / "studies" / "published" / "study.toml")
    return replace(study, controllers=(study.controllers[1],))


def full_order(study: Study, scr: float, x_over_r: float) -> FullOrderModel:
    """The full-order model of one cell."""
    R_g, L_g = grid_arrays(study, np.array([scr]), np.array([x_over_r]))
    law = gain_law(study, study.controllers[0])
    return full_order_cells(study, cells_under(study, law, R_g, L_g, P, Q))


def emt(study: Study, model: FullOrderModel, event: Event, duration: float, log: float) -> tuple[Array, Array]:
    """Time and P, in W away from the cell's, of an EMT run that starts at rest in the cell."""
    p = dict(zip(PARAMETERS, model.p[0], strict=False))
    simulation = replace(  # averaged: ripple would hide what grows from a disturbance this small
        study.simulation,
        bridge="averaged",
        duration=duration,
        log_interval=log,
        P_ref=float(p["P_ref"]),
        Q_ref=float(p["Q_ref"]),
    )
    run = replace(study, grid=Grid(float(p["R_g"]), float(p["L_g"])), events=(event,), simulation=simulation)
    series = run_scenario(run).controllers[0].series
    return series["t_s"], series["P_pcc"] - P


def fit(t: Array, y: Array, guess: complex, drift: int) -> complex:
    """s of the one growing oscillation in y, with a polynomial of that degree beside it (variable projection)."""

    def rest(x: Array) -> Array:
        wave = np.exp((x[0] + 1j * x[1]) * (t - t[-1]))
        basis = np.column_stack([wave.real, wave.imag, *(((t - t[0]) / (t[-1] - t[0])) ** k for k in range(drift + 1))])
        return basis @ np.linalg.lstsq(basis, y, rcond=None)[0] - y

    x = least_squares(rest, [guess.real, guess.imag], x_scale=[1.0, 1.0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    return complex(x[0], x[1])


def draw_maps(study: Study) -> Any:
    """Disk margin over SCR × X/R in both models."""
    figure = new_figure(PAGE_IN, 3.35)
    law = gain_law(study, study.controllers[0])
    colours = LinearSegmentedColormap.from_list("margin", ["#FFFFFF", "#BFD9EA", "#0072B2"])
    scale = Normalize(0.0, 1.5)
    for k, (model, title) in enumerate((("reduced", "Reduced: coupled power loops"), ("full_order", "Full order"))):
        map_ = margin_map(study, law, SCR, X_OVER_R, [P], [Q], model)
        margin, stable = map_.field(map_.table.disk_output.value)[..., 0], map_.stable[..., 0]
        axes = add_axes(figure, 0.55 + k * 3.4, 0.68, 3.0, 2.4)
        axes.grid(visible=False)
        for i in range(len(SCR)):
            for j in range(len(X_OVER_R)):
                red = stable[i, j] == 0.0
                face = UNSTABLE if red else colours(scale(margin[i, j]))
                axes.add_patch(
                    Rectangle((i - 0.5, j - 0.5), 1, 1, facecolor=face, edgecolor="white", hatch="//" if red else "")
                )
                text = "unstable" if red else f"{margin[i, j]:.2f}"
                dark = red or margin[i, j] > 1.0
                box = {"facecolor": UNSTABLE, "edgecolor": "none", "pad": 0.5} if red else None
                axes.text(i, j, text, ha="center", va="center", fontsize=6.0, color="w" if dark else "k", bbox=box)
        cells = (SLOW_CELL,) if model == "reduced" else (SLOW_CELL, FAST_CELL)
        for cell, name in zip(cells, "AB", strict=False):
            at = SCR.index(cell[0]), X_OVER_R.index(cell[1])
            axes.add_patch(Rectangle((at[0] - 0.5, at[1] - 0.5), 1, 1, fill=False, edgecolor="k", linewidth=1.4))
            box = {"facecolor": "k", "edgecolor": "none", "pad": 1.0}
            axes.text(at[0] - 0.46, at[1] + 0.44, name, ha="left", va="top", fontsize=6, color="w", bbox=box)
        axes.set_xlim(-0.5, len(SCR) - 0.5)
        axes.set_ylim(-0.5, len(X_OVER_R) - 0.5)
        axes.set_xticks(range(len(SCR)), [f"{value:g}" for value in SCR])
        axes.set_yticks(range(len(X_OVER_R)), [f"{value:g}" for value in X_OVER_R])
        axes.set_xlabel("Short-circuit ratio, on the reactance [–]")
        axes.set_ylabel("X/R [–]")
        axes.set_title(title)
    figure.legend(
        handles=[
            Patch(facecolor=colours(0.8), label="disk margin α [–], as numbered"),
            Patch(facecolor=UNSTABLE, hatch="//", edgecolor="white", label="unstable"),
        ],
        loc="lower left",
        bbox_to_anchor=(0.55 / PAGE_IN, 0.03),
        ncols=2,
    )
    return figure


def draw_slow(study: Study) -> Any:
    """Cell A: the EMT's trace inside the envelope of the eigenvalue."""
    model = full_order(study, *SLOW_CELL)
    s = modes(model.states, model.A[0], model.T_s)[0].s
    step = Event(1.0, "P_ref + 1 W", P_ref=float(model.p[0, PARAMETERS.index("P_ref")]) + 1.0)
    t, y = emt(study, model, step, 16.0, 1e-3)
    late = t > 3.0
    found = fit(t[late], y[late], s, 0)
    print(f"A: eigenvalue {s:.5f}, EMT {found:.5f} 1/s")
    figure = new_figure(PAGE_IN, 2.1)
    axes = add_axes(figure, 0.6, 0.42, 4.6, 1.45)
    axes.plot(t, y, color=COLOURS[0], label="EMT")
    last = np.max(np.abs(y[t > t[-1] - 2.0 * np.pi / abs(s.imag)] - 1.0))
    after = t[t >= 1.0]
    for sign, label in ((1.0, ENVELOPE), (-1.0, None)):
        envelope = 1.0 + sign * last * np.exp(s.real * (after - t[-1]))
        axes.plot(after, envelope, color="k", linestyle="--", linewidth=0.8, label=label)
    axes.set_xlim(0.0, t[-1])
    axes.set_xlabel("Time [s]")
    axes.set_ylabel("P − 2 kW [W]")
    axes.set_title("A: SCR 5, X/R 0.3. $P_\\mathrm{ref}$ is raised by 1 W at 1 s")
    axes.legend(loc="upper left", borderaxespad=0.6)
    draw_participation(figure, model)
    return figure


def draw_participation(figure: Any, model: FullOrderModel) -> None:
    """Bars of the least stable mode's participation, right of the trace."""
    mode = modes(model.states, model.A[0], model.T_s, count=6)[0]
    axes = add_axes(figure, 5.85, 0.42, 1.15, 1.45)
    names, shares = zip(*mode.participation, strict=True)
    axes.barh(range(len(names)), shares, color=COLOURS[0], height=0.65)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("Participation [–]")


def draw_fast(study: Study) -> Any:
    """Cell B: published feed-forward against 1 % less."""
    figure = new_figure(PAGE_IN, 2.1)
    axes = add_axes(figure, 0.6, 0.42, 4.6, 1.45)
    jump = Event(0.05, "phase", phase_jump=1e-5)
    worst: FullOrderModel | None = None
    for k, K_ff in enumerate((1.0, 0.99)):
        one = replace(study, inner_gains=study.inner_gains._replace(K_ff=K_ff))
        model = full_order(one, *FAST_CELL)
        found = [mode.s for mode in modes(model.states, model.A[0], model.T_s)]
        s = min(found, key=lambda value: abs(value - 326j))
        t, y = emt(one, model, jump, 0.45, 5e-5)
        late = (t > 0.06) if K_ff < 1.0 else (t > 0.15)
        if K_ff == 1.0:
            fitted = fit(t[late], y[late], s, 3)
            print(f"B: eigenvalue {s:.5f}, EMT {fitted:.5f} 1/s")
            last = np.max(np.abs(y[t > t[-1] - 2.0 * np.pi / abs(s.imag)]))
            envelope = last * np.exp(s.real * (t[t > 0.05] - t[-1]))
            axes.semilogy(t[t > 0.05], envelope, color="k", linestyle="--", linewidth=0.9, zorder=5, label=ENVELOPE)
            worst = model
        else:
            print(f"B with K_ff {K_ff}: eigenvalue {s:.3f}, largest real part {max(v.real for v in found):.3f}")
        label = f"EMT, $K_\\mathrm{{ff}}$ = {K_ff:g}"
        axes.semilogy(t, np.abs(y), color=COLOURS[1 - k], linewidth=0.7, zorder=3 + k, label=label)
        axes.set_xlim(0.0, t[-1])
    axes.set_xlabel("Time [s]")
    axes.set_ylabel("|P − 2 kW| [W]")
    axes.set_ylim(1e-3, 1e3)
    axes.set_title("B: SCR 20, X/R 20. The grid's phase jumps by 10 µrad at 0.05 s")
    axes.legend(loc="upper left", borderaxespad=0.6)
    if worst is not None:
        draw_participation(figure, worst)
    return figure


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "figures"
    study = published()
    for name, draw in (("maps", draw_maps), ("slow", draw_slow), ("fast", draw_fast)):
        with look():
            draw(study).savefig(folder / f"walk_through_{name}.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
