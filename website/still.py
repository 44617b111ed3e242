"""The still figure behind an explorer on the web site: what it opens with, for print and where scripts are off."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from vsgdesign.report.explore.session import Session

LABELS = {"P": "active power in pu", "Q": "reactive power in pu", "i_s_pu": "current in pu"}
HEIGHT, GAP, LEFT, BOTTOM, RIGHT, TOP = 1.15, 0.12, 0.5, 0.38, 0.12, 0.24
"""Inches: of the panels, between them, and around them."""


def draw_still(session: Session, path: Path) -> str:
    """Draws the runs with which an explorer opens as a PNG: the stepped power, else the active one, and the current.
    Returns what the figure shows in words, with the verdict on every run."""
    from vsgdesign.report.drawing.style import PAGE_IN, REFERENCE, add_axes, line_style, look, new_figure
    from vsgdesign.report.explore.live import emt_answer
    from vsgdesign.report.explore.scene import scene_of, study_of

    state = session.start
    answer = emt_answer(session.study, session.ready, state)
    if answer is None:
        raise RuntimeError("the explorer gave no answer")
    rows = answer.header["controllers"]
    shown = state.event.signal if state.event.kind == "step" else "P", "i_s_pu"
    above = [band for band in answer.header["bands"] if band["low"] is None]
    limits = {signal: [band for band in above if band["signal"] == signal] for signal in shown}
    height = BOTTOM + 2.0 * HEIGHT + GAP + TOP
    with look():
        figure = new_figure(PAGE_IN, height)
        for place, signal in enumerate(shown):
            up = BOTTOM + (1 - place) * (HEIGHT + GAP)
            axes = add_axes(figure, LEFT, up, PAGE_IN - LEFT - RIGHT, HEIGHT)
            for k, row in enumerate(rows):
                if f"{k}/t" in answer.arrays:
                    t = np.asarray(answer.arrays[f"{k}/t"], dtype=float)
                    axes.plot(t, answer.arrays[f"{k}/{signal}"], label=row["name"], **line_style(k))
                    axes.set_xlim(t[0], t[-1])
            for band in limits[signal]:
                axes.axhline(band["high"], **REFERENCE)
            axes.set_ylabel(LABELS[signal])
            axes.tick_params(labelbottom=place == 1)
            if place == 0:
                axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.03), ncols=len(rows))
            else:
                axes.set_xlabel("time in s")
        figure.savefig(path)
    event = study_of(scene_of(session.study, session.ready, state), session.ready, state, 0).events[0].name
    said = " ".join(f"{row['name']}: {row['verdict']}" for row in rows)
    jump = "jump to " if state.event.kind == "grid" else ""
    dotted = "; ".join(band["label"] for own in limits.values() for band in own)
    said += f" Dotted: {dotted}." if dotted else ""
    return f"SCR {state.scr:.3g}, X/R {state.x_over_r:.3g}: {jump}{event}. {said}"
