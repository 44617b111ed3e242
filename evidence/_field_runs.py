"""One run of the field estimator, from a draw to the figures that the tables are made of."""

from __future__ import annotations

import functools
import math
import time
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from evidence._field_answers import false_changes, longest_silence, silence
from evidence._field_converters import Converter, converter_named, events_of, references, resting_currents
from evidence._field_draws import FieldDraw
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.metrics.answers import (
    VERY_WRONG,
    Answers,
    answers_of,
    inside_ellipse,
    share_valid,
    time_to_stay,
    valid_and_wrong,
)
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.study.parameters.background import BackgroundSpec, draw_background
from vsgdesign.study.parameters.event import BASIS
from vsgdesign.study.parameters.grid import GridSource, Place
from vsgdesign.study.parameters.sensors import SensorSpec, draw_sensors
from vsgdesign.study.parameters.study import Study

REST_FROM_S = 2.0
"""From here on a run without events counts as rest, s: the estimator has forgotten what it learned from first."""

STRIDE, KEPT = 10, 40
"""At rest an answer is kept every 10 cycles or more, and up to 40 of a run, so that a long run does not outweigh many
short ones. The answers remember 60 cycles, so little is lost."""

FOLLOWED_CYCLES = 60
"""So many cycles after the last event are kept one by one."""

_DIGITS = 5

converter_of = functools.cache(converter_named)


def study_of(converter: Converter, draw: FieldDraw) -> Study:
    """The converter's study with the grid, the events, the background and the sensors of a draw."""
    study, start = converter.study, draw.start
    c = study.converter
    P_ref, Q_ref = references(converter, start)
    return replace(
        study,
        grid=Place(start.scr, start.x_over_r, BASIS).grid(c),
        grid_source=GridSource(start.V_g_pu * c.V_rated_rms, c.omega_n + 2.0 * math.pi * start.df_hz),
        events=events_of(converter, start, draw.changes),
        background=_background(draw),
        sensors=_sensors(draw),
        simulation=replace(
            study.simulation,
            duration=round(draw.duration_s / c.T_s) * c.T_s,
            log_interval=round(0.02 / c.T_s) * c.T_s,
            P_ref=P_ref,
            Q_ref=Q_ref,
        ),
    )


def _background(draw: FieldDraw) -> BackgroundSpec:
    """Frequency and voltage are those of the draw's own start."""
    what, omega = draw.surroundings, converter_of(draw.converter).study.converter.omega_n
    ranges: dict[str, tuple[float, float]] = {"frequency_offset": (0.0, 0.0), "voltage_factor": (1.0, 1.0)}
    if what.beat:
        frequency = what.beat_order * (omega / (2.0 * math.pi) + draw.start.df_hz)
        name = "modulation" if what.beat == "modulation" else "interharmonic"
        ranges |= {name: (what.beat_pu, what.beat_pu), f"{name}_frequency": (frequency, frequency)}
    return draw_background(ranges, what.seed, what.background)


def _sensors(draw: FieldDraw) -> SensorSpec:
    noise = draw.surroundings.noise
    ranges = {} if noise is None else {"noise": (noise, noise)}
    return draw_sensors(ranges, draw.surroundings.seed, draw.surroundings.sensors)


def run_field(draw: FieldDraw) -> dict[str, Any]:
    """A draw through the EMT with the estimator driving the schedule, and its figures.

    ``left_out`` says why there are none: with the gains of the start it has no steady state, or the run diverged.
    """
    begin = time.process_time()
    converter = converter_of(draw.converter)
    study = study_of(converter, draw)
    name = {"group": draw.group, "converter": draw.converter, "seed": draw.seed}
    try:
        simulation, answers = simulate_field(converter, study)
    except InfeasibleStudyError as error:
        return name | {"left_out": " ".join(str(error).split())}
    if simulation.divergence is not None:
        return name | {"left_out": simulation.divergence.reason}
    found = figures_of(draw, answers, 2.0 * math.pi / study.converter.omega_n)
    return found | {"seconds": round(time.process_time() - begin, 3)}


def simulate_field(converter: Converter, study: Study, *, probe: bool = True) -> tuple[Simulation, Answers]:
    """A run whose schedule follows the field estimator; without its probe it never learns."""
    scheduler = FieldScheduler(study, replace(converter.spec, estimate="field"), probe=probe)
    simulation = simulate(study, scheduler)
    return simulation, answers_of_log(scheduler.log(simulation.timeline), study)


def answers_of_log(log: EstimateLog, study: Study) -> Answers:
    """The answers of a run of the field estimator."""
    cycles = log.cycles
    if cycles is None:
        raise ValueError("these answers are not the field estimator's.")
    return answers_of(
        log.t_s,
        (log.R_g, log.L_g),
        (cycles.R_g, cycles.L_g),
        (cycles.var_R, cycles.cov_RL, cycles.var_L),
        cycles.valid,
        cycles.changed,
        omega_n=study.converter.omega_n,
        end_s=study.simulation.duration,
    )


def figures_of(draw: FieldDraw, answers: Answers, cycle_s: float) -> dict[str, Any]:
    """What is kept of a run. Impedances are relative: (R̂ − R)/|Z| and (X̂ − X)/|Z|.

    ``rest``: (error of R, error of X, R/|Z|, valid, inside the ellipse) of answers at rest. ``after``: (error, valid,
    inside, error of R, error of X, R/|Z|) of the first FOLLOWED_CYCLES answers after the last event.
    """
    currents = resting_currents(converter_of(draw.converter), draw.start, draw.changes) or (math.nan, math.nan)
    begin, end = REST_FROM_S, draw.duration_s
    last = next((one.place for one in reversed(draw.changes) if one.place is not None), None)
    found: dict[str, Any] = {
        "group": draw.group,
        "converter": draw.converter,
        "seed": draw.seed,
        "scr": [draw.start.scr, draw.start.scr if last is None else last.scr],
        "x_over_r": [draw.start.x_over_r, draw.start.x_over_r if last is None else last.x_over_r],
        "current_pu": [round(one, 4) for one in (currents[0], currents[-1])],
        "duration_s": draw.duration_s,
        "cycle_s": cycle_s,
    }
    off, size = answers.Z_hat - answers.Z, np.abs(answers.Z)
    parts, flags = [off.real / size, off.imag / size, answers.Z.real / size], [answers.valid, inside_ellipse(answers)]
    if draw.events_s:
        begin = draw.events_s[0]
        rows = np.flatnonzero(answers.t_s > draw.events_s[-1])[:FOLLOWED_CYCLES]
        found["after"] = np.round(np.column_stack([answers.error, *flags, *parts])[rows], _DIGITS).tolist()
        found["silence_s"] = silence(answers, begin, end)
        if draw.jumps_s:
            found["found_s"] = found_after(answers, draw.jumps_s[-1], end)
            found["announced"] = bool((answers.changed & answers.rows(draw.jumps_s[-1], end)).any())
    else:
        rows = np.flatnonzero(answers.rows(begin, end))
        rows = rows[:: max(STRIDE, -(-len(rows) // KEPT))]
        found["rest"] = np.round(np.column_stack([*parts, *flags])[rows], _DIGITS).tolist()
        found["share_valid"] = share_valid(answers, begin, end)
    found["false_changes"] = false_changes(answers, begin, end, draw.jumps_s)
    return found | wrong_and_silent(answers, draw.events_s, begin, end)


def found_after(answers: Answers, change_s: float, end_s: float) -> float | None:
    """Time to stay within 10 % after a change, s; None: never."""
    found_s = time_to_stay(answers, change_s, end_s)
    return found_s if math.isfinite(found_s) else None


def wrong_and_silent(answers: Answers, events: tuple[float, ...], begin_s: float, end_s: float) -> dict[str, float]:
    """For how long answers are valid and wrong, the largest error of these, and the longest silence after an event."""
    wrong = valid_and_wrong(answers, begin_s, end_s, events)
    stretches = pairwise((*(events or (begin_s,)), end_s))
    return {
        "wrong_s": wrong.seconds,
        "worst": wrong.worst,
        "very_wrong_s": valid_and_wrong(answers, begin_s, end_s, events, above=VERY_WRONG).seconds,
        "longest_silence_s": max(longest_silence(answers, since_s, until_s) for since_s, until_s in stretches),
    }
