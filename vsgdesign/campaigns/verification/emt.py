"""The random cases in EMT: how they are drawn, run side by side, written as studies and simulated one by one."""

from __future__ import annotations

import math
from pathlib import Path

from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.verification.blocks import Batch, SingleRun
from vsgdesign.campaigns.verification.case_study import case_study
from vsgdesign.campaigns.verification.draws import cases_of, draw_cases
from vsgdesign.codegen.machine_code import instruction_set
from vsgdesign.metrics.events import MEASURED, NOT_SETTLED, TOO_SHORT
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.scenario import ControllerResult, run_scenario
from vsgdesign.simulation.scenario.checking import expected_rests
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import ControllerSpec, Study

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
