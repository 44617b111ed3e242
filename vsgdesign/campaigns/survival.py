"""Many disturbances on many cores, with the same verdicts whatever the number of workers.

Each run of a converter or of a plant that can is a lane of one loop, and the verdicts are those of
:mod:`vsgdesign.simulation.survival.running`. Of a plant of equal units every unit is judged as a converter that stands
alone, and the plant by its worst unit.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.artifacts.files import package_hash
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.execution.executors import Progress, executor_of, worker_count
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import begins_again, journal_at, run_job
from vsgdesign.linear.operating_point.many import DC_ENERGY
from vsgdesign.metrics.survival import (
    DIVERGED,
    FIRST_S,
    LATCHED,
    NO_REST,
    NOT_AT_REST,
    SLIPPED,
    SURVIVED,
    ExpectedRest,
    Survival,
    SurvivalDemand,
    judge_survival,
    why_lost,
)
from vsgdesign.runtime.of_study import follows_measured
from vsgdesign.simulation.dc_beyond import said_of_energy
from vsgdesign.simulation.feeds import LateSchedule, ToldGrids
from vsgdesign.simulation.gains import gain_changes
from vsgdesign.simulation.lanes.cases import ACTIVE, DISTURBANCE, LaneCases, LaneEvents
from vsgdesign.simulation.lanes.results import JUDGED, STATUSES, LaneResults
from vsgdesign.simulation.lanes.run import run_told
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.lanes.units import Plants, run_plants
from vsgdesign.simulation.survival.cases import SurvivalCase
from vsgdesign.simulation.survival.running import CaseResult, Subject, record_of, rest_of, run_case, with_protection
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.simulation.units.run import simulate_plant
from vsgdesign.simulation.units.timeline import PlantTimeline, plant_timeline
from vsgdesign.simulation.units.unit_result import as_simulation
from vsgdesign.simulation.units.windows import Schedule
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

CHUNK, CHUNK_OF_LANES = 20, 400
"""Cases that a worker takes at a time, a second or two of work: run one after the other, and side by side."""


def run_many(
    subjects: Mapping[str, Subject],
    cases: Sequence[SurvivalCase],
    kept: str | Path | None = None,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, tuple[CaseResult, ...]]:
    """Every subject through every case: results by subject, in the order of the cases.

    ``kept`` is a file to which finished runs are added at once, and from which the same call continues after an
    interruption. A run is found again only if the package's source, the subject and the case are the same to the
    letter; ``say`` takes a sentence where none is. ``workers`` and ``cluster`` are those of
    :func:`vsgdesign.execution.executors.executor_of`. Raises ArtifactError if another process uses the file,
    WorkerError if a process is lost.
    """
    stamps = {name: _stamp(subject) for name, subject in subjects.items()}
    keys = {name: tuple(_key(stamp, case) for case in cases) for name, stamp in stamps.items()}
    job = SurvivalJob(subjects=dict(subjects), cases=tuple(cases), keys=keys)
    with journal_at(job, kept) as journal:
        left = job.left(journal.whole)
        if say is not None and journal.whole and left == job.blocks:
            say(begins_again(kept or ""))
        with executor_of(min(worker_count(workers), max(len(left), 1)), cluster) as executor:
            found = run_job(job, journal, executor=executor, progress=progress)
    return {
        name: tuple(_result(case, found[key]) for case, key in zip(cases, keys[name], strict=True)) for name in subjects
    }


@dataclass(frozen=True, kw_only=True)
class SurvivalJob(Job[tuple[str, tuple[int, ...]], dict[str, Any]]):
    """Subjects through cases. A block is a subject with the numbers of some cases; a finished run has a key."""

    subjects: dict[str, Subject]
    cases: tuple[SurvivalCase, ...]
    keys: dict[str, tuple[str, ...]]
    """Of each subject's run of each case: hashes of everything that it depends on."""

    what = "disturbances"

    @property
    def key(self) -> str:
        """Hash of the keys of all runs."""
        return hashlib.sha256(repr(self.keys).encode()).hexdigest()

    @property
    def blocks(self) -> list[tuple[str, tuple[int, ...]]]:
        """All runs in blocks."""
        return self.left({})

    def left(self, whole: dict[str, Any]) -> list[tuple[str, tuple[int, ...]]]:
        """The runs that are not finished yet, in new blocks."""
        found = []
        for name, keys in self.keys.items():
            missing = tuple(k for k, key in enumerate(keys) if key not in whole)
            chunk = CHUNK_OF_LANES if share_a_loop(self.subjects[name]) else CHUNK
            found += [(name, missing[i : i + chunk]) for i in range(0, len(missing), chunk)]
        return found

    def size(self, block: tuple[str, tuple[int, ...]]) -> int:
        """The runs of a block."""
        return len(block[1])

    def run(self, block: tuple[str, tuple[int, ...]]) -> dict[str, Any]:
        """Verdict and seconds of each run of a block, by its key."""
        return self.call(block)()

    def call(self, block: tuple[str, tuple[int, ...]]) -> Callable[[], dict[str, Any]]:
        """The run of a block as it goes to another process: with its subject and its cases alone."""
        name, numbers = block
        return partial(_run_cases, self.subjects[name], {self.keys[name][k]: self.cases[k] for k in numbers})

    def part_of(self, document: Any) -> dict[str, Any]:
        """Finished runs by key. Raises ValueError, KeyError or TypeError where a document is none."""
        return {str(key): {"verdict": dict(one["verdict"]), "seconds": one["seconds"]} for key, one in document.items()}


def _run_cases(subject: Subject, cases: Mapping[str, SurvivalCase]) -> dict[str, Any]:
    begin = time.perf_counter()
    verdicts = verdicts_of(subject, list(cases.values()))
    seconds = (time.perf_counter() - begin) / max(len(cases), 1)
    return {key: {"verdict": asdict(one), "seconds": seconds} for key, one in zip(cases, verdicts, strict=True)}


def _result(case: SurvivalCase, document: Mapping[str, Any]) -> CaseResult:
    return CaseResult(case=case, verdict=Survival(**document["verdict"]), seconds=float(document["seconds"]))


def _key(stamp: str, case: SurvivalCase) -> str:
    return hashlib.sha256(f"{stamp} {case!r}".encode()).hexdigest()[:32]


def _stamp(subject: Subject) -> str:
    """Everything that a verdict depends on besides the case."""
    parts = (package_hash(), subject.study.content, subject.spec, dict(subject.ready.tables))
    parts += (subject.limit_pu, subject.bridge, subject.room_pu)
    return hashlib.sha256(repr(parts).encode()).hexdigest()


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


Told = tuple[tuple[float, Grid | None], ...]


def plant_verdict(subject: Subject, case: SurvivalCase) -> Survival:
    """The verdict on a plant in a case: of the units that are on line at its end the worst one's, whose name is in the
    reason, with the largest figures of all. Grids of the case are those that a unit sees with all units on line."""
    demand = subject.demand(case)
    study = study_of_plant_case(subject, case, demand.needed_s + 2.0 * demand.cycle_s)
    timeline = plant_timeline(study, subject.spec)
    names = [unit.name for unit in timeline.plant.units]
    lost = timeline.segments[-1].topology.opened
    on_line = [k for k, name in enumerate(names) if name not in lost]
    try:
        said = [case.told(own, known) for own, known in zip(timeline.units, timeline.timelines, strict=True)]
        rests: dict[int, ExpectedRest] = {}
        for k in on_line:
            for t_s, where in ((0.0, "before the event"), (study.simulation.duration, "after the event")):
                unit = replace(subject, study=timeline.units[k])
                rests[k] = rest_of(unit, timeline.units[k], timeline.timelines[k], t_s, said[k])
                refused = subject.refused(rests[k])
                if refused is not None:
                    return Survival(status=refused[0], reason=f"{names[k]}, {where}: {refused[1]}")
        run = simulate_plant(study, _schedules(subject, timeline, said), timeline=timeline)
    except SimulationDivergedError as error:
        return Survival(status=DIVERGED, reason=str(error))
    except InfeasibleStudyError as error:
        return Survival(status=NO_REST, reason=f"before the event: {error}")
    verdicts = {}
    for k in on_line:
        simulation = as_simulation(run, run.units[k], k)
        record, cleared_s = record_of(run.units[k].study, simulation), case.lead_s + case.cleared_s
        verdict = judge_survival(record, case.instants_s, cleared_s, rests[k], demand)
        verdicts[k] = with_protection(verdict, run.units[k].study, simulation, case.instants_s[0])
    return worst_of_units({names[k]: one for k, one in verdicts.items()})


def study_of_plant_case(subject: Subject, case: SurvivalCase, after_s: float) -> Study:
    """The study that is simulated for a case of a plant. A grid of the case is what one unit sees with all N units on
    line, N Z_g, so the plant's is an N-th of it."""
    study = case.study(subject.study, after_s)
    plant = study.plant
    if plant is None:
        raise ValueError("the study has no plant")
    count = len(plant.units)
    asked = {"P_ref": study.simulation.P_ref, "Q_ref": study.simulation.Q_ref}
    return replace(
        study,
        plant=replace(plant, units=tuple(replace(one, **asked) for one in plant.units)),
        grid=_shared(study.grid, count),
        events=tuple(one if one.grid is None else replace(one, grid=_shared(one.grid, count)) for one in study.events),
    )


def _shared(grid: Grid, count: int) -> Grid:
    return Grid(grid.R_g / count, grid.L_g / count)


def _schedules(subject: Subject, timeline: PlantTimeline, said: list[Told]) -> list[Schedule]:
    """What each unit's gains are: told late and wrong, as the case says, or fixed."""
    found: list[Schedule] = []
    for own, known, told in zip(timeline.units, timeline.timelines, said, strict=True):
        if subject.spec.kind == "scheduled":
            safe = replace(subject, study=own).safe
            found.append(LateSchedule(own, subject.spec, told, subject.ready, safe=safe))
        else:
            found.append(gain_changes(own, subject.spec, known))
    return found


def worst_of_units(verdicts: dict[str, Survival]) -> Survival:
    """One verdict of those of the units."""
    lost = [(name, one) for name, one in verdicts.items() if not one.survived]
    name, worst = lost[0] if lost else max(verdicts.items(), key=lambda item: item[1].recovery_s or 0.0)
    largest = {
        figure: max(
            (getattr(one, figure) for one in verdicts.values() if getattr(one, figure) is not None), default=None
        )
        for figure in ("peak_pu", "first_peak_pu", "limited_s", "limited_at_end", "swing_rad")
    }
    reason = worst.reason if worst.status == SURVIVED or worst.reason is None else f"{name}: {worst.reason}"
    return replace(worst, reason=reason, **largest)
