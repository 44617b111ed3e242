"""The twins of the steps of a plant: the same run without a step, with which noise is told from motion (:eq:`twin`).

A twin has the same source, the same noise of the sensors, the same gains, the same probes and the same grids for the
limiters. It is simulated from the start, with what the estimators of the units did in the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.twin import steps_with_twin
from vsgdesign.simulation.units.run import PlantRun, simulate_plant
from vsgdesign.simulation.units.timeline import plant_timeline
from vsgdesign.simulation.units.windows import Schedule, Tape
from vsgdesign.study.parameters.study import ControllerSpec, Study


def twins_of(
    study: Study, spec: ControllerSpec, run: PlantRun, schedules: Sequence[Schedule], tape: Tape, interval: float
) -> dict[float, PlantRun]:
    """The run without each step that has a twin (:func:`vsgdesign.simulation.twin.steps_with_twin`), up to the next
    event, by the time of the step, s. ``tape``: what the estimators did in ``run``, whose rows are ``interval`` apart,
    s."""
    found: dict[float, PlantRun] = {}
    if run.divergence is not None:
        return found
    known = [
        one if isinstance(one, FieldScheduler) else unit.gain_changes
        for one, unit in zip(schedules, run.units, strict=True)
    ]
    for t_s in steps_with_twin(study, spec):
        end_s = min((event.t_s for event in study.events if event.t_s > t_s), default=study.simulation.duration)
        held = replace(
            study,
            events=tuple(event for event in study.events if event.t_s < t_s),
            simulation=replace(study.simulation, duration=end_s),
        )
        again = plant_timeline(held, spec)
        twin = simulate_plant(held, known, timeline=again, log_interval=interval, tape=tape.played())
        if twin.divergence is None:
            found[t_s] = twin
    return found
