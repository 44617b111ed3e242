"""The random cases in EMT: how they are drawn, run side by side, written as studies and simulated one by one.

A case of a batch is written as a study file, which ``vsgdesign simulate`` runs as it was in the batch.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.campaigns.verification.blocks import Batch, SingleRun
from vsgdesign.campaigns.verification.draws import cases_of, draw_cases
from vsgdesign.codegen.machine_code import instruction_set
from vsgdesign.errors import Fault, StudyError
from vsgdesign.metrics.events import MEASURED, NOT_SETTLED, TOO_SHORT
from vsgdesign.simulation.lanes.cases import STEP, LaneCases, segments_of
from vsgdesign.simulation.lanes.rests import ends_of
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.scenario import ControllerResult, run_scenario
from vsgdesign.simulation.scenario.checking import expected_rests
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.study.given_files import toml_text
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.controllers import mean_time, poles_to_write
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import GridEstimate, GridSource
from vsgdesign.study.parameters.loading import study_from_document, with_files
from vsgdesign.study.parameters.study import ControllerSpec, Study, StudyOrigin

_LEFT_OUT = ("background", "sensors", "replay", "survival", "verification", "network", "events", "grid", "simulation")
"""Sections of the study that a case does not have, or has in its own words."""

_AROUND = ("backgrounds", "background"), ("sensors", "sensors")
"""What is around the cases, and the sections that say it."""


def case_study(
    study: Study,
    spec: ControllerSpec,
    drawn: LaneCases,
    index: int,
    *,
    ready: Ready = NOTHING,
    folder: str | Path = ".",
    table: str | None = None,
    name: str | None = None,
    title: str | None = None,
    bridge: str = "averaged",
) -> tuple[Study, str]:
    """One case of a batch as a study and as its text, for a file in ``folder``.

    It has the converter, the loops and the one controller of ``study``, with the case's grid, source, references,
    events and knowledge of the grid, logged at every sample. ``table``: the controller's gain table as the file is to
    name it, relative to ``folder``; None: as the study names it. Numbers are written so that reading gives the same
    bits. Raises StudyError where the study was built from its parts, or where the case cannot be said in a study.
    """
    document, origin = base_document(study, spec, folder, name or f"{study.name}_case", title)
    document["grid"] = _grid(study, drawn, index)
    protection = study.origin.document.get("survival", {}).get("protection") if study.origin else None
    if protection is not None:
        document["survival"] = {"protection": dict(protection)}
    for name, section in _AROUND:
        if (specs := getattr(drawn.around, name)) is not None:
            document[section] = specs[index].document()
    document["simulation"] = _simulation(study, drawn, index, settling_time_of(spec, ready), bridge)
    document["controllers"] = [_controller(study, spec, document, drawn, index, table)]
    document["events"] = _events(study, drawn, index)
    text = toml_text(document, (document["study"]["title"],))
    return study_from_document(document, origin), text


def base_document(
    study: Study, spec: ControllerSpec, folder: str | Path, name: str, title: str | None = None
) -> tuple[dict[str, Any], StudyOrigin]:
    """The document of a study for a case of one controller, for a file in ``folder``: with the converter and the loops,
    and without grid, source, events, controllers and the settings of the run. Raises StudyError where the study was
    built from its parts.
    """
    place = os.path.abspath(folder)

    def beside(file: str) -> str:
        return Path(os.path.relpath(file, place)).as_posix()

    document = own_document(study, _LEFT_OUT, beside, name, title or f"A case of {study.title}")
    if spec.estimate == "truth":
        document.pop("estimator", None)
    return document, StudyOrigin(document, place, name, name)


def own_document(
    study: Study, left_out: Sequence[str], place: Callable[[str], str], name: str, title: str
) -> dict[str, Any]:
    """The document of a study without some sections, under a name and a title, with the gains of inner loops that were
    designed. ``place``: how a file is named whose absolute path is given. Raises StudyError where the study was built
    from its parts."""
    origin = study.origin
    if origin is None:
        fault = Fault("study", "", "was built from its parts and not read from a document", "Use vd.load.")
        raise StudyError(study.name, [fault])
    kept = {section: value for section, value in origin.document.items() if section not in left_out}
    document = with_files(kept, lambda file: place(os.path.abspath(os.path.join(origin.folder, file))))
    document["study"] = {"name": name, "title": title} | ({"source": study.source} if study.source else {})
    if study.inner_request is not None:
        document["inner_loops"] = inner_loops_document(study)
    return document


def inner_loops_document(study: Study) -> dict[str, Any]:
    """The gains that were designed for the study, in place of the wish to design them."""
    gains, c = study.inner_gains, study.converter
    found: dict[str, Any] = {name: float(getattr(gains, name)) for name in ("K_pv", "K_iv", "K_pc", "K_ic")}
    found["current_feedforward"] = float(gains.K_ff)
    if gains.R_t or gains.X_t:
        found["transient_resistance_pu"] = float(gains.R_t) / c.Z_base
        found["transient_reactance_pu"] = float(gains.X_t) / c.Z_base
        found["transient_corner"] = study.omega_t / (2.0 * math.pi)
    if gains.kappa:
        found["current_prediction"] = float(gains.kappa)
    return found


def _grid(study: Study, drawn: LaneCases, k: int) -> dict[str, Any]:
    """The grid of the case with the source of the study, for which closed forms are designed: a controller does not
    know the source of the case, which an event at t = 0 gives."""
    return {
        "scr_basis": study.scr_basis,
        "R_g": float(drawn.R_g[k]),
        "L_g": float(drawn.L_g[k]),
        "V_g_pu": study.grid_source.V_g_rms / study.converter.V_rated_rms,
        "f_g": study.grid_source.omega_g / (2.0 * math.pi),
    }


def _simulation(study: Study, drawn: LaneCases, k: int, settling_time: float, bridge: str) -> dict[str, Any]:
    T_s, own = study.converter.T_s, drawn.take(np.array([k]))
    end = int(ends_of(study, own, segments_of(own), demand_of(study.converter, settling_time), bridge)[0][0])
    found: dict[str, Any] = {
        "duration": end * T_s,
        "bridge": bridge,
        "log_interval": T_s,
        "reference_limit_pu": 100.0,  # the droops take away what a reference is beyond the drawn power
        "P_ref": float(drawn.P_ref[k]),
        "Q_ref": float(drawn.Q_ref[k]),
    }
    return found if drawn.kind[k] == STEP else found | {"survival": True}


def _controller(
    study: Study, spec: ControllerSpec, document: dict[str, Any], drawn: LaneCases, k: int, table: str | None
) -> dict[str, Any]:
    told = float(drawn.error_R[k]), float(drawn.error_X[k]), float(drawn.silent_s[k])
    knowledge = GridEstimate(*told) if any(told) else None
    return controller_document(study, spec, document, knowledge, table)


def controller_document(
    study: Study, spec: ControllerSpec, document: dict[str, Any], knowledge: GridEstimate | None, table: str | None
) -> dict[str, Any]:
    """The controller's own table of the document, with what it knows of the grid."""
    found = dict(next(one for one in document["controllers"] if one.get("name") == spec.name))
    found.pop("knowledge", None)
    if spec.estimate == "truth":  # also where the study names an estimator, whose errors the case has instead
        found.pop("estimate", None)
    if table is not None:
        found["table"] = table
    found |= poles_to_write(spec, mean_time((spec,), study.converter))
    if spec.kind == "fixed" and spec.gains is None and spec.design_grid is not None:
        at = spec.design_grid
        found["design_grid"] = {"scr_basis": study.scr_basis, "R_g": at.R_g, "L_g": at.L_g}
    if spec.kind == "scheduled" and spec.estimate == "truth" and knowledge is not None:
        told = knowledge.error_R, knowledge.error_X, knowledge.silent_s
        found["knowledge"] = dict(zip(("error_R", "error_X", "silent"), told, strict=True))
    return found


def _events(study: Study, drawn: LaneCases, k: int) -> list[dict[str, Any]]:
    begun = GridSource(float(drawn.V_g_rms[k]), float(drawn.omega_g[k]))
    first = Event(0.0, V_g_rms=begun.V_g_rms, omega_g=begun.omega_g)
    begins = () if begun == replace(study.grid_source, components=()) else (first,)
    return [event.document(study.converter) for event in (*begins, *drawn.events.events(k))]


TABLE = "table.json"
"""The gain table of a verification, beside the folders of its cases."""


def written(
    study: Study, spec: ControllerSpec, ready: Ready, cases: LaneCases, index: int, place: Path, bridge: str
) -> str:
    """The text of a study that is one of the cases, for a file ``place``."""
    table = None if ready.table(spec) is None else f"../{TABLE}"
    name = f"{study.name}_{place.stem}".replace("-", "_")
    title = f"{study.title}: {place.stem.replace('-', ' ')}"
    _, text = case_study(
        study,
        spec,
        cases,
        index,
        ready=ready,
        folder=place.parent,
        table=table,
        name=name,
        title=title,
        bridge=bridge,
    )
    return text


def simulated(path: Path, ready: Ready) -> SingleRun:
    """The study of a case as ``vsgdesign simulate`` runs it, with the figures that its results.json gives."""
    study = load_study(path)
    result = run_scenario(study, ready)
    controller = result.controllers[0]
    P, Q = (float(controller.simulation.column(name)[0]) for name in ("P", "Q"))
    mode = expected_rests(study, result.timeline, controller.spec, ready)[-1].mode
    return SingleRun(figures_of_run(controller), P, Q, math.nan if mode is None else -float(mode.s.real))


def figures_of_run(controller: ControllerResult) -> dict[str, float]:
    """Those of the step, or of the survival, by the names of the batch. What the run has no figure for is left out."""
    verdict = controller.survival
    if verdict is not None:
        found = {
            "recovery_s": math.inf if verdict.recovery_s is None else verdict.recovery_s,
            "peak_pu": verdict.peak_pu,
            "first_peak_pu": verdict.first_peak_pu,
            "limited_s": verdict.limited_s,
            "swing_rad": verdict.swing_rad,
        }
        return {name: value for name, value in found.items() if value is not None}
    step = next((event for event in controller.events if event.kind == "step"), None)
    if step is None or step.status not in (MEASURED, NOT_SETTLED, TOO_SHORT):
        return {}
    # In a window that is too short for the slowest mode a run has no figures, but the batch has those of this time.
    figures = step.so_far or step.cycle_mean
    if figures.overshoot_pct is None:
        return {}
    settled = math.inf if figures.settling_time_s is None else figures.settling_time_s
    return {"overshoot": figures.overshoot_pct / 100.0, "settling_s": settled}


EMT = Batch(draw_cases, cases_of, run_lanes, instruction_set, written, simulated)
