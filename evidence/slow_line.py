"""What a slow line of a probe, at 2 to 5 Hz in the converter's frame, could know beside the lines that there are.

The grid itself moves most where it is slow. A run without a probe leaves v − Z i, the grid's own voltage; its spectral
density at a frequency f gives the standard deviation of Z after T with a line that makes the ripple of the power that
the probe may make (a current of 0.48 % rms): sqrt(S(f)/T)/(0.0048 |Z|) for R and X together.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from evidence._field_other_grids import OtherGrid, study_of
from evidence._tables import leave, table
from evidence.field_scenario import ToldTheTruth
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.identification.field import ProbeLimits
from vsgdesign.simulation.units import plant_timeline, simulate_plant
from vsgdesign.study.parameters.background import draw_background

FREQUENCIES_HZ, LEVELS = (2.0, 3.0, 5.0, 24.0, 74.0), ("clean", "dirty", "measured")
CONVERTERS = ("12.5 kVA", "1 MVA")
DURATION_S, FROM_S, FOR_S, WITHIN_HZ = 42.0, 2.0, 2.0, 0.5
"""Length of a run, from when on it counts, how long the line is measured, and the width of a mean of the spectrum."""
PLACE = (5.0, 4.0)
"""SCR and X/R."""


def sigmas(converter: str, level: str) -> list[float]:
    """Standard deviation of Z over |Z| after FOR_S, for a line at each frequency."""
    grid = OtherGrid(converter, "plain", 0.0, *PLACE, seed=1)
    study = study_of(grid)
    simulation = replace(study.simulation, duration=DURATION_S)
    study = replace(study, simulation=simulation, background=draw_background({}, 1, level))
    timeline, spec = plant_timeline(study, study.controllers[0]), study.controllers[0]
    run = simulate_plant(study, [ToldTheTruth(timeline.units[0], spec, probe=False)], timeline=timeline)
    unit, rows = run.units[0], run.t_s > FROM_S
    c, part = unit.study.converter, unit.study.filter
    seen = timeline.timelines[0].true_grid_at(FROM_S)
    V = rms_to_peak(c.V_rated_rms)
    v, i = (
        (unit.column(f"{name}_alpha") + 1j * unit.column(f"{name}_beta"))[rows] / base
        for name, base in (("v_c", V), ("i_g", V / c.Z_base))
    )
    t = run.t_s[rows]
    turns = np.unwrap(np.angle(v))
    omega = (turns[-1] - turns[0]) / (t[-1] - t[0])
    v, i = (x * np.exp(-1j * omega * t) for x in (v, i))
    R, L = (seen.R_g + part.R_2) / c.Z_base, (seen.L_g + part.L_2) / c.Z_base
    own = v - R * i - L * (np.gradient(i, t) + 1j * omega * i)
    window = np.hanning(len(t))
    step = t[1] - t[0]
    density = np.abs(np.fft.fft((own - own.mean()) * window)) ** 2 * step / np.sum(window**2)
    at = np.abs(np.fft.fftfreq(len(t), step))
    size = ProbeLimits().ripple * abs(complex(R, c.omega_n * L))
    return [float(np.sqrt(density[np.abs(at - f) < WITHIN_HZ].mean() / FOR_S) / size) for f in FREQUENCIES_HZ]


def main(folder: Path) -> None:
    rows: list[dict[str, Any]] = [
        {"converter": converter, "level": level, "sigma": sigmas(converter, level)}
        for converter in CONVERTERS
        for level in LEVELS
    ]
    cells = [(one["converter"], one["level"], *(f"{100 * x:.1f} %" for x in one["sigma"])) for one in rows]
    head = ("converter", "background", *(f"{f:g} Hz" for f in FREQUENCIES_HZ))
    leave(folder, "slow_line", rows, table(head, cells))
