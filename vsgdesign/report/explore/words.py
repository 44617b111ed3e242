"""The sentences on a run of the explorer. A page without a server has the same templates, and chooses among them in the
same way (``page/words.js``)."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.metrics.events import DIVERGED, TOO_SHORT, UNSTABLE
from vsgdesign.metrics.met import (
    OVERSHOOT_ROOM,
    beside_limit,
    most_overshoot,
    most_settling_time,
    overshoot_met,
    settling_met,
)
from vsgdesign.metrics.survival import BLOCKED, HARDWARE_PU, LATCHED, NOT_AT_REST, SLIPPED, SURVIVED, TRIPPED
from vsgdesign.report.explore.scene import SHOWN_S
from vsgdesign.simulation.outcome import MOVES_AT, RESTS_AT
from vsgdesign.simulation.survival.running import TRIPS_AT
from vsgdesign.study.parameters.study import Study

SETTLED = "settled"

TEMPLATES: dict[str, Any] = {
    "settles": "{} settles in {} s{}.",
    "no_overshoot": " without overshoot",
    "overshoot": " with {} % overshoot",
    "survives": "It survives and is back at rest {:.2f} s after {}.",
    "since": {"sag": "the end of the sag", "ramp": "the end of the ramp", "": "the event"},
    "too_short": "{} is not judged in {:.3g} s: the slowest mode needs {:.2f} s.",
    "unstable": "The operating point after the step is {}.",
    "no_verdict": "There is no verdict: {}.",
    "hardware": f", {MORE_THAN_HARDWARE}",
    "peak": " The current reaches {:.2f} pu",
    "limited": ", and its limiter acts for {:.3g} s.",
    "trips": "It is lost: {}. The event comes at {:.3g} s.",
    "trips_at": TRIPS_AT,
    "blocks": "It is lost: {}.",
    "before": ["after the event", "before the event"],
    "rests_at": RESTS_AT,
    "moves_at": MOVES_AT,
    "verdicts": {
        "not settled": "It does not come to rest.",
        "no steady state": "There is no steady state after the step.",
        "no model": "No model knows the circuit after the step.",
        DIVERGED: "It is lost: the run diverges.",
        SLIPPED: "It is lost: the angle slips by a turn.",
        LATCHED: "It is lost: it stays in its current limit.",
        NOT_AT_REST: "It is not at rest in time.",
        "no rest": "There is no steady state after the event.",
        "rest over limit": "The steady state after the event needs more current than the limiter leaves.",
    },
    "no_mode": "the mode after the step is not found",
    "too_short_status": TOO_SHORT,
    "unstable_status": UNSTABLE,
    "settled": SETTLED,
    "survived": SURVIVED,
    "tripped": TRIPPED,
    "diverged": DIVERGED,
    "blocked": BLOCKED,
}
"""Braces stand for values, with formats of Python: ``{:.2f}``, ``{:.3g}``."""

SHORTEST_LIMITED_S = 5e-4
"""A limiter that acts for less than this, s, is not told."""


def asked_of(study: Study) -> tuple[float, float] | None:
    """Settling time (s) and overshoot (as a share of the step) that the study asks for; None: it asks for none."""
    asked = study.specification
    return None if asked is None or not asked.settles else (asked.settling_time, asked.overshoot)


def rules(asked: tuple[float, float] | None) -> dict[str, Any]:
    """What a page needs to know besides its figures: what is asked for, up to where that is met, and limits of what is
    told."""
    most = None if asked is None else (most_settling_time(asked[0]), most_overshoot(asked[1]))
    return {
        "asked": asked,
        "met": most,
        "no_overshoot": OVERSHOOT_ROOM,
        "shortest_limited_s": SHORTEST_LIMITED_S,
        "hardware_pu": HARDWARE_PU,
        "shown_s": SHOWN_S,
    }


def verdict(
    found: dict[str, Any], asked: tuple[float, float] | None, kind: str, signal: str, event_s: float = math.nan
) -> str:
    """One or two sentences on a run: ``found`` has its figures, ``asked`` is that of :func:`asked_of`, ``kind`` and
    ``signal`` are those of its event, and ``event_s`` is its time in the run, from which a trip is told."""
    status, said = found["status"], TEMPLATES
    if status == SETTLED and found["settling_s"] is not None:
        text = said["settles"].format(signal, *_settled(found, asked))
    elif status == SURVIVED and found["recovery_s"] is not None:
        text = said["survives"].format(found["recovery_s"], said["since"].get(kind, said["since"][""]))
    elif status == TOO_SHORT:
        text = said["too_short"].format(signal, SHOWN_S, math.ceil(100.0 * found["needs_s"]) / 100.0)
    elif status == "limited" or (status == "not settled" and found["why"].startswith("in the last second")):
        text = f"{found['why'][0].upper()}{found['why'][1:].split('. ')[0].removesuffix('.')}."
    elif status == UNSTABLE:
        text = said["unstable"].format(found["why"] or status)
    elif status == TRIPPED:
        text = said["trips"].format(found["why"], event_s)
    elif status == BLOCKED:
        text = said["blocks"].format(found["why"])
    elif status in said["verdicts"]:
        text = said["verdicts"][status]
        if found["why"].startswith("before"):
            text = text.replace(*said["before"])
    else:
        return said["no_verdict"].format(found["why"] or status)
    if found["peak_pu"] is not None and status != DIVERGED:
        text += said["peak"].format(max(found["peak_pu"], found["first_peak_pu"] or 0.0))
        limited = found["limited_s"] or 0.0
        text += said["hardware"] * (status == SURVIVED and found["peak_pu"] > HARDWARE_PU)
        text += "." if limited < SHORTEST_LIMITED_S else said["limited"].format(limited)
    return text


def _settled(found: dict[str, Any], asked: tuple[float, float] | None) -> tuple[str, str]:
    """Settling time and overshoot in words, beside what is asked for."""
    over, settled = found["overshoot"], found["settling_s"]
    late, too_much = (None, None) if asked is None else asked
    beyond = ""
    if over is not None:
        below = too_much is None or overshoot_met(over, too_much)
        limit = None if too_much is None else 100.0 * too_much
        shown = _beside(100.0 * over, limit, below, 1)
        beyond = TEMPLATES["no_overshoot"] if over < OVERSHOOT_ROOM else TEMPLATES["overshoot"].format(shown)
    return _beside(settled, late, late is None or settling_met(settled, late), 2), beyond


def _beside(value: float, limit: float | None, met: bool, decimals: int) -> str:
    """A value beside what the specification asks for."""
    return beside_limit(value, limit, not met, lambda v, n: f"{v:.{n}f}", decimals)
