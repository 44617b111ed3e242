"""What the EMT of a plant costs: N equal units that sample together, or one after the other."""

from __future__ import annotations

import time
from pathlib import Path

from evidence._tables import leave, table
from vsgdesign.simulation.gains import gain_changes
from vsgdesign.simulation.units import plant_timeline, simulate_plant
from vsgdesign.study.parameters import study_from_text

UNITS, REPEATS, DURATION_S = (1, 4, 9), 4, 20.0

STUDY = """
base = "case:lab_12kva_lcl"
[grid]
scr = 6
x_over_r = 4
[simulation]
duration = {duration}
bridge = "{bridge}"
P_ref = "6 kW"
Q_ref = "0 var"
[[controllers]]
name = "scheduled"
kind = "scheduled"
[plant]
units = {units}
reactance = 0.06
resistance = 0.01
sampling = "{sampling}"
"""


def cost(units: int, sampling: str, bridge: str) -> float:
    """How many times faster than real time a run is: processor time, the best of several runs."""
    study = study_from_text(STUDY.format(duration=DURATION_S, units=units, sampling=sampling, bridge=bridge))
    timeline = plant_timeline(study)
    spec = study.controllers[0]
    schedules = [gain_changes(own, spec, seen) for own, seen in zip(timeline.units, timeline.timelines, strict=True)]
    found = []
    for _ in range(REPEATS):
        begin = time.process_time()
        simulate_plant(study, schedules, timeline=timeline)
        found.append(time.process_time() - begin)
    return DURATION_S / min(found)


def main(folder: Path) -> None:
    """Prints how many times faster than real time a plant of N units runs on one core, its start and its log
    included."""
    rows, kept = [], []
    for units in UNITS:
        ways = [(bridge, sampling) for bridge in ("averaged", "pwm") for sampling in ("together", "spread")]
        times = {f"{bridge}, {sampling}": cost(units, sampling, bridge) for bridge, sampling in ways}
        rows.append((str(units), *(f"{one:.0f} ×" for one in times.values())))
        kept.append({"units": units} | times)
    head = ("units", "all sample together", "spread over the period", "switched bridges, together", "switched, spread")
    leave(folder, "plants", kept, table(head, rows))
