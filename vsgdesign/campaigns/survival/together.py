"""Many disturbances side by side: each run of a converter or of a plant is a lane of one loop, and the verdicts are
those of :mod:`vsgdesign.simulation.survival.running` and of :mod:`vsgdesign.campaigns.survival.plants`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.campaigns.survival.plants import plant_verdict, study_of_plant_case, worst_of_units
from vsgdesign.linear.operating_point.many import DC_ENERGY
from vsgdesign.metrics.survival import (
    FIRST_S,
    LATCHED,
    NO_REST,
    NOT_AT_REST,
    SLIPPED,
    SURVIVED,
    Survival,
    SurvivalDemand,
    why_lost,
)
from vsgdesign.runtime.of_study import follows_measured
from vsgdesign.simulation.dc_beyond import said_of_energy
from vsgdesign.simulation.lanes.cases import ACTIVE, DISTURBANCE, LaneCases, LaneEvents
from vsgdesign.simulation.lanes.results import JUDGED, STATUSES, LaneResults
from vsgdesign.simulation.lanes.run import run_told
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.lanes.told import ToldGrids
from vsgdesign.simulation.lanes.units import Plants, run_plants
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
    of_plant = subject.study.plant is not None
    some = [k for k, case in enumerate(cases) if _may_be_a_lane(subject, case)]
    runs = (_plants_together if of_plant else _together)(subject, [cases[k] for k in some])
    found = dict(zip(some, runs, strict=True))

    def alone(case: SurvivalCase) -> Survival:
        return plant_verdict(subject, case) if of_plant else run_case(subject, case).verdict

    return [found.get(k) or alone(case) for k, case in enumerate(cases)]


def share_a_loop(subject: Subject) -> bool:
    """Whether runs of a subject can share a loop: averaged, in a clean grid, with told or fixed gains."""
    study = subject.study
    alone = subject.in_the_field or subject.learns or study.protection is not None
    return subject.bridge == "averaged" and not alone


def _may_be_a_lane(subject: Subject, case: SurvivalCase) -> bool:
    """Gains at a design point are made for the source of the case, so that it must be that of the study."""
    study, spec = subject.study, subject.spec
    if not share_a_loop(subject) or (study.plant is not None and not _may_be_a_plant(case)):
        return False
    for_any_source = spec.schedule == "table" or spec.gains is not None or follows_measured(spec)
    return for_any_source or case.study(study, 0.0).grid_source == study.grid_source


def _may_be_a_plant(case: SurvivalCase) -> bool:
    """A loop of several plants has no ramps, and what is watched takes 5 ms from one event to the next."""
    apart = np.diff(sorted({change.t_s for change in case.changes}))
    return not any(change.over > 0.0 for change in case.changes) and not (apart < FIRST_S).any()


def _plants_together(subject: Subject, cases: Sequence[SurvivalCase]) -> list[Survival | None]:
    """The verdicts on plants in one loop, of units as in :func:`plant_verdict`; None where a run of its own has to say
    why."""
    if not cases:
        return []
    demands = [subject.demand(case) for case in cases]
    studies = tuple(
        study_of_plant_case(subject, case, demand.needed_s + 2.0 * demand.cycle_s)
        for case, demand in zip(cases, demands, strict=True)
    )
    T_s, none = subject.study.converter.T_s, np.zeros(len(cases))
    lanes = LaneCases(
        R_g=none,
        L_g=none,
        V_g_rms=none,
        omega_g=none,
        P_ref=none,
        Q_ref=none,
        events=LaneEvents.of([() for _ in cases]),
        error_R=none,
        error_X=none,
        silent_s=np.array([case.knowledge.silent_s for case in cases]),
        cleared_s=np.array([case.lead_s + case.cleared_s for case in cases]),
        kind=np.full(len(cases), DISTURBANCE, dtype=np.int8),
        signal=np.full(len(cases), ACTIVE, dtype=np.int8),
    )
    ends = np.array([int(np.floor(study.simulation.duration / T_s + 1e-6)) for study in studies])
    found = run_plants(
        subject.spec,
        subject.ready,
        Plants(studies=studies, cases=lanes, ends=ends),
        demand=demands[0],
        said=lambda c, unit, timeline: cases[c].told(unit, timeline),
    )
    verdicts: list[Survival | None] = []
    for c, (study, demand) in enumerate(zip(studies, demands, strict=True)):
        watched_s = study.simulation.duration - T_s - lanes.cleared_s[c]
        mine = np.flatnonzero((found.case == c) & found.on_line)
        each = [_verdict(found.results, int(f), watched_s, demand) for f in mine]
        names = [study.plant.units[k].name for k in found.unit[mine]] if study.plant is not None else []
        known = {name: one for name, one in zip(names, each, strict=True) if one is not None}
        verdicts.append(worst_of_units(known) if len(known) == len(each) else None)
    return verdicts


def _together(subject: Subject, cases: Sequence[SurvivalCase]) -> list[Survival | None]:
    """The verdicts on runs in one loop; None where a run of its own has to say why."""
    if not cases:
        return []
    own, demands = subject.study.with_limit_of(subject.spec), [subject.demand(case) for case in cases]
    studies = [
        case.study(own, demand.needed_s + 2.0 * demand.cycle_s) for case, demand in zip(cases, demands, strict=True)
    ]
    said = [case.told(study, build_timeline(study)) for case, study in zip(cases, studies, strict=True)]
    silent_s = np.array([case.knowledge.silent_s for case in cases])
    cleared_s = np.array([case.lead_s + case.cleared_s for case in cases])
    lanes = LaneCases.of_studies(studies, silent_s, cleared_s).in_study(own)
    told = telling(own, subject.spec, subject.ready, lanes, ToldGrids.of(said))
    results = run_told(own, told, lanes, demands[0], strict=True)
    watched_s = [study.simulation.duration - own.converter.T_s for study in studies] - lanes.cleared_s
    return [_verdict(results, k, watched_s[k], demand) for k, demand in enumerate(demands)]


def _verdict(results: LaneResults, k: int, watched_s: float, demand: SurvivalDemand) -> Survival | None:
    if results.fault[k] == DC_ENERGY:
        return Survival(status=NO_REST, reason=said_of_energy(float(results.dc_beyond_j[k])))
    status = SURVIVED if results.status[k] == JUDGED else STATUSES[results.status[k]]
    if status not in FIGURES:
        return None
    names = "recovery_s", "peak_pu", "first_peak_pu", "limited_s", "limited_at_end", "swing_rad"
    figures: dict[str, Any] = {name: float(getattr(results, name)[k]) for name in names}
    recovery_s = figures.pop("recovery_s")
    found = Survival(status=status, recovery_s=None if math.isinf(recovery_s) else recovery_s, **figures)
    return replace(found, reason=why_lost(found, watched_s, demand))
