"""One test of the bench's own suite on one converter: from which power, and with what its controller is told."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from evidence._field_converters import CONVERTERS, STUDIES
from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.compliance.case import FOR_EVER_S, Subject
from vsgdesign.campaigns.compliance.matrix import judged_tests
from vsgdesign.campaigns.compliance.measuring import Trace
from vsgdesign.campaigns.compliance.reading import suite_from_text, suite_named
from vsgdesign.campaigns.compliance.rows import Check
from vsgdesign.campaigns.compliance.suite import Criterion, SuiteTest
from vsgdesign.metrics.survival import GRACE_S, SETTLING_TIMES, SURVIVED
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.pipeline.survival import survival_tables

SUITE = "own"
AT_THE_PCC = "bolted fault at the PCC"
"""Group of the tests that are added: no suite has them, because a sag of the source or a fault behind some impedance
leaves the converter a voltage."""

EXTRA = f"""
title = "{AT_THE_PCC}"
criteria = [{{ measure = "survived", at_least = 1 }}]
[[tests]]
name = "{AT_THE_PCC}"
scr = [2, 5, 20]
x_over_r = 5
events = [{{ fault = {{ kind = "three_phase", at = 0, R_pu = [0, 0.01] }}, lasts = ["0.1 s", "0.25 s"] }}]
"""
CONTROLLERS = ("closed form", "table")
TOLD = ("0.2 s late", "never again", "field estimator")
"""What a schedule knows of the grid: the truth 0.2 s after every change, nothing after the first change, or what the
field estimator finds by itself."""

SILENT_S = {"0.2 s late": 0.2, "never again": FOR_EVER_S, "field estimator": 0.0}
WATCHED_S = 5.5
"""How long runs whose schedule is never told again are watched after their last event, s: long enough to see who comes
to rest later than the judge allows, after 3 T + 0.2 s."""

POINTS_PU = (0.5, 0.9, -0.9, 0.0)
"""Powers before the test. The first is that of most tests of the suite, which are taken as they are there."""

CYCLES = 5
"""Power and frequency of a sag are looked at in so many of its last cycles."""

MEASURED = (
    "peak_pu",
    "peak_after_5ms_pu",
    "above_limit_s",
    "recovery_s",
    "fault_current_pu",
    "positive_sequence_pu",
    "negative_sequence_pu",
    "V2_pu",
)


class GridCodeTask(NamedTuple):
    """One run. Its repr tells it from every other."""

    converter: str
    controller: str
    told: str
    P_pu: float
    test: str
    """The id in the suite."""


def run_task(task: GridCodeTask, folder: str) -> dict[str, Any]:
    """The verdict on a task and its figures, in JSON's types. ``folder`` keeps the tables."""
    test = as_asked(tests()[task.test], task)
    subject = subject_of(task.converter, task.controller, task.told, folder)
    ((_, judged),) = judged_tests(subject, [(suite_named_once(), test)])
    row = judged.row
    f_hz = subject.study.converter.omega_n / (2.0 * math.pi)
    stricter_s = SETTLING_TIMES * subject.settling_time + GRACE_S
    ripple = {} if judged.evidence is None else ripple_of(judged.evidence.trace, test, f_hz)
    figures: dict[str, Check] = {check.measure: check for check in row.checks}
    values = {name: figures[name].value if name in figures else None for name in MEASURED}
    recovery_s = values["recovery_s"]
    within_2_T = row.status == SURVIVED and recovery_s is not None and recovery_s <= stricter_s
    found = {"group": row.group, "verdict": row.verdict, "status": row.status, "why": row.why}
    return {**found, "within_2_T": within_2_T, **values, **ripple}


def ripple_of(trace: Trace, test: SuiteTest, f_hz: float) -> dict[str, float]:
    """Power and frequency in the last cycles of a sag that lasts at least CYCLES + 2 of them: mean of P (pu) and the
    amplitudes at twice the nominal frequency (pu and Hz). Empty for any other test."""
    sags = [event.t_s for event in test.events if event.sag is not None]
    ends = [event.t_s for event in test.events if event.t_s > min(sags, default=math.inf)]
    if not ends or ends[0] - sags[0] < (CYCLES + 2) / f_hz:
        return {}
    step = float(trace.t_s[1] - trace.t_s[0])
    stop = int(np.searchsorted(trace.t_s, ends[0] - 1e-3 * step))
    rows = slice(stop - round(CYCLES / f_hz / step), stop)
    turns = np.exp(-2j * (2.0 * math.pi * f_hz) * trace.t_s[rows])
    P, f = trace.P_pu[rows], trace.f_hz[rows]
    mean = float(np.mean(P))
    P_2, f_2 = (2.0 * abs(complex(np.mean((values - np.mean(values)) * turns))) for values in (P, f))
    return {"P_mean_pu": mean, "P_ripple_pu": P_2, "f_ripple_hz": f_2}


def as_asked(test: SuiteTest, task: GridCodeTask) -> SuiteTest:
    """The test from the power of the task, with what the schedule is told, and with everything measured that the
    evidence shows."""
    asked = tuple(one for one in test.criteria if not one.informational)
    shown = tuple(Criterion(measure=name) for name in MEASURED)
    P_pu = test.P_pu if task.P_pu == POINTS_PU[0] else task.P_pu
    changed = replace(test, P_pu=P_pu, silent_s=SILENT_S[task.told], criteria=(*asked, *shown))
    return replace(changed, duration_s=WATCHED_S) if task.told == "never again" else changed


@functools.cache
def suite_named_once() -> Any:
    """The suite, read once in a process."""
    return suite_named(SUITE)


@functools.cache
def tests() -> dict[str, SuiteTest]:
    """Its tests by their ids, and those at the PCC."""
    added = suite_from_text(EXTRA).tests
    return {test.id: test for test in (*suite_named_once().tests, *added)}


@functools.cache
def subject_of(converter: str, controller: str, told: str, folder: str) -> Subject:
    """A converter of the survival studies with one controller."""
    study = load_study(STUDIES / f"{CONVERTERS[converter]}.toml")
    name = f"{controller}, {told}".replace(", ", "-").replace(" ", "_")
    fields = {"name": name, "kind": "scheduled"}
    if told == "field estimator":
        fields["estimate"] = "field"
    if controller == "closed form":
        chosen = study.with_controllers(fields)
        return Subject(study=chosen, spec=chosen.controllers[0])
    table = survival_tables(study, folder).tables["table"]
    chosen = study.with_controllers(fields | {"schedule": "table"})
    return Subject(study=chosen, spec=chosen.controllers[0], ready=Ready(tables={name: table}))
