"""Disturbances of a plant of equal units: every unit is judged as a converter that stands alone, and the plant by its
worst unit."""

from __future__ import annotations

from dataclasses import replace

from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.metrics.survival import DIVERGED, NO_REST, SURVIVED, ExpectedRest, Survival, judge_survival
from vsgdesign.simulation.feeds import LateSchedule
from vsgdesign.simulation.gains import gain_changes
from vsgdesign.simulation.survival.cases import SurvivalCase
from vsgdesign.simulation.survival.running import Subject, record_of, rest_of, with_protection
from vsgdesign.simulation.units.run import simulate_plant
from vsgdesign.simulation.units.timeline import PlantTimeline, plant_timeline
from vsgdesign.simulation.units.unit_result import as_simulation
from vsgdesign.simulation.units.windows import Schedule
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

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
