"""A suite that asks for settling and for the power of before, and not for survival, passes no run that is lost."""

from __future__ import annotations

import functools

from tests.compliance.bench_studies import judged_test
from vsgdesign.campaigns.compliance.case import Subject
from vsgdesign.campaigns.compliance.reading import suite_from_text
from vsgdesign.campaigns.compliance.rows import FAIL, Row
from vsgdesign.study.parameters.loading import study_from_text

STUDY = """
base = "case:lab_12kva_lcl"
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
grid = { scr = 3, x_over_r = 4 }
simulation = { duration = "8 s", P_ref = "4 kW", Q_ref = "0 var" }
[[controllers]]
name = "drift"                     # one mode decays with 73 s
kind = "fixed"
structure = "angle_damped"
settling_time = "1 s"
[controllers.gains]
K_ip = 1.8783e-07
D_p = 795.77
K_iq = 5.3538e-05
D_q = 1082.5
K_pq = -8.435e-09
K_qp = 1.537e-06
k_P = 4.355e-06
k_Q = -1.956e-07
[[controllers]]
name = "slips"
kind = "fixed"
structure = "published"
settling_time = "0.02 s"
design_grid = { scr = 1.2, x_over_r = 20 }
current_limiter = "circular"
"""

SUITE = """
criteria = [{ measure = "settling_s", at_most = "1 s" }, { measure = "P_back_s", at_most = "1 s" }]
[[tests]]
name = "jump"
scr = [3, 20]
x_over_r = [0.3, 20]
P_pu = 0.2
events = [{ phase_jump = "20 deg" }]
"""


@functools.cache
def rows_of(controller: str) -> tuple[Row, ...]:
    study, suite = study_from_text(STUDY), suite_from_text(SUITE)
    spec = next(spec for spec in study.controllers if spec.name == controller)
    return tuple(judged_test(Subject(study=study, spec=spec), suite, test).row for test in suite.tests)


def test_a_run_that_slips_settles_nowhere() -> None:
    """Three of four passed, with a settling time of 0.28 s and an angle of 9.8 rad."""
    rows = rows_of("slips")
    assert [row.status for row in rows].count("slipped") == 3
    for row in rows:
        assert row.verdict == FAIL
        assert all(check.value is None and check.why in row.why for check in row.checks)


def test_a_run_that_drifts_has_not_settled_where_its_trace_ends() -> None:
    """0.94 s was told where a longer trace shows 73 s."""
    for row in rows_of("drift"):
        assert row.status == "not at rest"
        assert row.verdict == FAIL
        assert all(check.value is None and check.why.startswith("not at rest") for check in row.checks)
