"""A state of the page as a study file, whose run shows what the page shows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.artifacts.gain_table import base_differences, base_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.verification.emt import own_document
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.report.explore.dc_side import with_written_charge
from vsgdesign.report.explore.scene import Scene, scene_of, study_of
from vsgdesign.report.explore.state import OWN, State
from vsgdesign.simulation.steps import references_at
from vsgdesign.study.given_files import toml_text
from vsgdesign.study.parameters.controllers import mean_time, poles_to_write
from vsgdesign.study.parameters.loading import study_from_document
from vsgdesign.study.parameters.reader import format_quantity
from vsgdesign.study.parameters.study import Study, StudyOrigin

_LEFT_OUT = ("background", "sensors", "replay", "survival", "verification", "estimator", "grid", "simulation", "events")
"""Sections that the page does not show, or that the state says in other words."""
SAME = 1e-6
"""References that differ by less than this share of the rating are the same."""


def saved_study(study: Study, ready: Ready, state: State, files: Mapping[str, Path]) -> tuple[str, list[str]]:
    """The text of a study file for a state, and sentences on what it does not say.

    It contains the state's grid, source, powers, event, changed fields and shown controllers.

    ``study`` has the state's changes already; ``files`` has the file of each controller's gain table. Relative paths of
    the study become absolute, so the file may lie anywhere. Where gains are held, or are the user's own, the file gives
    them as numbers. The references are those that put the map's controller at the state's powers in spite of its
    droops. The page takes references of its own for every controller, and a study has one pair for all: a controller
    that needs other references is left out, and a comment says so. Raises StudyError where no study can say it.
    """
    scene = scene_of(study, ready, state)
    document, run, notes, head = _document(scene, ready, state, files)
    simulation, name = run.simulation, document["study"]["name"]
    document["simulation"] |= {"duration": simulation.duration, "survival": simulation.survival}
    document["events"] = [event.document(study.converter) for event in run.events]
    text = toml_text(document, (*head, *notes))
    study_from_document(
        document,
        StudyOrigin(document, os.path.abspath(os.sep), name, name),
        lambda _: (study.inner_gains, study.omega_t),
    )
    return text, notes


class WithoutEvent(NamedTuple):
    """A study file that ends in its section ``[simulation]``, which lacks ``duration`` and ``survival``: a page without
    a server adds these and its events."""

    text: str
    words: str
    """What the file does not say."""
    P_ref: float
    Q_ref: float
    """W and var."""


def saved_without_event(scene: Scene, ready: Ready, state: State) -> WithoutEvent:
    """The study file of a state but for its event. It names no folder of this machine: a gain table that the study has
    as a file belongs beside it."""
    written = [] if scene.study.origin is None else scene.study.origin.document["controllers"]
    tables = {one["name"]: Path(Path(one["table"]).name) for one in written if "table" in one}
    document, run, notes, head = _document(scene, ready, state, tables)
    for one in document["controllers"]:
        if "table" in one:
            one["table"] = Path(one["table"]).name
            notes.append(f"Put {one['table']}, the gain table of {one['name']}, beside it.")
    document = with_written_charge(document, scene.study)
    document["simulation"] = document.pop("simulation") | {"strict": True}  # it ends the text
    text = toml_text(document, (*head, *notes))
    return WithoutEvent(text, " ".join(notes), run.simulation.P_ref, run.simulation.Q_ref)


def _document(
    scene: Scene, ready: Ready, state: State, files: Mapping[str, Path]
) -> tuple[dict[str, Any], Study, list[str], tuple[str, ...]]:
    """The document of a state without its event; the run of the controller whose references it has; sentences on what
    it does not say, and the lines at its head."""
    study, title = scene.study, f"{scene.study.title}: a state of the explorer"
    document = own_document(study, _LEFT_OUT, str, f"{study.name}-explored", title)
    first = _first(scene, state)
    run = study_of(scene, ready, state, first)
    document["grid"] = {
        "scr_basis": study.scr_basis,
        "scr": state.scr,
        "x_over_r": state.x_over_r,
        "V_g_pu": state.V_g_pu,
        "f_g": state.f_hz,
    }
    protection = study.origin.document.get("survival", {}).get("protection") if study.origin else None
    if protection is not None:
        document["survival"] = {"protection": dict(protection)}
    simulation = run.simulation
    document["simulation"] = {
        "bridge": simulation.bridge,
        "start": simulation.start,
        "log_interval": simulation.log_interval,
        "reference_limit_pu": 100.0,  # the droops take away what a reference is beyond the state's power
        "P_ref": simulation.P_ref,
        "Q_ref": simulation.Q_ref,
    }
    notes: list[str] = []
    document["controllers"] = [
        _controller(scene, ready, state, k, document, files, notes)
        for k in range(len(scene.shown))
        if k == first or _fits(scene, k, run, notes)
    ]
    return document, run, notes, _head(study, scene, first)


def _head(study: Study, scene: Scene, first: int) -> tuple[str, ...]:
    return (
        f"A state of the explorer, of the study {study.name}. Run: vsgdesign run FILE",
        f"The references put {scene.shown[first].name} at the state's P and Q in spite of its droops.",
    )


def _first(scene: Scene, state: State) -> int:
    """The controller whose references the file takes: the map's, if it has gains, else the last that has."""
    good = [k for k, fault in enumerate(scene.cells.faults) if fault is None]
    if not good:
        reasons = "; ".join(dict.fromkeys(fault for fault in scene.cells.faults if fault)) or "no controller is shown"
        raise StudyError("state", [Fault("controllers", "", f"nothing can be saved: {reasons}", "Move the grid.")])
    return next((k for k in good if scene.shown[k].name == state.map_of), good[-1])


def _fits(scene: Scene, k: int, run: Study, notes: list[str]) -> bool:
    """Whether the references of the file put another controller at the same powers."""
    name, fault = scene.shown[k].name, scene.cells.faults[k]
    if fault is not None:
        notes.append(f"{name} is left out: {fault}.")
        return False
    gains = PowerLoopGains(*(float(values[k]) for values in scene.cells.gains))
    needed = references_at(scene.shown[k].study, scene.grid, gains, scene.P, scene.Q)
    given = run.simulation.P_ref, run.simulation.Q_ref
    if all(abs(a - b) < SAME * run.converter.S_rated for a, b in zip(needed, given, strict=True)):
        return True
    shown = ", ".join(format_quantity(float(f"{v:.4g}"), unit) for v, unit in zip(needed, ("W", "var"), strict=True))
    notes.append(f"{name} is left out: with its droops it needs other references ({shown}). Save it alone.")
    return False


def _controller(
    scene: Scene,
    ready: Ready,
    state: State,
    k: int,
    document: Mapping[str, Any],
    files: Mapping[str, Path],
    notes: list[str],
) -> dict[str, Any]:
    """One shown controller: its own table of the document, or its gains as numbers where they are held."""
    one, study = scene.shown[k], scene.study
    written = next((table for table in document["controllers"] if table.get("name") == one.name), {})
    if one.name == OWN or state.hold is not None or one.spec.gains is not None:
        if scene.cells.faults[k] is not None:
            raise StudyError(
                "state", [Fault(f"controllers.{one.name}", "", str(scene.cells.faults[k]), "Do not show it.")]
            )
        gains = PowerLoopGains(*(float(values[k]) for values in scene.cells.gains))
        kept = {key: value for key, value in written.items() if key in _OF_LIMIT}
        structure = one.spec.target.structure
        return {"name": one.name, "kind": "fixed", "structure": structure, "gains": gains._asdict()} | kept
    found = {key: value for key, value in written.items() if key not in ("knowledge", "estimate")}
    if one.spec.kind == "fixed" and one.spec.design_grid is not None:
        at = one.spec.design_grid
        found["design_grid"] = {"scr_basis": study.scr_basis, "R_g": at.R_g, "L_g": at.L_g}
    known = state.error_R, state.error_X, state.silent_s
    if one.spec.kind == "scheduled" and any(known):
        found["knowledge"] = dict(zip(("error_R", "error_X", "silent"), known, strict=True))
    found |= poles_to_write(one.spec, mean_time((), study.converter))  # nothing estimates in the file
    table = ready.table(one.spec)
    if table is not None:
        found |= _table(study, one.name, table, files, notes)
    return found


_OF_LIMIT = ("current_limiter", "current_limit_pu", "limiter")
"""Fields of a controller's own current limit."""


def _table(study: Study, name: str, table: Any, files: Mapping[str, Path], notes: list[str]) -> dict[str, Any]:
    if base_differences(table.base, base_of(study, table.base.scr_basis), "the study"):
        notes.append(f"The page shows {name} with a table for other data; a run designs it again for these data.")
        return {}
    if name not in files:
        notes.append(f"A run designs the gain table of {name} again.")
        return {}
    return {"table": str(files[name])}
