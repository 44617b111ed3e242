"""One test of the bench's own suite on one converter: from which power, and with what its controller is told."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from evidence.survival import CONVERTERS, STUDIES
from vsgdesign.artifacts.ready import Ready
from vsgdesign.compliance.matrix import judged_test
from vsgdesign.compliance.reading import suite_named
from vsgdesign.compliance.rows import Check
from vsgdesign.compliance.subject import FOR_EVER_S, Subject
from vsgdesign.compliance.suite import Criterion, SuiteTest
from vsgdesign.parameters import load_study
from vsgdesign.pipeline.survival import survival_tables

SUITE = "own"
CONTROLLERS = ("closed form", "table")
TOLD = ("0.2 s late", "never again", "field estimator")
"""What a schedule knows of the grid: the truth 0.2 s after every change, nothing after the first change, or what the
field estimator finds by itself."""

SILENT_S = {"0.2 s late": 0.2, "never again": FOR_EVER_S, "field estimator": 0.0}
WATCHED_S = 5.5
"""How long runs whose schedule is never told again are watched after their last event, s: long enough to see who comes
to rest later than the judge allows, after 2 T + 0.2 s."""

POINTS_PU = (0.5, 0.9, -0.9, 0.0)
"""Powers before the test. The first is that of most tests of the suite, which are taken as they are there."""

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
    row = judged_test(subject_of(task.converter, task.controller, task.told, folder), suite_named_once(), test).row
    figures: dict[str, Check] = {check.measure: check for check in row.checks}
    values = {name: figures[name].value if name in figures else None for name in MEASURED}
    return {"group": row.group, "verdict": row.verdict, "status": row.status, "why": row.why, **values}


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
    """Its tests by their ids."""
    return {test.id: test for test in suite_named_once().tests}


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


def prepare(converter: str, folder: Path) -> None:
    """Designs the table of a converter, if the folder does not have it."""
    survival_tables(load_study(STUDIES / f"{CONVERTERS[converter]}.toml"), folder)
