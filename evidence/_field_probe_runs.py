"""What the probe costs the grid at rest, and how near the estimator comes to the Cramér–Rao bound of it."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._field_converters import Converter
from evidence._field_draws import FieldDraw
from evidence._field_runs import converter_of, simulate_field, study_of
from evidence._field_summary import SCR_BINS, quantile
from evidence._tables import table
from vsgdesign.equations.field.measuring import LONGER, LONGER_FROM, SLOW_MEMORY
from vsgdesign.equations.frames import instantaneous_power
from vsgdesign.estimator.bound import sensor_noise, tracked_probe_bound
from vsgdesign.metrics.oscillation import interharmonic_rms, ripple_rms
from vsgdesign.simulation.every_sample import pcc_vectors
from vsgdesign.simulation.run import Simulation
from vsgdesign.study.parameters.background import draw_background
from vsgdesign.study.parameters.sensors import draw_sensors
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LINES = (1.5, 2.5)
"""Orders of the probe's lines in the stationary frame."""

REST_FROM_S, DURATION_S = 15.0, 24.0
"""The estimator has then forgotten what it learned from at the start, with a larger probe."""


def run_probe(draw: FieldDraw) -> dict[str, Any]:
    """A draw at rest in a grid without any background, with and without the probe: the voltage of its lines, the
    power's ripple, and the error's ratio to its bound. Sensors have noise and bits alone: an offset is a ripple of its
    own, and no bound knows of gains."""
    converter, draw = converter_of(draw.converter), replace(draw, duration_s=DURATION_S)
    seed, T_s = draw.surroundings.seed, converter.study.converter.T_s
    study = study_of(converter, draw)
    study = replace(
        study,
        background=draw_background({}, seed, "clean"),
        sensors=draw_sensors(dict.fromkeys(("gain_error", "offset_error"), (0.0, 0.0)), seed, "dirty"),
        simulation=replace(study.simulation, log_interval=T_s),
    )
    found: dict[str, Any] = {"converter": draw.converter, "seed": draw.seed, "scr": draw.start.scr}
    found["x_over_r"] = draw.start.x_over_r
    for name, probe in (("with", True), ("without", False)):
        simulation, answers = simulate_field(converter, study, probe=probe)
        v, i = _at_pcc(study, simulation)
        found[name] = _quality(converter, draw, v, i)
        if probe:
            rows = answers.rows(REST_FROM_S, draw.duration_s) & answers.valid
            found["rms_error"] = math.sqrt(float(np.mean(answers.error[rows] ** 2))) if rows.any() else None
            sigma = np.sqrt(np.trace(answers.covariance[rows], axis1=1, axis2=2)) / np.abs(answers.Z[rows])
            found["bound"] = _bound(converter, draw, study, i, float(np.median(sigma)) if rows.any() else 1.0)
    return found


def _at_pcc(study: Study, simulation: Simulation) -> tuple[ComplexArray, ComplexArray]:
    """Space vectors of voltage and current at the PCC at rest, V and A peak."""
    rows = simulation.log[simulation.t_s >= REST_FROM_S]
    return tuple(pair[:, 0] + 1j * pair[:, 1] for pair in pcc_vectors(rows, study.circuit()))  # type: ignore[return-value]


def _quality(converter: Converter, draw: FieldDraw, v: ComplexArray, i: ComplexArray) -> dict[str, float]:
    c = converter.study.converter
    nominal = c.omega_n / (2.0 * math.pi)
    P, _ = instantaneous_power(v.real, v.imag, i.real, i.imag)
    lines = [interharmonic_rms(v.real, c.T_s, nominal + draw.start.df_hz, order, nominal) for order in (1, 2)]
    return {
        "line_1_pct": 100.0 * lines[0] / c.V_rated_rms,
        "line_2_pct": 100.0 * lines[1] / c.V_rated_rms,
        "ripple_pct": 100.0 * ripple_rms(P) / c.S_rated,
    }


def _bound(converter: Converter, draw: FieldDraw, study: Study, i: ComplexArray, sigma: float) -> float:
    """Least relative error of Z that a tracker of the estimator's memory can have, from the true currents of the lines.
    The memory follows from the standard deviation ``sigma`` that the estimator states (:eq:`field-memory`)."""
    memory = SLOW_MEMORY * min(max((sigma / LONGER_FROM) ** 2, 1.0), LONGER)
    c, sensors = converter.study.converter, study.sensors
    if sensors is None:
        raise ValueError("no sensors: no bound.")
    omega = c.omega_n + 2.0 * math.pi * draw.start.df_hz
    noise = sensor_noise(c, (sensors.noise, sensors.noise), sensors.bits, sensors.range_pu)
    samples = 2.0 * math.pi / omega / c.T_s
    # The known impedance between the capacitor and the PCC is measured with the grid's.
    grid, part = study.grid, study.filter
    R, L = grid.R_g + part.R_2, grid.L_g + part.L_2
    size, whole = (math.hypot(r, c.omega_n * x) for r, x in ((grid.R_g, grid.L_g), (R, L)))
    bound = tracked_probe_bound(
        [_line(i, order * omega, c.T_s, 2.0 * samples) for order in LINES],
        [order * omega for order in LINES],
        c.omega_n,
        noise,
        samples,
        memory,
        R,
        L,
    )
    return bound.Z * whole / size


def _line(i: ComplexArray, omega: float, T_s: float, length: float) -> float:
    """Size of a line whose sign changes now and then, A: the median over pieces of two cycles, in which the fundamental
    and the other line vanish."""
    turned = i * np.exp(-1j * omega * T_s * np.arange(len(i)))
    edges = np.round(np.arange(0.0, len(i), length)).astype(int)
    return float(np.median([abs(np.mean(turned[a:b])) for a, b in itertools.pairwise(edges)]))


def probe_table(found: list[dict[str, Any]]) -> list[str]:
    """Markdown: by converter and range of SCR, the median and the largest of each figure."""
    head = ("converter", "SCR", "runs", "line at 3/2 f, % of V: with (without)", "line at 5/2 f")
    errors = ("ripple of P, % of S: more by", "least rms error of Z, %", "error over it")
    names, rows = dict.fromkeys(row["converter"] for row in found), []
    for name, (low, high) in itertools.product(names, SCR_BINS):
        mine = [row for row in found if row["converter"] == name and low <= row["scr"] < high]
        if not mine:
            continue
        cells = [name, f"{low:g}–{high:g}", f"{len(mine)}"]
        for line in ("line_1_pct", "line_2_pct"):
            on, off = ([row[which][line] for row in mine] for which in ("with", "without"))
            cells.append(f"{quantile(on, 0.5):.3f}, at most {max(on):.3f} ({max(off):.3f})")
        more = [row["with"]["ripple_pct"] - row["without"]["ripple_pct"] for row in mine]
        cells.append(f"{quantile(more, 0.5):.2f}, at most {max(more):.2f}")
        bounds = [100.0 * row["bound"] for row in mine]
        cells.append(f"{quantile(bounds, 0.5):.1f}, at most {max(bounds):.1f}")
        ratios = [row["rms_error"] / row["bound"] for row in mine if row["rms_error"] is not None]
        cells.append(f"{quantile(ratios, 0.5):.2f}" if ratios else "–")
        rows.append(cells)
    return table((*head, *errors), rows)
