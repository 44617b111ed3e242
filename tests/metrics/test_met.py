"""One rule for "met": whoever judges a step says the same of the same figures, at the edge as well."""

from __future__ import annotations

from dataclasses import asdict, replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.simulation.test_promises import ASKED, study_with
from vsgdesign.campaigns.compliance.matrix import _verdict
from vsgdesign.campaigns.compliance.rows import PASS
from vsgdesign.campaigns.compliance.suite import Criterion
from vsgdesign.campaigns.verification.counting import verified_promises
from vsgdesign.design.evaluation import Figures, shortfalls
from vsgdesign.design.inner.promises import PromiseReached
from vsgdesign.linear.stability.table_claims import claim_faults
from vsgdesign.metrics.events import EventMetrics
from vsgdesign.metrics.met import overshoot_met, score_met, settling_met
from vsgdesign.metrics.step_response import no_figures
from vsgdesign.report.explore.fields import most_allowed
from vsgdesign.report.scenario.outcomes import StepOutcome
from vsgdesign.report.stability.inner import GAIN_TEXTS, inner_tables
from vsgdesign.simulation.lanes.cases import ACTIVE, REACTIVE
from vsgdesign.simulation.scenario.judging import promises_of

STUDY, READY = study_with(ASKED)
SPEC = STUDY.controllers[0]
T, SHARE = Fraction(13, 10), Fraction(5, 100)
LATEST, MOST = Fraction(1005, 1000) * T, SHARE + Fraction(5, 10_000)
"""Settling time ≤ 1.005 T, overshoot ≤ its target + 0.05 points, in exact numbers."""
NEAR = (Fraction(1), 1 - Fraction(1, 10**6), 1 + Fraction(1, 10**6))
"""At the edge, and a millionth before and behind it."""
TIMES = (T, *(LATEST * near for near in NEAR))
OVERSHOOTS = (Fraction(0), SHARE, *(MOST * near for near in NEAR))


def of_the_page(settled_s: float, share: float, signal: str) -> bool:
    """The page of a run, the facade and their sentences."""
    figures = replace(no_figures(0.0, 1.0), settling_time_s=settled_s, overshoot_pct=100.0 * share)
    metrics = EventMetrics(
        name="more", t_s=0.0, signal=signal, kind="step", raw=figures, cycle_mean=figures, peak_current_pu=1.0
    )
    controller: Any = SimpleNamespace(ripples=False)
    promises = promises_of(STUDY, SPEC, READY)
    step = StepOutcome(
        controller=controller,
        metrics=metrics,
        window_s=9.0,
        rest=None,
        uncoupled=None,
        promises=promises,
        at_rest=True,
    )
    assert step.judged
    return not step.misses


def of_verify(settled_s: float, share: float, signal: str) -> bool:
    values = {"overshoot": share, "settling_s": settled_s}
    which = np.array([ACTIVE if signal == "P_pcc" else REACTIVE], dtype=np.int8)
    held = [p for p in verified_promises(STUDY, SPEC, READY, {"step": True}) if p.figure in values]
    assert len(held) == 2
    return all(bool(values[p.figure] <= p.most_of(which)[0]) for p in held)


def of_comply(settled_s: float, share: float, signal: str) -> bool:
    del signal
    asked = {"settling_s": (float(T), settled_s), "overshoot_pu": (float(SHARE), share)}
    return all(
        _verdict(Criterion(measure=name, at_most=limit), value) == PASS for name, (limit, value) in asked.items()
    )


def of_a_design(settled_s: float, share: float, signal: str) -> bool:
    """A node of a table, ``compare``, and the check between the nodes."""
    del signal
    figures = Figures(
        overshoot_P=share,
        settling_P=settled_s,
        overshoot_Q=0.0,
        settling_Q=0.1,
        cross_peak=0.0,
        disk_margin=9.0,
        damping_ratio=1.0,
        abscissa=-1.0,
    )
    spec = STUDY.specification
    assert spec is not None
    assert (spec.settling_time, spec.overshoot) == (float(T), float(SHARE))
    return shortfalls(spec, figures, 1.0) == {}


def of_the_explorer(settled_s: float, share: float, signal: str) -> bool:
    """What the page's table compares with."""
    del signal
    most = most_allowed({"settling_s": float(T), "overshoot": float(SHARE)}, None)
    return settled_s <= most["settling_s"] and share <= most["overshoot"]


def of_a_check(settled_s: float, share: float, signal: str) -> bool:
    """``table check``: a node that is met keeps the specification of its table."""
    figures = {"worst_settling_P_s": settled_s, "worst_overshoot_P_pct": 100.0 * share}
    if signal == "Q_pcc":
        figures = {name.replace("_P_", "_Q_"): value for name, value in figures.items()}
    table = READY.table(SPEC)
    assert table is not None
    changed = replace(table, margins={name: np.full(table.status.shape, value) for name, value in figures.items()})
    return not any("the specification asks for" in fault for fault in claim_faults(changed))


USERS = (of_the_page, of_verify, of_comply, of_a_design, of_the_explorer, of_a_check)


@pytest.mark.parametrize("user", USERS)
def test_all_say_the_same_of_the_same_figures(user: Any) -> None:
    for settled in TIMES:
        for share in OVERSHOOTS:
            expected = settled <= LATEST and share <= MOST
            for signal in ("P_pcc", "Q_pcc"):
                assert user(float(settled), float(share), signal) is expected, (float(settled), float(share))


def test_what_does_not_settle_and_noise() -> None:
    assert not settling_met(None, 1.0)
    assert not settling_met(float("nan"), 1.0)
    assert not settling_met(float("inf"), 1.0)
    assert not overshoot_met(0.0524, 0.05, noise=0.0018)
    assert overshoot_met(0.0524, 0.05, noise=0.0020)


def test_a_step_of_Q_has_its_own_overshoot() -> None:
    """The published structure promises e^(−πξ/√(1 − ξ²)) of P, and none of Q, whose loop is of first order. ``verify``
    allowed both what P may do, and never less than 2 %."""
    target = replace(SPEC.target, structure="published", damping_ratio=0.7)
    closed = replace(SPEC, schedule="closed_form", target=target)
    overshoot = verified_promises(STUDY, closed, READY, {"step": True})[0]
    assert overshoot.name == "overshoot"
    most = overshoot.most_of(np.array([ACTIVE, REACTIVE], dtype=np.int8))
    assert most[0] == pytest.approx(np.exp(-np.pi * 0.7 / np.sqrt(1.0 - 0.49)) + 5e-4, rel=1e-9)
    assert most[1] == pytest.approx(5e-4, rel=1e-9)


def test_a_share_of_the_inner_loops_is_reached_within_a_thousandth() -> None:
    """The verdict and the coloured rows of the page agree at the edge; what has no value is not reached."""
    document: dict[str, Any] = {"promises": [], "gains": {name: 1.0 for name, _, _ in GAIN_TEXTS}}
    shares = (1.0, 0.9991, 0.9989, None)
    for share in shares:
        reached = PromiseReached("tolerance", 0.15, 0.15, np.nan if share is None else share, 1.5, 15.0)
        assert reached.kept is score_met(share)
        document["promises"].append(asdict(reached) | {"score": share})
    assert [score_met(share) for share in shares] == [True, True, False, False]
    assert inner_tables(document)[0].flagged == {2, 3}
