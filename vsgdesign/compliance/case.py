"""A test of a suite as a study of its own, in SI: the run of its row, and the file that repeats it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from vsgdesign.compliance.subject import Subject
from vsgdesign.compliance.suite import SuiteEvent, SuiteTest
from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.grid import Place
from vsgdesign.parameters.loading import study_from_document
from vsgdesign.parameters.network_fields import fault_document, load_document, sag_document
from vsgdesign.parameters.study import Study
from vsgdesign.parameters.toml_text import toml_text
from vsgdesign.simulation.clearing import MOST_CYCLES
from vsgdesign.simulation.survival.cases import BASIS
from vsgdesign.simulation.survival.demand import demand_of, silent_s_of
from vsgdesign.verification.case_study import base_document, controller_document


def case_of(
    subject: Subject, test: SuiteTest, *, name: str | None = None, folder: str | Path = ".", table: str | None = None
) -> tuple[Study, str]:
    """The study that a test is for a controller, and its text for a file in ``folder``.

    The converter is at rest for the lead time of the subject, and then the test begins. ``table``: the gain table of
    the controller as the file is to name it; None: as the study names it. Raises StudyError where the study was built
    from its parts, or where the test cannot be said in a study.
    """
    study, spec = subject.study, subject.told(test.silent_s)
    c, source, title = study.converter, study.grid_source, f"{test.title}: {subject.spec.name}"
    document, origin = base_document(study, spec, folder, name or f"{study.name}_case", title)
    grid = Place(test.scr, test.x_over_r, BASIS).grid(c)
    # The source of the study stays, for which closed forms are designed; an event at t = 0 gives that of the test.
    document["grid"] = {
        "scr_basis": study.scr_basis,
        "R_g": grid.R_g,
        "L_g": grid.L_g,
        "V_g_pu": source.V_g_rms / c.V_rated_rms,
        "f_g": source.omega_g / (2.0 * math.pi),
    }
    document["simulation"] = {
        "duration": _whole_rows(subject, subject.lead_s + test.cleared_s + after_s(subject, test)),
        "bridge": "averaged",
        "start": "steady_state",
        "log_interval": c.T_s,
        "reference_limit_pu": 100.0,
        "P_ref": test.P_pu * c.S_rated,
        "Q_ref": test.Q_pu * c.S_rated,
        "survival": True,
    }
    document["controllers"] = [controller_document(study, spec, document, spec.knowledge, table)]
    if test.load is not None:
        document["network"] = {"load": load_document(test.load, per_unit=True)}
    f_n = c.omega_n / (2.0 * math.pi)
    first = {"time": 0.0, "V_g_pu": test.V_g_pu, "f_g": f_n + test.df_hz}
    same = test.V_g_pu * c.V_rated_rms == source.V_g_rms and source.omega_g == c.omega_n and test.df_hz == 0.0
    events = [_event(event, c, subject.lead_s) for event in test.events]
    document["events"] = events if same else [first, *events]
    return study_from_document(document, origin), toml_text(document, (title,))


def after_s(subject: Subject, test: SuiteTest) -> float:
    """How long a test is watched after its last event, s: as long as it asks for, and as the judge needs."""
    c, T = subject.study.converter, subject.settling_time
    cycle_s = 2.0 * math.pi / c.omega_n
    demand = demand_of(c, T, silent_s=silent_s_of(subject.told(test.silent_s)), limit_pu=subject.limit_pu)
    # The last phase of a fault may be interrupted so long after the instant at which the test clears it.
    late_s = MOST_CYCLES * cycle_s if any(event.fault_cleared for event in test.events) else 0.0
    return late_s + max(demand.needed_s + 2.0 * cycle_s, test.duration_s or 0.0)


def _whole_rows(subject: Subject, duration_s: float) -> float:
    row_s = subject.row_samples * subject.study.converter.T_s
    return math.ceil(duration_s / row_s - 1e-9) * row_s


def _event(event: SuiteEvent, c: Converter, lead_s: float) -> dict[str, Any]:
    """One event as the table of a study's [[events]]."""
    found: dict[str, Any] = {"time": lead_s + event.t_s}
    if event.scr is not None and event.x_over_r is not None:
        grid = Place(event.scr, event.x_over_r, BASIS).grid(c)
        found["grid"] = {"R_g": grid.R_g, "L_g": grid.L_g}
    if event.V_g_pu is not None:
        found["V_g_pu"] = event.V_g_pu
    if event.df_hz is not None:
        found["f_g"] = c.omega_n / (2.0 * math.pi) + event.df_hz
    if event.over_s > 0.0:
        found["over"] = event.over_s
    if event.phase_deg != 0.0:
        found["phase_jump"] = math.radians(event.phase_deg)
    if event.P_pu is not None:
        found["P_ref"] = event.P_pu * c.S_rated
    if event.Q_pu is not None:
        found["Q_ref"] = event.Q_pu * c.S_rated
    return found | _of_network(event)


def _of_network(event: SuiteEvent) -> dict[str, Any]:
    """What an event says of dip, load, fault and breaker."""
    found: dict[str, Any] = {}
    if event.sag is not None:
        found["sag"] = sag_document(event.sag)
    if event.fault is not None:
        found["fault"] = fault_document(event.fault, per_unit=True)
    elif event.fault_cleared:
        found["fault"] = "cleared"
    if event.load is not None:
        found["load"] = load_document(event.load, per_unit=True)
    elif event.load_off:
        found["load"] = "none"
    if event.connected is not None:
        found["breaker"] = "closed" if event.connected else "open"
    if event.synchro_check is not None:
        check = event.synchro_check
        df = check.omega / (2.0 * math.pi)
        found["synchro_check"] = {"angle": check.angle, "V_pu": check.V_pu, "df": df, "around": check.around}
    return found
