"""Steps of P and Q with gains in closed form, in batches of averaged EMT: how many meet their target.

The draws of ``SEED`` are used nowhere else: neither the damping ratio nor the margins of the rule were chosen by them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vsgdesign as vd
from evidence._field_converters import CONVERTERS, STUDIES
from evidence._tables import leave, table
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, uniforms_of
from vsgdesign.equations.placing import OVERSHOOT_PCT
from vsgdesign.linear.operating_point.many_rests import many_rests_with_measured_gains
from vsgdesign.linear.stability.maps import cell_set, full_order_cells
from vsgdesign.linear.stability.margins import full_order_margins
from vsgdesign.metrics.met import most_overshoot, most_settling_time
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.results import JUDGED
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters.loading import complete, merged_document, study_from_document
from vsgdesign.study.parameters.study import Study, StudyOrigin

SEED = 40417
STEPS = 1500
ERRORS = (0.0, 0.05, 0.1, 0.2)
"""Of the estimate, in any direction, relative to |Z_g|; the study's specification asks for them."""

BOX: dict[str, Any] = {"scr_basis": "impedance", "scr": [1.5, 20.0], "x_over_r": [0.3, 20.0]}
OTHERS = ("grid", "phase", "sag", "ramp", "reference")
"""Disturbances that are not drawn."""

PUBLISHED = "published inner loops"
_LEFT_OUT = ("events", "survival")


def study_of(name: str, error: float, target: dict[str, Any], box: dict[str, Any] = BOX) -> Study:
    """A converter of ``CONVERTERS`` or the published one with its own inner loops, with one closed form that is told
    the grid, and with steps of 5 % to draw."""
    base = "case:hoang2025_5kva" if name == PUBLISHED else str(STUDIES / f"{CONVERTERS[name]}.toml")
    document = {key: value for key, value in merged_document({"base": base}).items() if key not in _LEFT_OUT}
    rated = vd.load(base).converter.S_rated
    powers = {"P": [-0.9 * rated, 0.9 * rated], "Q": [-0.3 * rated, 0.3 * rated]}
    drawn = {"error_R": 0.0, "error_X": 0.0, "error_Z": error, "step": {"weight": 1.0}}
    document |= {
        "controllers": [{"name": "closed_form", "kind": "scheduled", **target}],
        "specification": box | powers | {"error_Z": error},
        "verification": drawn | {one: {"weight": 0.0} for one in OTHERS},
    }
    return study_from_document(complete(document), StudyOrigin(document, ".", name, "closed_form_steps"))


def steps_of(study: Study, count: int, seed: int = SEED) -> tuple[LaneCases, Any, NDArray[np.bool_]]:
    """Random steps, their results, and which of them are judged on a stable system."""
    (spec,) = study.controllers
    cases, _ = cases_of(study, spec, uniforms_of(seed, 0, count))
    found = run_lanes(study, spec, NOTHING, cases, bridge="averaged")
    return cases, found, (found.status >= JUDGED) & stable(study, cases)


def stable(study: Study, cases: LaneCases) -> NDArray[np.bool_]:
    """Whether the full-order model is stable at the rest at which a case begins."""
    law, R_g, L_g = gain_law(study, study.controllers[0]), cases.R_g, cases.L_g
    told = R_g * (1.0 + cases.error_R), L_g * (1.0 + cases.error_X)
    rests, gains = many_rests_with_measured_gains(study, cases.at_start, lambda P, Q, V: law(*told, P, Q, V))
    D_q, V = gains.D_q, rests.controller.V
    cells = cell_set(study, R_g, L_g, cases.P_ref, cases.Q_ref + D_q * (study.converter.V_rated_rms - V), gains)
    model = full_order_cells(study, cells)
    found = np.zeros(len(R_g), dtype=bool)
    found[np.flatnonzero(cells.good)[model.index]] = full_order_margins(model).stable
    return found


def met(study: Study, results: Any) -> NDArray[np.bool_]:
    """Whether the settling time and the overshoot of the closed form are met, by the rule of the page of a run."""
    T = study.controllers[0].target.settling_time
    within = results.settling_s <= most_settling_time(T)
    return within & (results.overshoot <= most_overshoot(OVERSHOOT_PCT / 100.0))


def main(folder: Path) -> None:
    """Prints the share of steps that meet their target, by converter and error of the estimate."""
    rows, kept = [], []
    for name in (*CONVERTERS, PUBLISHED):
        for error in ERRORS:
            study = study_of(name, error, {"structure": "angle_damped"})
            _, found, good = steps_of(study, STEPS)
            judged = found.status >= JUDGED
            share = float(np.mean(met(study, found)[good]))
            settled, over = found.settling_s[good], 100.0 * found.overshoot[good]
            T_95, T_99 = np.percentile(np.where(np.isfinite(settled), settled, 99.0), [95.0, 99.0])
            over_99 = float(np.percentile(over, 99.0))
            rows.append(
                (
                    name,
                    f"{100.0 * error:g} %",
                    f"{study.controllers[0].target.placing_time:.3f}",
                    f"{int(good.sum())}",
                    f"{int((judged & ~good).sum())}",
                    f"{share:.3f}",
                    f"{T_95:.3f} / {T_99:.3f}",
                    f"{over_99:.2f}",
                )
            )
            kept.append({"converter": name, "error": error, "met": share, "T_99_s": T_99, "overshoot_99_pct": over_99})
    head = ("converter", "error", "T_d, s", "steps", "unstable", "met", "settled, 95 / 99 %, s", "overshoot, 99 %, %")
    leave(folder, "closed_form_steps", kept, table(head, rows))
