"""The clause matrix: what one test of one controller shows, as a row with its verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from vsgdesign.campaigns.compliance.applies import impossible, not_applicable
from vsgdesign.campaigns.compliance.case import Subject, demand_in
from vsgdesign.campaigns.compliance.envelopes import ENVELOPES
from vsgdesign.campaigns.compliance.evidence import Evidence, Limits, limits_at
from vsgdesign.campaigns.compliance.measures import MEASURES, MeasureInput, Ratings
from vsgdesign.campaigns.compliance.rows import (
    FAIL,
    IMPOSSIBLE,
    INFORMATIONAL,
    NOT_APPLICABLE,
    PASS,
    Check,
    Row,
)
from vsgdesign.campaigns.compliance.run import TestRun, differential_rests, nfp_of, run_tests
from vsgdesign.campaigns.compliance.suite import OURS, Criterion, Source, Suite, SuiteTest
from vsgdesign.errors import StudyError
from vsgdesign.metrics.met import most_overshoot, most_settling_time
from vsgdesign.metrics.survival import SURVIVED


class Judged(NamedTuple):
    """A row, with the trace and the envelopes that it was judged by; None where nothing was run."""

    row: Row
    evidence: Evidence | None


def judged_tests(subject: Subject, asked: Sequence[tuple[Suite, SuiteTest]]) -> Iterator[tuple[int, Judged]]:
    """Tests of one controller, each with its place among those asked for: run and judged, where it applies and where
    any converter could pass it. The order is that in which their runs end."""
    run: list[int] = []
    for place, (suite, test) in enumerate(asked):
        why = not_applicable(subject, test)
        if why is not None:
            yield place, Judged(_row(subject, suite, test, NOT_APPLICABLE, why), None)
            continue
        why = impossible(subject.own_study, test)
        if why is not None:
            yield place, Judged(_row(subject, suite, test, IMPOSSIBLE, why), None)
            continue
        run.append(place)
    for number, found in run_tests(subject, [asked[place][1] for place in run]):
        suite, test = asked[run[number]]
        if isinstance(found, TestRun):
            yield run[number], judge(subject, suite, found)
            continue
        said = "; ".join(map(str, found.faults)) if isinstance(found, StudyError) else str(found)
        why = f"it cannot be simulated with this converter: {said}"  # what no run of this converter can show
        yield run[number], Judged(_row(subject, suite, test, NOT_APPLICABLE, why), None)


def judge(subject: Subject, suite: Suite, run: TestRun) -> Judged:
    """The row of a run: every criterion measured and compared with what it asks."""
    test, survival = run.test, run.survival
    if run.trace is None:
        checks = tuple(_unmeasured(one, test.source, survival.reason or survival.status) for one in test.criteria)
        verdict = _of_checks(checks)
        return Judged(_row(subject, suite, test, verdict, survival.reason or "", checks, survival.status), None)
    given = MeasureInput(
        test=test,
        trace=run.trace,
        ratings=Ratings.of(run.study, run.spec),
        survival=survival,
        gains=run.gains,
        nfp=nfp_of(run.study, run.gains),
    )
    checks, limits = [], []
    for criterion in test.criteria:
        check, limit = _checked(criterion, given)
        checks.append(check)
        limits += [] if limit is None else [limit]
    if subject.units > 1:
        checks.append(_against_each_other(subject, run))
    verdict = _of_checks(checks)
    row = _row(subject, suite, test, verdict, _why(run, checks), tuple(checks), survival.status)
    row = replace(row, peak_pu=survival.peak_pu)
    return Judged(row, Evidence(trace=run.trace, limits=tuple(limits)))


def _against_each_other(subject: Subject, run: TestRun) -> Check:
    """The slowest mode of the units of a plant against each other, which does not show while all move alike, at the
    rests before and after the test."""
    found = differential_rests(run, subject.lead_s)
    verdict = INFORMATIONAL if isinstance(found, str) else PASS if found > 0.0 else FAIL
    why = found if isinstance(found, str) else ""
    if verdict == FAIL:  # a decay below zero is read as one
        why = f"the units grow against each other with {-float(found):.4g} 1/s"
    return Check(
        measure="units_against_each_other",
        label="slowest decay of the units against each other",
        value=None if isinstance(found, str) else found,
        unit="1/s",
        at_least=0.0,
        ours=True,
        limit_of=OURS,
        verdict=verdict,
        why=why,
    )


def _why(run: TestRun, checks: Sequence[Check]) -> str:
    """Why a row fails, in words; of any other row what is remarkable of its run."""
    status, reason = run.survival.status, run.survival.reason
    lost = [] if status == SURVIVED else [_with_status(status, reason)]
    failed = [
        _failure(check)
        for check in checks
        if check.verdict == FAIL and not (lost and (check.measure == "survived" or check.why == reason))
    ]
    held = [reason] if status == SURVIVED and reason is not None else []
    return "; ".join([*lost, *failed, *held])


def _with_status(status: str, reason: str | None) -> str:
    if reason is None or reason.startswith(status):
        return reason or status
    return f"{status}: {reason}"


def _failure(check: Check) -> str:
    if check.value is None:
        return f"{check.label}: {check.why}" if check.why else f"{check.label} is not known"
    if check.why:
        return check.why
    value = f"{check.label} {check.value:.4g}{' ' * bool(check.unit)}{check.unit}"
    if check.envelope is not None:
        return f"{value} outside of its envelope"
    limit = f"below {check.at_least:.4g}" if _below(check) else f"above {check.at_most:.4g}"
    return f"{value}, {limit}"


def _below(check: Check) -> bool:
    return check.at_least is not None and check.value is not None and not check.value >= check.at_least


def _checked(criterion: Criterion, given: MeasureInput) -> tuple[Check, Limits | None]:
    """One criterion, measured; and the envelope, if it is one."""
    if criterion.envelope is not None:
        envelope = ENVELOPES[criterion.envelope]
        bounds = envelope.of(given, criterion.given)
        excess = None if bounds.why else _known(bounds.excess(given.trace))
        check = Check(
            measure=criterion.measure,
            label=envelope.label,
            value=excess,
            unit="pu",
            at_most=0.0,
            envelope=criterion.envelope,
            ours=criterion.ours,
            limit_of=criterion.limit_of(given.test.source),
            verdict=_verdict(criterion, excess),
            why=bounds.why,
        )
        if bounds.why:
            return check, None
        limits = limits_at(given.trace.t_s, bounds.signal, bounds.t_s, bounds.low, bounds.high)
        return check, limits
    measure = MEASURES[criterion.measure]
    found = measure.of(given, criterion.given)
    check = Check(
        measure=criterion.measure,
        label=measure.label,
        value=found.value,
        plus_minus=found.plus_minus,
        unit=measure.unit,
        at_least=criterion.at_least,
        at_most=criterion.at_most,
        ours=criterion.ours,
        limit_of=criterion.limit_of(given.test.source),
        verdict=_verdict(criterion, found.value),
        why=found.why,
    )
    return check, None


def _known(excess: float) -> float | None:
    """An excess over an envelope, None where the run holds what is no number."""
    return excess if math.isfinite(excess) else None


def _verdict(criterion: Criterion, value: float | None) -> str:
    """What is not known has not been shown, so it does not pass."""
    if criterion.informational:
        return INFORMATIONAL
    if value is None:
        return FAIL
    if criterion.envelope is not None:
        return PASS if value <= 0.0 else FAIL
    kept = criterion.at_least is None or value >= criterion.at_least
    if kept and criterion.at_most is not None:
        kept = value <= _MOST.get(criterion.measure, float)(criterion.at_most)
    return PASS if kept else FAIL


_MOST: Mapping[str, Callable[[float], float]] = {"settling_s": most_settling_time, "overshoot_pu": most_overshoot}
"""The largest value that keeps a limit, where this is not the limit itself."""


def _unmeasured(criterion: Criterion, source: Source, why: str) -> Check:
    known = ENVELOPES[criterion.envelope] if criterion.envelope is not None else MEASURES[criterion.measure]
    return Check(
        measure=criterion.measure,
        label=known.label,
        value=None,
        unit=getattr(known, "unit", "pu"),
        at_least=criterion.at_least,
        at_most=criterion.at_most,
        envelope=criterion.envelope,
        ours=criterion.ours,
        limit_of=criterion.limit_of(source),
        verdict=INFORMATIONAL if criterion.informational else FAIL,
        why=why,
    )


def _of_checks(checks: Iterable[Check]) -> str:
    verdicts = {check.verdict for check in checks}
    return FAIL if FAIL in verdicts else PASS if PASS in verdicts else INFORMATIONAL


def _row(
    subject: Subject,
    suite: Suite,
    test: SuiteTest,
    verdict: str,
    why: str,
    checks: tuple[Check, ...] = (),
    status: str = "",
) -> Row:
    demand = demand_in(subject, test)
    return Row(
        suite=suite.name,
        test=test.id,
        group=test.group,
        title=test.title,
        controller=subject.spec.name,
        network=network_in_words(test),
        verdict=verdict,
        why=why,
        checks=checks,
        status=status,
        settling_time_s=demand.settling_time,
        deadline_s=demand.deadline_s,
        source=vars(test.source).copy(),
    )


def network_in_words(test: SuiteTest) -> str:
    """The grid and the operating point of a test: ``SCR 3, X/R 10, P 0.5 pu``."""
    parts = [f"SCR {test.scr:.4g}", f"X/R {test.x_over_r:.4g}", f"P {test.P_pu:.4g} pu"]
    if test.Q_pu:
        parts.append(f"Q {test.Q_pu:.4g} pu")
    if test.df_hz:
        parts.append(f"{test.df_hz:+.4g} Hz")
    if test.V_g_pu != 1.0:
        parts.append(f"V_g {test.V_g_pu:.4g} pu")
    if test.load is not None:
        S = test.load.in_si(1.0, 1.0).admittance(1.0).conjugate()
        parts.append(f"load {S.real:.3g} pu" + (f", {S.imag:.3g} pu reactive" if abs(S.imag) > 1e-6 else ""))
    return ", ".join(parts)
