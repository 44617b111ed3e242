"""The critical clearing time, on a converter whose limit is known."""

from __future__ import annotations

import pytest

from tests.simulation.survival.subjects import subject
from vsgdesign.metrics.survival import NO_REST, NOT_AT_REST, SURVIVED, Survival
from vsgdesign.simulation.survival import CaseResult, Change, GridState, SurvivalCase, clearing
from vsgdesign.simulation.survival.clearing import LENGTHS_S, ClearingTime, critical_clearing_time


def sag(length_s: float) -> SurvivalCase:
    return SurvivalCase(
        group="sag",
        start=GridState(scr=5.0, x_over_r=3.0, P_pu=0.5, Q_pu=0.0),
        changes=(Change(t_s=0.0, V_g_pu=0.0), Change(t_s=length_s, V_g_pu=1.0)),
        cleared_s=length_s,
    )


def made(
    monkeypatch: pytest.MonkeyPatch, lost: tuple[tuple[float, float], ...], status: str = NOT_AT_REST
) -> list[float]:
    """A converter that loses the faults whose length lies in one of the ranges; the lengths that it is sent through."""
    tried: list[float] = []

    def run(_subject: object, case: SurvivalCase) -> CaseResult:
        tried.append(case.cleared_s)
        found = status if any(low < case.cleared_s <= high for low, high in lost) else SURVIVED
        return CaseResult(case=case, verdict=Survival(status=found), seconds=0.0)

    monkeypatch.setattr(clearing, "run_case", run)
    return tried


@pytest.mark.parametrize("limit", [0.0123, 0.26, 1.234])
def test_it_is_found_to_its_resolution(monkeypatch: pytest.MonkeyPatch, limit: float) -> None:
    made(monkeypatch, ((limit, 9.0),))
    found = critical_clearing_time(subject(), sag)
    assert found.bounded
    assert found.longest_s == pytest.approx(limit, abs=0.005)
    assert found.longest_s is not None
    assert found.longest_s <= limit


def test_the_first_loss_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    made(monkeypatch, ((0.16, 0.25), (2.5, 9.0)))
    assert critical_clearing_time(subject(), sag).longest_s == pytest.approx(0.16, abs=0.005)


def test_nothing_lost_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = made(monkeypatch, ())
    assert critical_clearing_time(subject(), sag) == ClearingTime(LENGTHS_S[-1], False)
    assert tried == list(LENGTHS_S)


def test_no_verdict_is_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    made(monkeypatch, ((0.0, 9.0),), NO_REST)
    assert critical_clearing_time(subject(), sag) == ClearingTime(None, False)
