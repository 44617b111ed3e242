"""Grids that are not a series R and L, with the field estimator on them: texts of studies, runs and figures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from evidence._field_converters import CONVERTERS, STUDIES
from evidence._field_runs import answers_of_log
from evidence.field_scenario import ToldTheTruth
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.metrics import cycle_mean
from vsgdesign.metrics.answers import inside_ellipse
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.units import plant_timeline, simulate_plant
from vsgdesign.simulation.units.run import PlantRun
from vsgdesign.study.parameters import load_study, study_from_text
from vsgdesign.study.parameters.background import draw_background
from vsgdesign.study.parameters.sensors import draw_sensors
from vsgdesign.study.parameters.study import Study

FROM_S, DURATION_S, STEP_S, STRIDE = 2.0, 8.0, 5.0, 10
"""From when on a run counts, how long it lasts, when something is stepped, and every which cycle at rest counts."""

SAID_AFTER_S = 0.5
"""From how long after a step on the answers count."""

STEP_PU, BAND = 0.1, 0.05
"""Step of P beside inverters, and the share of it within which P must stay."""

X_T = 0.02
"""Transformer and feeder of the unit, pu, which its estimator knows."""

CABLE = {"r": 0.16, "l": 0.40e-3, "c": 0.25e-6, "V": 20e3, "S": 1e6}
"""Ω, H and F of a kilometre of a 20 kV cable, to which a plant of 1 MVA is connected by a transformer of 6 %."""

STUDY = """
base = "{base}"
grid = {{ scr_basis = "impedance", scr = {scr}, x_over_r = {x_over_r} }}
simulation = {{ duration = {duration}, P_ref = {P:g}, Q_ref = 0, log_interval = "1 ms" }}
controllers = [{{ name = "field", kind = "scheduled", structure = "angle_damped", estimate = "field" }}]
{events}
{network}
"""

UNIT = """
[[network.units]]
name = "unit"
node = "{node}"
reactance = {x_t}
"""


@dataclass(frozen=True)
class OtherGrid:
    """What a unit stands on: ``kind`` and ``size`` say what is beside it."""

    converter: str
    kind: str
    """plain, resonance (Hz), cable (km), load, load step (pu of power), inverter (of the rating)."""
    size: float
    scr: float
    x_over_r: float
    seed: int
    pll_hz: float = 0.0
    drives: bool = False
    """Whether the estimate drives the schedule; else this is told the truth."""


def study_of(grid: OtherGrid) -> Study:
    """The study of a run."""
    base = STUDIES / f"{CONVERTERS[grid.converter]}.toml"
    c = load_study(base).converter
    f_n = c.omega_n / (2.0 * math.pi)
    node, extra = "pcc", ""
    if grid.kind == "resonance":
        X = math.sin(math.atan(grid.x_over_r)) / grid.scr
        extra = f'[[network.shunts]]\nname = "c"\nnode = "pcc"\nX_C_pu = {X * (grid.size / f_n) ** 2:.9g}\n'
    elif grid.kind == "cable":
        node, Z = "bus", CABLE["V"] ** 2 / CABLE["S"]
        km = grid.size / 4
        cells = {
            "R_pu": CABLE["r"] * km / Z,
            "X_pu": c.omega_n * CABLE["l"] * km / Z,
            "B_pu": c.omega_n * CABLE["c"] * km * Z,
        }
        ends = ["bus", "m0", "m1", "m2", "m3", "pcc"]
        extra = "".join(f'[[network.nodes]]\nname = "{one}"\n' for one in ends[:-1])
        extra += '[[network.branches]]\nname = "transformer"\nfrom = "bus"\nto = "m0"\nR_pu = 0.01\nX_pu = 0.06\n'
        for k in range(1, 5):
            values = "".join(f"{name} = {value:.9g}\n" for name, value in cells.items())
            extra += f'[[network.branches]]\nname = "cable{k}"\nfrom = "{ends[k]}"\nto = "{ends[k + 1]}"\n{values}'
    elif grid.kind.startswith("load"):
        extra = f'[[network.loads]]\nname = "load"\nnode = "pcc"\nP_pu = {grid.size}\n'
        if grid.kind == "load step":
            extra += f'breaker = "open"\n[[events]]\ntime = {STEP_S}\nelement = "load"\nbreaker = "closed"\n'
    elif grid.kind == "inverter":
        S = grid.size * c.S_rated
        extra = (
            f'[[network.inverters]]\nname = "pv"\nnode = "pcc"\nS_rated = {S:g}\nP_ref = {0.7 * S:g}\n'
            f"reactance = 0.06\npll_bandwidth = {grid.pll_hz}\n"
            f'[[events]]\ntime = {STEP_S}\nelement = "unit"\nP_ref = {0.5 * c.S_rated:g}\n'
        )
    text = STUDY.format(
        base=base, scr=grid.scr, x_over_r=grid.x_over_r, duration=DURATION_S, P=0.4 * c.S_rated,
        events="" if "[[events]]" in extra else "events = []",
        network='[[network.nodes]]\nname = "pcc"\n' + UNIT.format(node=node, x_t=X_T) + extra,
    )  # fmt: skip
    study = study_from_text(text)
    ranges = {"harmonic_5": (0.01, 0.03), "harmonic_7": (0.01, 0.03), "negative_sequence": (0.0, 0.01)}
    return replace(
        study,
        background=draw_background(ranges, grid.seed, "clean"),
        sensors=draw_sensors({"noise": (0.002, 0.002)}, grid.seed, "ideal", bits=12),
    )


def run_other_grid(grid: OtherGrid) -> dict[str, Any]:
    """A run, and what its answers were worth at rest or from half a second after the step on."""
    study = study_of(grid)
    spec = study.controllers[0]
    named = {name: getattr(grid, name) for name in grid.__dataclass_fields__}
    try:
        timeline = plant_timeline(study, spec)
        feed = (FieldScheduler if grid.drives else ToldTheTruth)(timeline.units[0], spec)
        run = simulate_plant(study, [feed], timeline=timeline)
    except InfeasibleStudyError as error:
        return named | {"left_out": " ".join(str(error).split())}
    if run.divergence is not None:
        return named | {"left_out": run.divergence.reason}
    log = feed.log(timeline.timelines[0])
    answers = answers_of_log(log, study)
    stepped = grid.kind == "load step"
    begin = STEP_S + SAID_AFTER_S if stepped else FROM_S
    rows = (answers.t_s > begin) & (np.arange(len(answers.t_s)) % STRIDE == 0)
    if grid.kind == "inverter":
        rows &= answers.t_s < STEP_S
    size = np.abs(answers.Z)
    sigma = np.sqrt(np.trace(answers.covariance, axis1=1, axis2=2)) / size
    # The voltage is measured at the filter's capacitor: what lies between is known, and a part of what is measured.
    path = study.filter
    own = complex(path.R_2, study.converter.omega_n * path.L_2) + 1j * X_T * study.converter.Z_base
    columns = [answers.error, sigma, answers.valid, inside_ellipse(answers), size / np.abs(answers.Z + own)]
    cycles = log.cycles
    if cycles is None:
        raise ValueError("these answers are not the field estimator's.")
    late = answers.t_s > begin
    found = {
        "rows": np.round(np.stack(columns, axis=1)[rows], 5).tolist(),
        "Z": [float(answers.Z[-1].real), float(answers.Z[-1].imag)],
        "Z_hat": [float(np.nanmedian(x[rows])) for x in (answers.Z_hat.real, answers.Z_hat.imag)],
        "Z_base": study.converter.Z_base,
        "changes": int(cycles.changed[late].sum()),
        "events": int(cycles.event[late].sum()),
        "passive": float(np.mean(cycles.passive[rows])),
        "heard": float(cycles.foreign[late].mean()),
    }
    if grid.kind == "inverter":
        found["settling_s"] = settling(run)
    return named | found


def settling(run: PlantRun) -> float | None:
    """How long after the step the unit's mean power stays within the band about its end, s; None: it does not."""
    unit = run.units[0]
    c = unit.study.converter
    P = cycle_mean(unit.column("P"), round(4.0 * math.pi / c.omega_n / 1e-3)) / c.S_rated
    after = run.t_s > STEP_S + 0.04
    end = P[run.t_s > DURATION_S - 0.3].mean()
    outside = np.flatnonzero(after & (np.abs(P - end) > BAND * STEP_PU))
    if not len(outside):
        return 0.0
    last = float(run.t_s[outside[-1]]) - STEP_S
    return last if last < DURATION_S - STEP_S - 0.3 else None
