"""The document results.json of a run: what scripts and tests read."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from vsgdesign.artifacts import provenance
from vsgdesign.artifacts.table_text import table_summary
from vsgdesign.linear.operating_point import OperatingPoint
from vsgdesign.linear.stability.loci import shares_of
from vsgdesign.metrics import EventMetrics, StepNoise
from vsgdesign.simulation.every_sample import spacing_of_figures
from vsgdesign.simulation.gains import GainChange, settled_changes
from vsgdesign.simulation.rest import Instability, Rest
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult, mean_cycles
from vsgdesign.simulation.scenario.judging import Kept, judge_estimates, promises_kept
from vsgdesign.study.parameters import Study
from vsgdesign.verbs.pipeline.estimators import judgement_document


def results_document(result: ScenarioResult, timing_s: dict[str, float]) -> dict[str, Any]:
    """results.json: what scripts and tests read. Later stages add keys and rename none."""
    study = result.study
    judged = {one.name: judgement_document(one) for one in judge_estimates(result)}
    return {
        "schema": 1,
        "study": study.identity,
        "provenance": provenance(),
        "mean_cycles": mean_cycles(study),
        "figures_every_s": spacing_of_figures(study) * study.converter.T_s,
        "background": None if study.background is None else study.background.document(),
        "sensors": None if study.sensors is None else study.sensors.document(),
        "replay": None if study.replay is None else study.replay.document(),
        "left_out": list(result.left_out),
        "warnings": [_instability(study, one) for one in result.instabilities],
        "operating_points": [_rest(c.spec.name, rest) for c in result.controllers for rest in c.rests],
        "gains": [
            {"controller": c.spec.name, "t_s": change.t_s, **change.gains.named()}
            for c in result.controllers
            for change in _changes(study, c)
        ],
        "promises": [_kept(one) for one in promises_kept(result)],
        "controllers": {c.spec.name: _controller(result, c, judged.get(c.spec.name)) for c in result.controllers},
        "timing_s": timing_s,
    }


def _kept(one: Kept) -> dict[str, Any]:
    judged = not one.excuse
    return asdict(one) | {"kept_ideal": one.kept_ideal if judged else None, "kept": one.kept if judged else None}


def _rest(controller: str, rest: Rest) -> dict[str, Any]:
    where = {"controller": controller, "t_s": rest.t_s, "R_g": rest.grid.R_g, "L_g": rest.grid.L_g}
    names = [field.name for field in fields(OperatingPoint)]
    return {**where, **(asdict(rest.point) if rest.point else dict.fromkeys(names)), "reason": rest.obstacle}


def _instability(study: Study, one: Instability) -> dict[str, Any]:
    grid, place = one.grid, one.grid.place(study.converter, study.scr_basis)
    return {
        "controller": one.controller,
        "t_s": one.t_s,
        "end_s": one.end_s,
        "event": one.event,
        "grid": {
            "R_g": grid.R_g,
            "L_g": grid.L_g,
            "scr": place.scr,
            "x_over_r": place.x_over_r,
        },
        "mode": {
            "real": one.mode.s.real,
            "imag": one.mode.s.imag,
            "frequency_hz": abs(one.mode.s.imag) / (2.0 * np.pi),
            "damping_ratio": one.mode.damping,
            "participation": shares_of(one.mode),
        },
        "message": one.message,
    }


def _changes(study: Study, controller: ControllerResult) -> tuple[GainChange, ...]:
    """Every change of gains; of gains that follow an estimate or what is measured, those that hold before an event."""
    if not controller.moves:
        return controller.gain_changes
    instants = [event.t_s for event in study.events]
    return settled_changes(controller.gain_changes, instants, study.simulation.duration)


def _controller(result: ScenarioResult, controller: ControllerResult, judged: dict[str, Any] | None) -> dict[str, Any]:
    study, table, knowledge = result.study, result.ready.table(controller.spec), controller.spec.knowledge
    return {
        "kind": controller.spec.kind,
        "bridge": controller.bridge,
        "distorted": controller.distorted,
        "structure": controller.spec.target.structure,
        "schedule": controller.spec.schedule if controller.spec.kind == "scheduled" else None,
        "table": None if table is None else table_summary(study, table),
        "target": asdict(controller.spec.target),
        **({} if knowledge is None else {"knowledge": asdict(knowledge)}),
        "gains": [{"t_s": change.t_s, **change.gains.named()} for change in _changes(study, controller)],
        "gain_changes": len(controller.gain_changes),
        "estimate": judged,
        "outcome": asdict(controller.outcome),
        **({} if controller.dc is None else {"dc": asdict(controller.dc)}),
        **({} if controller.survival is None else {"survival": asdict(controller.survival)}),
        "limiter": _limiter(study.with_limit_of(controller.spec)),
        "events": [_event(event, mean_cycles(study)) for event in controller.events],
        "loop_s": controller.simulation.loop_seconds,
        "real_time_factor": study.simulation.duration / max(controller.simulation.loop_seconds, 1e-9),
    }


def _limiter(study: Study) -> dict[str, Any] | None:
    if study.converter.current_limit_pu is None:
        return None
    parameters = {name: float(value) for name, value in study.limiter_values.items()}
    return {"name": study.current_limiter, "limit_pu": study.converter.current_limit_pu, "parameters": parameters}


def _noise(noise: StepNoise, kind: str) -> dict[str, Any]:
    """What noise does to the figures of a step or a disturbance; nothing is infinite in JSON."""
    of_step = {"step": noise.step, "overshoot_pct": 100.0 * noise.share, "least_step": noise.least_step}
    found = {"left": noise.left, "rest": noise.rest, "least_band": noise.least_band}
    found = (of_step if kind == "step" else {}) | found
    finite = {name: value if math.isfinite(value) else None for name, value in found.items()}
    return finite | {"judgeable": noise.judgeable, "twin": noise.twin}


def _event(event: EventMetrics, cycles: int) -> dict[str, Any]:
    return {
        "name": event.name,
        "t_s": event.t_s,
        "signal": event.signal,
        "kind": event.kind,
        **asdict(event.cycle_mean),
        "peak_current_pu": event.peak_current_pu,
        "status": event.status,
        "reason": event.reason,
        "needs_s": event.needs_s,
        **({} if event.noise is None else {"noise": _noise(event.noise, event.kind)}),
        "instantaneous": asdict(event.raw),
        "cycle_mean": asdict(event.cycle_mean),
        **({"one_cycle_mean": asdict(event.cycle_mean)} if cycles == 1 else {}),
    }
