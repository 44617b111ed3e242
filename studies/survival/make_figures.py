"""Draws the figures of docs/survival.md: python studies/survival/make_figures.py [MEASURED] [FIGURES]

MEASURED is the folder of measure_maps.py (out/survival); FIGURES takes the pictures (docs/figures).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from measure_maps import (
    CLEARING_POWERS,
    DEPTHS,
    LENGTHS_S,
    LOADED,
    PHASES,
    POWERS,
    SCR,
    TRACED,
    X_OVER_R,
    jump,
    phase,
    sag,
)

from vsgdesign.metrics.survival import SURVIVED, VERDICTS
from vsgdesign.report.drawing.style import COLOURS, EVENT_LINE, NOTE_COLOUR, PAGE_IN, add_axes, look, new_figure
from vsgdesign.simulation.survival.cases import LEAD_S

ROOT = Path(__file__).resolve().parents[2]
TITLES = {"none": "no limit", "circular": "circular limit", "projection": "projection"}
LOST = "#D55E00"
LEFT_OUT = "#ECECEC"
SHARES = LinearSegmentedColormap.from_list("share", [LOST, "#F5C9A6", "#EDF3F8", "#0072B2"])
TIMES = LinearSegmentedColormap.from_list("times", ["#0B3C5D", "#0072B2", "#9CC9E3", "#F4F8FB"])
SLOWEST_S = 2.2
STYLES = {
    "none": {"color": COLOURS[7], "linestyle": (0, (1.3, 1.1)), "linewidth": 1.0},
    "circular": {"color": COLOURS[1], "linestyle": (0, (5, 1.2)), "linewidth": 1.0},
    "projection": {"color": COLOURS[0], "linestyle": "-", "linewidth": 1.2},
}


def cell(axes: Any, x: float, y: float, face: Any, text: str = "", dark: bool = False, hatch: str = "") -> None:
    """One cell of a map, a unit square about (x, y)."""
    axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, facecolor=face, edgecolor="white", linewidth=0.4, hatch=hatch))
    if text:
        axes.text(x, y, text, ha="center", va="center", fontsize=5.5, color="w" if dark else "k")


def ticks(axes: Any, x: tuple[Any, ...], y: tuple[Any, ...], every_x: int = 1, every_y: int = 1) -> None:
    """Borders and tick labels of a map of unit squares."""
    axes.grid(visible=False)
    axes.set_xlim(-0.5, len(x) - 0.5)
    axes.set_ylim(-0.5, len(y) - 0.5)
    axes.set_xticks(range(0, len(x), every_x), [f"{value:g}" for value in x[::every_x]], fontsize=6.0)
    axes.set_yticks(range(0, len(y), every_y), [f"{value:g}" for value in y[::every_y]], fontsize=6.0)
    axes.tick_params(length=0)


def draw_jumps(maps: dict[str, Any]) -> Any:
    """How many of four powers survive a jump of SCR, by SCR before and after and by X/R."""
    size, gap, left, bottom = 1.44, 0.16, 0.62, 0.62
    figure = new_figure(PAGE_IN, bottom + 3 * size + 2 * gap + 0.28)
    for row, limiter in enumerate(maps):
        cases = maps[limiter]["cases"]
        for column, x in enumerate(X_OVER_R):
            axes = add_axes(figure, left + column * (size + gap), bottom + (2 - row) * (size + gap), size, size)
            for i, a in enumerate(SCR):
                for j, b in enumerate(SCR):
                    if a == b:
                        cell(axes, i, j, "#FFFFFF")
                        continue
                    found = [cases[jump(a, b, x, P).name][0] for P in POWERS]
                    judged = [one for one in found if one in VERDICTS]
                    if not judged:
                        cell(axes, i, j, LEFT_OUT, "×")
                        continue
                    good = sum(one == SURVIVED for one in judged)
                    share = good / len(judged)
                    cell(axes, i, j, SHARES(share), "" if share == 1.0 else f"{good}/{len(judged)}", share < 0.2)
            ticks(axes, SCR, SCR)
            if row < 2:
                axes.set_xticklabels([])
            if column:
                axes.set_yticklabels([])
            if row == 0:
                axes.set_title(f"X/R {x:g}")
            if row == 2:
                axes.set_xlabel("SCR before")
            if column == 0:
                axes.set_ylabel(f"{TITLES[limiter]}\nSCR after", linespacing=1.5)
    powers = ", ".join(f"{P:g}" for P in POWERS).replace("-", "−")
    handles = [
        Patch(facecolor=SHARES(1.0), label="all survived"),
        Patch(facecolor=SHARES(0.5), label="some survived, as written"),
        Patch(facecolor=SHARES(0.0), label="all lost"),
    ]
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(left / PAGE_IN, 0.012), ncols=3)
    right = (left + 4 * size + 3 * gap) / PAGE_IN
    note = f"P = {powers} pu; the schedule is 0.2 s late"
    figure.text(right, 0.015, note, ha="right", fontsize=6.5, color=NOTE_COLOUR)
    return figure


def recovery_cell(axes: Any, x: float, y: float, verdict: list[Any]) -> None:
    """A cell of a map of recovery times."""
    status, recovery, _ = verdict
    if status not in VERDICTS:
        cell(axes, x, y, LEFT_OUT, "×")
    elif status != SURVIVED or recovery is None:
        cell(axes, x, y, LOST, hatch="////")
    else:
        cell(axes, x, y, TIMES(Normalize(0.0, SLOWEST_S)(recovery)))


def draw_faults(maps: dict[str, Any]) -> Any:
    """Recovery after phase jumps by SCR, and after sags by depth and length."""
    width, left, gap = 2.05, 0.62, 0.14
    figure = new_figure(PAGE_IN, 4.13)
    for column, limiter in enumerate(maps):
        cases, at = maps[limiter]["cases"], left + column * (width + gap)
        above = add_axes(figure, at, 2.57, width, 1.3)
        for i, degrees in enumerate(PHASES):
            for j, scr in enumerate(SCR):
                recovery_cell(above, i, j, cases[phase(scr, degrees).name])
        ticks(above, PHASES, SCR)
        shown = [k for k, value in enumerate(PHASES) if value in (-150, -90, -30, 30, 90, 150)]
        above.set_xticks(shown, [f"{PHASES[k]:+g}".replace("-", "−") for k in shown], fontsize=6.0)
        above.set_xlabel("jump of the phase [°]")
        above.set_title(TITLES[limiter])
        below = add_axes(figure, at, 0.66, width, 1.42)
        for i, length in enumerate(LENGTHS_S):
            for j, V in enumerate(DEPTHS):
                recovery_cell(below, i, j, cases[sag(5.0, V, length).name])
        ticks(below, LENGTHS_S, DEPTHS)
        below.set_xticks(range(0, len(LENGTHS_S), 2), [f"{value:g}" for value in LENGTHS_S[::2]], fontsize=6.0)
        below.set_xlabel("length of the sag [s]")
        if column == 0:
            above.set_ylabel("SCR [–]")
            below.set_ylabel("voltage left [pu], SCR 5")
        else:
            above.set_yticklabels([])
            below.set_yticklabels([])
    handles = [Patch(facecolor=TIMES(value / SLOWEST_S), label=f"{value:g} s") for value in (0.0, 0.5, 1.0, 1.5, 2.0)]
    handles.append(Patch(facecolor=LOST, hatch="////", edgecolor="white", label="lost"))
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(left / PAGE_IN, 0.03), ncols=6, handlelength=1.6)
    right = (left + 3 * width + 2 * gap) / PAGE_IN
    note = f"recovery after the clearing; X/R 3, P = {LOADED:g} pu"
    figure.text(right, 0.036, note, ha="right", fontsize=6.5, color=NOTE_COLOUR)
    return figure


def draw_clearing(maps: dict[str, Any]) -> Any:
    """Critical clearing time of a fault that takes the whole voltage."""
    figure = new_figure(PAGE_IN, 2.35)
    for column, P in enumerate(CLEARING_POWERS):
        axes = add_axes(figure, 0.62 + column * 3.3, 0.42, 2.95, 1.55)
        for limiter in maps:
            rows = [one for one in maps[limiter]["clearing"] if one["P_pu"] == P and one["longest_s"] is not None]
            scr = np.array([one["scr"] for one in rows])
            longest = np.array([max(one["longest_s"], 0.04) for one in rows])
            free = np.array([not one["bounded"] for one in rows], dtype=bool)
            axes.plot(scr, longest, **STYLES[limiter], marker="o", markersize=3.0, zorder=3)
            axes.plot(
                scr[free], longest[free], marker="^", markersize=5.0, linestyle="", color=STYLES[limiter]["color"]
            )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(SCR, [f"{value:g}" for value in SCR])
        axes.minorticks_off()
        axes.set_yticks([0.05, 0.1, 0.3, 1.0, 3.0], ["0.05", "0.1", "0.3", "1", "3"])
        axes.set_ylim(0.04, 4.5)
        axes.set_xlabel("SCR [–]")
        axes.set_title(f"P = {P:g} pu")
        if column == 0:
            axes.set_ylabel("longest fault survived [s]")
    handles = [Line2D([], [], **STYLES[limiter], label=TITLES[limiter]) for limiter in maps]
    handles.append(
        Line2D([], [], marker="^", linestyle="", color=NOTE_COLOUR, markersize=5.0, label="every length up to 3 s")
    )
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.62 / PAGE_IN, 0.99), ncols=4)
    return figure


PANELS = (
    ("i_s_pu", "current [pu]", (0.0, 3.0)),
    ("delta", "change of δ [°]", (-45.0, 95.0)),
    ("f_hz", "frequency [Hz]", (48.4, 52.6)),
    ("P_pu", "P [pu]", (-1.6, 2.6)),
    ("limited", "limiter", None),
)


def draw_trace(arrays: Any) -> Any:
    """One jump: current, angle, frequency, power and the limiter's state."""
    heights = (0.95, 0.95, 0.8, 0.8, 0.42)
    figure = new_figure(PAGE_IN, 0.55 + sum(heights) + 4 * 0.1 + 0.42)
    for column, (begin, end, width) in enumerate(((-0.02, 0.12, 2.4), (-0.1, 2.2, 3.85))):
        at = figure.get_size_inches()[1] - 0.42
        for (key, label, limits), height in zip(PANELS, heights, strict=True):
            at -= height
            axes = add_axes(figure, 0.55 + column * 2.65, at, width, height)
            at -= 0.1
            axes.axvline(0.0, **EVENT_LINE)
            axes.set_xlim(begin, end)
            if limits is not None:
                axes.set_ylim(*limits)
            if key == "limited":
                limiter_panel(axes, arrays, begin, end)
            else:
                signal_panel(axes, arrays, key, begin, end)
            if column == 0:
                axes.set_ylabel(label)
                axes.yaxis.set_label_coords(-0.43 / width, 0.5)
            else:
                axes.set_yticklabels([])
    handles = [Line2D([], [], **STYLES[limiter], label=TITLES[limiter]) for limiter in TITLES]
    title = "SCR {scr:g} → {to:g}, X/R {x_over_r:g}, P = {P_pu:g} pu, known 0.2 s later".format(**TRACED)
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.55 / PAGE_IN, 0.985), ncols=3)
    figure.text((0.55 + 6.5) / PAGE_IN, 0.985, title, ha="right", va="top", fontsize=7.0)
    return figure


def signal_panel(axes: Any, arrays: Any, key: str, begin: float, end: float) -> None:
    """One signal of all limiters."""
    peaks = []
    for k, limiter in enumerate(TITLES):
        t = arrays[f"{limiter}.t_s"] - LEAD_S
        values = arrays[f"{limiter}.{key}"]
        if key == "delta":
            values = np.degrees(values - values[0])
        part = (t >= begin) & (t <= end)
        axes.plot(t[part], values[part], **STYLES[limiter], zorder=3 + k)
        if key == "i_s_pu" and float(np.max(values[part])) > axes.get_ylim()[1]:
            peaks.append(f"{TITLES[limiter]}: up to {float(np.max(values[part])):.1f} pu")
    axes.set_xticklabels([])
    if key == "i_s_pu":
        axes.axhline(1.2, color="k", linewidth=0.6, linestyle=(0, (2.2, 1.6)))
        if peaks:
            axes.text(0.985, 0.93, "\n".join(peaks), transform=axes.transAxes, ha="right", va="top", fontsize=6.0)


def limiter_panel(axes: Any, arrays: Any, begin: float, end: float) -> None:
    """When each limiter acts."""
    shown = [limiter for limiter in TITLES if limiter != "none"]
    for row, limiter in enumerate(shown):
        t = arrays[f"{limiter}.t_s"] - LEAD_S
        part = (t >= begin) & (t <= end)
        bars(axes, t[part], arrays[f"{limiter}.limited"][part], row, STYLES[limiter]["color"])
    axes.set_ylim(-0.6, 1.6)
    axes.set_yticks([0, 1], ["circ.", "proj."])
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("time after the jump [s]")


def bars(axes: Any, t: Any, limited: Any, row: float, colour: str) -> None:
    """Spans of time in which a limiter acts, as bars."""
    edges = np.diff(np.concatenate([[0.0], (limited > 0.5).astype(float), [0.0]]))
    begins, ends = np.flatnonzero(edges > 0.0), np.flatnonzero(edges < 0.0) - 1
    step = t[1] - t[0]
    spans = [(float(t[a]), float(t[b] - t[a] + step)) for a, b in zip(begins, ends, strict=True)]
    axes.broken_barh(spans, (row - 0.32, 0.64), facecolors=colour, linewidth=0.0)


def main(measured: Path, figures: Path) -> None:
    """All figures."""
    maps = json.loads((measured / "maps.json").read_text(encoding="utf-8"))
    arrays = np.load(measured / "trace.npz")
    pictures = {
        "survival_jumps": lambda: draw_jumps(maps),
        "survival_faults": lambda: draw_faults(maps),
        "survival_clearing": lambda: draw_clearing(maps),
        "survival_trace": lambda: draw_trace(arrays),
    }
    for name, draw in pictures.items():
        with look():
            draw().savefig(figures / f"{name}.png", metadata={"Software": None})


if __name__ == "__main__":
    main(
        Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out") / "survival",
        Path(sys.argv[2]) if len(sys.argv) > 2 else ROOT / "docs" / "figures",
    )
