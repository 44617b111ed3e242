"""A few certified steps in the EMT: none from inside makes the limiter act after 5 ms, some from outside do.

``python -m evidence certified_steps`` runs 15,000.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator

from evidence.certified_steps import SteppedRun, stated, stepped_run
from vsgdesign.artifacts.certificate_record import StepStatement
from vsgdesign.certificate.region import System
from vsgdesign.study.parameters import Study


@functools.cache
def statement() -> tuple[Study, System, StepStatement]:
    return stated(budget=300, nodes_per_axis=4, fresh=100)


def runs(factor: float, count: int) -> Iterator[SteppedRun]:
    study, system, found = statement()
    rows = [row for row in found.rows if row.possible]
    every = (stepped_run(study, system, rows[seed % len(rows)], factor, seed) for seed in range(count))
    return (run for run in every if run is not None)


def test_no_limit_acts_after_a_certified_step() -> None:
    found = list(runs(0.9, 25))
    assert len(found) > 20
    assert {run.kind for run in found} == {"P_ref", "Q_ref", "phase", "V_g", "omega_g"}
    assert all(run.limited_later == 0 for run in found)
    assert max(run.largest_pu for run in found) < 1.15


def test_a_limit_acts_after_some_larger_step() -> None:
    assert any(run.limited_later > 0 for run in runs(6.0, 25))
