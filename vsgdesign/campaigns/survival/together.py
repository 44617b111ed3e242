"""Many disturbances of one converter side by side: each run is a lane of one loop, and the verdicts are those of
:mod:`vsgdesign.simulation.survival.running`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.campaigns.survival.plants import plant_verdict
from vsgdesign.metrics.survival import LATCHED, NOT_AT_REST, SLIPPED, SURVIVED, Survival, SurvivalDemand, why_lost
from vsgdesign.runtime.of_study import follows_measured
from vsgdesign.simulation.lanes.cases import ACTIVE, DISTURBANCE, LaneCases, LaneEvents
from vsgdesign.simulation.lanes.results import JUDGED, STATUSES, LaneResults
from vsgdesign.simulation.lanes.run import run_told
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.lanes.told import ToldGrids
from vsgdesign.simulation.survival.cases import SurvivalCase
from vsgdesign.simulation.survival.running import Subject, run_case
from vsgdesign.simulation.timeline import build_timeline

FIGURES = (SURVIVED, SLIPPED, LATCHED, NOT_AT_REST)
"""Verdicts whose words need no more than the figures of a lane."""


def verdicts_of(subject: Subject, cases: Sequence[SurvivalCase]) -> list[Survival]:
    """The verdict of :func:`vsgdesign.simulation.survival.running.run_case` on each of the cases.

    Those without a rest that is asked for, and those that diverge, are run alone: their reasons say more than a lane
    keeps.
    """
    if subject.study.plant is not None:
        return [plant_verdict(subject, case) for case in cases]
    some = [k for k, case in enumerate(cases) if _may_be_a_lane(subject, case)]
    found = dict(zip(some, _together(subject, [cases[k] for k in some]), strict=True))
    return [found.get(k) or run_case(subject, case).verdict for k, case in enumerate(cases)]


def share_a_loop(subject: Subject) -> bool:
    """Whether runs of a subject can share a loop: averaged, in a clean grid, with told or fixed gains."""
    study = subject.study
    alone = study.plant is not None or subject.in_the_field or subject.learns or study.protection is not None
    return subject.bridge == "averaged" and not alone


def _may_be_a_lane(subject: Subject, case: SurvivalCase) -> bool:
    """Gains at a design point are made for the source of the case, so that it must be that of the study."""
    study, spec = subject.study, subject.spec
    if not share_a_loop(subject):
        return False
    for_any_source = spec.schedule == "table" or spec.gains is not None or follows_measured(spec)
    return for_any_source or case.study(study, 0.0).grid_source == study.grid_source


def _together(subject: Subject, cases: Sequence[SurvivalCase]) -> list[Survival | None]:
    """The verdicts on runs in one loop; None where a run of its own has to say why."""
    if not cases:
        return []
    own, demands = subject.study.with_limit_of(subject.spec), [subject.demand(case) for case in cases]
    studies = [
        case.study(own, demand.needed_s + 2.0 * demand.cycle_s) for case, demand in zip(cases, demands, strict=True)
    ]
    said = [case.told(study, build_timeline(study)) for case, study in zip(cases, studies, strict=True)]
    none = np.zeros(len(cases))
    lanes = LaneCases(
        R_g=np.array([study.grid.R_g for study in studies]),
        L_g=np.array([study.grid.L_g for study in studies]),
        V_g_rms=np.array([study.grid_source.V_g_rms for study in studies]),
        omega_g=np.array([study.grid_source.omega_g for study in studies]),
        P_ref=np.array([study.simulation.P_ref for study in studies]),
        Q_ref=np.array([study.simulation.Q_ref for study in studies]),
        events=LaneEvents.of([study.events for study in studies]),
        error_R=none,
        error_X=none,
        silent_s=np.array([case.knowledge.silent_s for case in cases]),
        cleared_s=np.array([case.lead_s + case.cleared_s for case in cases]),
        kind=np.full(len(cases), DISTURBANCE, dtype=np.int8),
        signal=np.full(len(cases), ACTIVE, dtype=np.int8),
    ).in_study(own)
    told = telling(own, subject.spec, subject.ready, lanes, ToldGrids.of(said))
    results = run_told(own, told, lanes, demands[0], strict=True)
    watched_s = [study.simulation.duration - own.converter.T_s for study in studies] - lanes.cleared_s
    return [_verdict(results, k, watched_s[k], demand) for k, demand in enumerate(demands)]


def _verdict(results: LaneResults, k: int, watched_s: float, demand: SurvivalDemand) -> Survival | None:
    status = SURVIVED if results.status[k] == JUDGED else STATUSES[results.status[k]]
    if status not in FIGURES:
        return None
    names = "recovery_s", "peak_pu", "first_peak_pu", "limited_s", "limited_at_end", "swing_rad"
    figures: dict[str, Any] = {name: float(getattr(results, name)[k]) for name in names}
    recovery_s = figures.pop("recovery_s")
    found = Survival(status=status, recovery_s=None if math.isinf(recovery_s) else recovery_s, **figures)
    return replace(found, reason=why_lost(found, watched_s, demand))
