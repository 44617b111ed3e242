"""What a page without a server judges its runs with: compiled loops over the log of a run, rests, demands and words.

The loops are made of the functions that judge runs side by side and single ones. The page (``page/verdict.js``) calls
them and puts its figures into the sentences. It has the same templates as the server, and chooses among them in the
same way (``page/words.js``).
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.artifacts.definitions import MORE_THAN_HARDWARE
from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.blocks import Part, Writer, joined, with_outputs
from vsgdesign.codegen.flat import Block
from vsgdesign.codegen.llvm import LoopSpec, flat_block
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.sampled_path import droop_step, sampled_path, sampled_rest
from vsgdesign.linear.stability.loci import LEAST_SHARE, MODE_WORDS, MOST_NAMED
from vsgdesign.metrics.events import DIVERGED, SHARE_OF_BAND, TOO_SHORT, UNSTABLE, late_rows
from vsgdesign.metrics.met import (
    OVERSHOOT_ROOM,
    beside_limit,
    most_overshoot,
    most_settling_time,
    overshoot_met,
    settling_met,
)
from vsgdesign.metrics.protection import held_in_words, rate_in_words
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.metrics.survival import (
    BLOCKED,
    END_S,
    FIRST_S,
    HARDWARE_PU,
    LATCHED,
    NOT_AT_REST,
    REST_SHARE,
    SLIPPED,
    STATUSES,
    SURVIVED,
    TRIPPED,
    place_of_verdict,
    swung,
)
from vsgdesign.report.explore.scene import SHOWN_S, samples_of_step
from vsgdesign.simulation.axes import headed
from vsgdesign.simulation.compiled_schedulers import direction
from vsgdesign.simulation.outcome import ACTS, BOUND_PU, IN_WORDS, LIMITS, MOVES, MOVES_AT, PARTS, RESTING_S, RESTS_AT
from vsgdesign.simulation.scenario.controllers import samples_per_mean
from vsgdesign.simulation.seen_sample import (
    FrequencyGuard,
    VoltageGuard,
    needs_at_first,
    seen_disturbance,
    seen_end,
    seen_frequency,
    seen_need,
    seen_rest,
    seen_voltage,
)
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of, silent_s_of
from vsgdesign.simulation.survival.running import OWN_REST_CYCLES, TRIPS_AT, own_powers
from vsgdesign.simulation.watched_sample import entered_s, power_at_pcc, watched_step
from vsgdesign.study.parameters.study import ControllerSpec, Study

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


FED = (
    *(f"x.{name}_{axis}" for name in ("i_s", "v_c", "i_g") for axis in ("alpha", "beta")),
    "v_g_alpha", "v_g_beta", "P", "Q", "omega", "V_rms", "theta", "limited", "at_bridge",
)  # fmt: skip
"""What the loops read of a sample: the columns of a run's log, in its order."""

NEWTON = 12
"""Newton's steps towards a rest. Eight of them find every rest of drawn ones."""
_CONVERGED = 1e-9
"""Largest error of a rest before the last step, as a share of the powers in its equation."""


def function_spec(function: Any, fixed: dict[str, Any]) -> LoopSpec:
    """A function as a loop of one sample."""
    return one_sample(flat_block(function, fixed=fixed))


def one_sample(block: Block) -> LoopSpec:
    """A block as a loop of one sample: its inputs are rows, limits are uniform, and its results are logged."""
    limits = tuple(name for name in block.inputs if name.startswith("limits."))
    rows = [name for name in block.inputs if name not in limits]
    outputs = tuple(name for name, _ in block.outputs)
    return LoopSpec((block,), ((rows[0], outputs[0]),), tuple(rows[1:]), limits, logged=outputs, strict=True)


@functools.cache
def verdict_loops(*, guarded: bool = True, switched: bool = True) -> dict[str, LoopSpec]:
    """The loops by their names: those of a protection where there is one, and those of a rest that a switched bridge
    comes to by itself."""
    newton = flat_block(droop_step)
    state = ("V_rms", "next_V"), ("delta", "next_delta")
    rest = tuple(name for name in newton.inputs if name not in ("V_rms", "delta"))
    over_log = {
        "seen_step": _over_log(_step(), (("power_ago", "power"),)),
        "seen_disturbance": _over_log(
            headed(flat_block(seen_disturbance)), (("P_ago", "P_now"), ("Q_ago", "Q_now")), {"seen": "watched"}
        ),
    }
    return {
        "path": function_spec(sampled_path, {}),
        "newton": LoopSpec((newton,), state, rest, logged=("error",), strict=True),
        "rest": function_spec(sampled_rest, {}),
        **over_log,
        **(_guards() if guarded else {}),
        **(_own_rests() if switched else {}),
        **{f"{name}_pair": replace(spec, lanes=2) for name, spec in over_log.items()},
        "entered_s": function_spec(entered_s, {}),
        "needs": function_spec(needs_at_first, {}),
        "swung": function_spec(swung, {}),
        "place": function_spec(place_of_verdict, {}),
        "direction": function_spec(direction, {}),
    }


def _guards() -> dict[str, LoopSpec]:
    voltage, frequency = headed(flat_block(seen_voltage)), headed(flat_block(seen_frequency))
    return {
        "seen_voltage": _over_log(voltage, (("V_ago", "V_now"),), {"guard": "guarded"}),
        "seen_frequency": _over_log(frequency, (("omega_ago", "omega_now"),), {"guard": "guarded"}),
    }


def _own_rests() -> dict[str, LoopSpec]:
    rings = ("P_ago", "P_now"), ("Q_ago", "Q_now")
    rested = _over_log(headed(flat_block(seen_rest)), rings, {"rest": "rested"})
    return {"seen_rest": rested, "own_powers": function_spec(own_powers, {})}


def _step() -> Block:
    return joined(
        Part(headed(flat_block(power_at_pcc), P="P_pcc", Q="Q_pcc")),
        Part(headed(flat_block(watched_step))),
        Part(headed(flat_block(seen_need), need="needed"), {"mean": "watched.mean"}),
        Part(headed(flat_block(seen_end), end="ended")),
    )


_MOVED = {"watch": "watched", "need": "needed", "end": "ended"}


def _over_log(block: Block, rings: tuple[tuple[str, str], ...], moved: dict[str, str] | None = None) -> LoopSpec:
    """A block as a loop that reads the log of a run."""
    line = Writer()
    for name in FED:
        line.input(name)
    heads = _MOVED if moved is None else moved
    outputs = {name for name, _ in block.outputs}
    pairs = []
    for name in block.inputs:
        head, _, rest = name.partition(".")
        if (after := f"{heads.get(head, '')}.{rest}") in outputs:
            pairs.append((name, after))
    wanted = dict.fromkeys([*(after for _, after in pairs), *(output for _, output in rings)])
    whole = with_outputs(joined(Part(block), Part(line.block())), tuple(wanted))
    placed = {*FED, "k", *(name for name, _ in (*pairs, *rings))}
    constant = tuple(name for name in whole.inputs if name not in placed)
    index = "k" if "k" in whole.inputs else ""
    return LoopSpec((whole,), tuple(pairs), constant, fed=FED, rings=rings, index=index, strict=True)


def judged_with(study: Study, spec: ControllerSpec, ready: Ready) -> dict[str, Any]:
    """What a controller's runs are judged with. ``study`` is that of a run, with the controller's own limit."""
    c, settings = study.converter, study.controller_settings()
    demand = demand_of(c, settling_time_of(spec, ready), silent_s=silent_s_of(spec))
    limit = c.current_limit_pu
    return {
        "deadline_s": demand.deadline_s,
        "needed_s": demand.needed_s,
        "limit_pu": limit,
        "v_max_pk": settings.v_max_pk,
        "limits": {
            "current_sq": -1.0 if limit is None else (limit * c.I_rated_pk) ** 2,
            **{name: getattr(settings.limiter, name, -1.0) for name in ("V_low", "V_high")},
        },
        "rules": rules(asked_of(study)),
        "guards": guards_of(study),
        "own_rest": _own_rest(study) if study.simulation.bridge == "pwm" else None,
        "share": SHARE_OF_BAND if study.simulation.bridge == "pwm" else 1.0,
    }


def _own_rest(study: Study) -> dict[str, int]:
    """How the rest of a switched bridge is read off its own run: of a step the last samples, of anything else the last
    cycles."""
    cycle = max(round(2.0 * math.pi / study.grid_source.omega_g / study.converter.T_s), 1)
    return {"samples": int(late_rows(samples_of_step(study), cycle)), "cycles": OWN_REST_CYCLES}


def guards_of(study: Study) -> list[dict[str, Any]]:
    """What the protection of a study is judged with: for each loop how many samples ago it looks back, whether it must
    have so many before, its limits, and what is said where one is reached. A limit that is not given is never
    reached."""
    limits, c = study.protection, study.converter
    if limits is None:
        return []
    high = held_in_words(_given(limits.V_high_pu, _NEVER), limits.V_high_time, above=True)
    low = held_in_words(_given(limits.V_low_pu, -1.0), limits.V_low_time, above=False)
    rate = rate_in_words("{:.3g}", _given(limits.rocof, _NEVER), limits.rocof_window)
    cycle = max(round(2.0 * math.pi / c.omega_n / c.T_s), 1)
    window = max(round(limits.rocof_window / c.T_s), 1)
    V = VoltageGuard(
        V_high=_given(limits.V_high_pu, _NEVER),
        high_s=limits.V_high_time,
        V_low=_given(limits.V_low_pu, -1.0),
        low_s=limits.V_low_time,
        per_V=1.0 / (cycle * rms_to_peak(c.V_rated_rms)),
        T_s=c.T_s,
        on=0.0,
    )
    f = FrequencyGuard(rocof=_given(limits.rocof, _NEVER), window_s=window * c.T_s, on=0.0)
    return [
        {
            "loop": loop,
            "ago": ago,
            "whole": whole,
            "of": {f"guard_of.{name}": v for name, v in of._asdict().items()},
            "said": said,
        }
        for loop, ago, whole, of, said in (
            ("seen_voltage", cycle, False, V, {"at_high": high, "at_low": low}),
            ("seen_frequency", window, True, f, {"at_rate": rate}),
        )
    ]


_NEVER = 1e300


def _given(limit: float | None, without: float) -> float:
    return without if limit is None else limit


def common_of_verdicts(study: Study) -> dict[str, Any]:
    """What all controllers share."""
    c = study.converter
    rated = {"i": c.I_rated_pk, "v": c.V_rated_rms, "S": c.S_rated, "omega": c.omega_n, "V": c.V_rated_rms}
    bounds = [rated[name] * BOUND_PU for name in ("i", "i", "v", "v", "i", "i", "v", "v", "S", "S", "omega", "V")]
    return {
        "per_mean": samples_per_mean(study, np.array([0.0, c.T_s])),
        "bounds": bounds,
        "band": SETTLING_BAND,
        "end_s": END_S,
        "first_s": FIRST_S,
        "rest_share": REST_SHARE,
        "newton": NEWTON,
        "converged": _CONVERGED,
        "statuses": STATUSES,
        "ending": {
            "length_s": RESTING_S,
            "parts": PARTS,
            "acts": ACTS,
            "moves": MOVES,
            "limits": [IN_WORDS[name] for name in LIMITS],
        },
        "words": TEMPLATES | {"mode": MODE_WORDS | {"least": LEAST_SHARE, "most": MOST_NAMED}},
    }
