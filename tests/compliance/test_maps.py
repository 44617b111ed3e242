"""Survival maps against the runs of their cells, one after the other."""

from __future__ import annotations

import dataclasses
import functools
import json
import math

import numpy as np
import pytest

from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.compliance import maps
from vsgdesign.campaigns.compliance.maps import KINDS, Mapped, SurvivalMap, clearing_times_of, survival_map
from vsgdesign.metrics.survival import SURVIVED
from vsgdesign.simulation.survival import GridKnowledge, GridState, Subject, SurvivalCase, run_case
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Load, Network


@functools.cache
def mapped(controller: int = 2, limiter: str | None = None) -> Mapped:
    study = load_study("studies/survival/study.toml")
    spec = dataclasses.replace(study.controllers[controller], current_limiter=limiter)
    return Mapped(study=study, spec=spec, ready=Ready())


@functools.cache
def drawn(kind: str, controller: int = 2) -> SurvivalMap:
    return survival_map(kind, mapped(controller))


def alone(
    scr: float, x_over_r: float, *changes: Event, controller: int = 2, limiter: str | None = None
) -> tuple[str, float]:
    """Status and recovery time of one case, by the runs of :mod:`vsgdesign.simulation.survival`."""
    one = mapped(controller, limiter)
    case = SurvivalCase(
        group="cell",
        start=GridState(scr=scr, x_over_r=x_over_r, P_pu=0.5, Q_pu=0.0),
        changes=changes,
        cleared_s=changes[-1].t_s,
        knowledge=GridKnowledge(silent_s=maps.SILENT_S),
    )
    verdict = run_case(Subject(study=one.study, spec=one.spec, limit_pu=1.2), case).verdict
    return verdict.status, math.nan if verdict.recovery_s is None else verdict.recovery_s


@pytest.mark.parametrize("controller", [0, 2])
@pytest.mark.parametrize(("row", "column"), [(0, 3), (4, 6), (9, 9)])
def test_a_sag_is_the_run_of_its_cell(row: int, column: int, controller: int) -> None:
    found = drawn("sag", controller)
    V, length = found.y.values[row], found.x.values[column]
    changes = Event.of_pu(0.0, V_g_pu=V), Event.of_pu(length, V_g_pu=1.0)
    status, recovery_s = alone(maps.SAG_SCR, maps.X_OVER_R_OF_MAPS, *changes, controller=controller)
    assert found.status[row][column] == status
    if status == SURVIVED:
        assert found.values[row][column] == pytest.approx(recovery_s, rel=1e-3)  # four digits


@pytest.mark.parametrize(("row", "column"), [(0, 0), (9, 7)])
def test_a_phase_jump_is_the_run_of_its_cell(row: int, column: int) -> None:
    found = drawn("phase")
    jump = Event.of_pu(0.0, phase_deg=found.y.values[row])
    status, recovery_s = alone(found.x.values[column], maps.X_OVER_R_OF_MAPS, jump)
    assert (found.status[row][column], found.values[row][column]) == (status, pytest.approx(recovery_s, rel=1e-3))


def test_a_fault_of_the_critical_length_is_survived_and_a_longer_one_is_not() -> None:
    """With the hybrid limiter: the projection limiter survives every length that is tried."""
    limiter = "hybrid"
    times, refused = clearing_times_of(mapped(2, limiter), np.array([1.2]), np.array([20.0]), maps.LOADED_PU)
    assert refused == ("",)
    assert times.bounded.all()
    longest = float(times.longest_s[0])
    for length, expected in ((longest, True), (longest + 0.005, False)):
        status, _ = alone(1.2, 20.0, Event.of_pu(0.0, V_g_pu=0.0), Event.of_pu(length, V_g_pu=1.0), limiter=limiter)
        assert (status == SURVIVED) is expected


def test_cells_without_a_rest_say_so() -> None:
    times, refused = clearing_times_of(mapped(), np.array([0.1, 5.0]), np.array([3.0, 3.0]), maps.LOADED_PU)
    assert np.isnan(times.longest_s[0])
    assert refused[0] in ("no rest", "rest over limit")
    assert refused[1] == ""


def test_what_the_study_says_of_its_grid_is_left_out() -> None:
    one = mapped()
    loaded = dataclasses.replace(one.study, network=Network(load=Load(R_parallel=5.0)))
    assert survival_map("sag", dataclasses.replace(one, study=loaded)) == drawn("sag")


@pytest.mark.parametrize("kind", KINDS)
def test_a_map_is_json_with_a_value_or_a_reason_in_every_cell(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maps, "X_OVER_R", maps.X_OVER_R[::4])  # its ends: of the clearing times alone, which take long
    found = drawn(kind)
    document = json.loads(json.dumps(found.document(), allow_nan=False))
    assert document["key"] == kind
    shape = (len(found.y.values), len(found.x.values))
    assert np.shape(found.status) == shape
    assert [len(row) for row in found.values] == [shape[1]] * shape[0]
    for row, words in zip(found.values, found.status, strict=True):
        assert all(word and (value is not None or word != SURVIVED) for value, word in zip(row, words, strict=True))
