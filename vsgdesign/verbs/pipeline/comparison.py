"""Comparison of every controller of a study with the best fixed tunings, which scheduling must outperform."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.definitions import damping_of
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.study.parameters.dc_link import without_voltage_droop
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.study_tables import study_tables

if TYPE_CHECKING:  # the optimizer's libraries are loaded by who compares
    from vsgdesign.design.comparison import Compared, Comparison, Contender, EmtStep, GridFigures

VERB = "vsgdesign compare"

EMT_SCR, EMT_X_OVER_R = 3, 4
"""Number of EMT grids on each axis, evenly spaced in the logarithm from end to end."""

EMT_SHARE = 0.5
"""EMT steps begin at this share of the design point, so that they are small steps around the usual operation."""

LOST = 5.0
"""A response beyond this multiple of its step has lost synchronism, wherever it settles afterwards."""

SETTLINGS = 4.0
"""Duration of a step in EMT, in settling times."""


def report_comparison(
    study: Study,
    out: str | Path,
    *,
    emt: bool = True,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress | None = None,
    done: Callable[[Comparison], None] | None = None,
) -> dict[str, Any]:
    """Compares and writes results.json, comparison.csv, figures and report.html to ``out``; returns results.json.

    Gain tables that the study asks for without naming a file are built first. ``done`` is given the comparison. The
    folder appears when everything is done. Raises the errors of :func:`compare_study` and ArtifactError.
    """
    from vsgdesign.report.comparison.page import comparison_figures, comparison_page
    from vsgdesign.report.drawing.figures import write_all
    from vsgdesign.report.page.html import print_html

    tell = progress or silent
    with staged_folder(out, VERB, inputs=study.input_files) as folder:
        # Nothing here asks for the tables' certificates, and a refused one takes longest.
        ready = study_tables(study, out, workers=workers, certificates=False, progress=progress).ready
        comparison = compare_study(study, ready, emt=emt, seed=seed, progress=progress)
        tell("draw figures", 0.0)
        figures = write_all(comparison_figures(comparison), folder / "figures")
        tell("draw figures", 1.0)
        print_html(comparison_page(comparison, figures), folder / "report.html")
        if done is not None:
            done(comparison)
        write_table(folder / "comparison.csv", CSV_HEADER, csv_rows(comparison))
        return write_record(folder, comparison_document(comparison), VERB)


def compare_study(
    study: Study, ready: Ready = NOTHING, *, emt: bool = True, seed: int = 0, progress: Progress | None = None
) -> Comparison:
    """Compares a study's controllers with the best fixed tuning of each of their structures, under its specification.

    The coupled model is evaluated at the nodes of the specification and between them, and averaged EMT simulates steps
    on a few grids. ``ready`` holds the gain tables that the controllers ask for
    (:func:`vsgdesign.verbs.pipeline.study_tables.study_tables`). Raises InfeasibleStudyError if there is no
    specification with the aim ``settling`` or if a table is missing.
    """
    from vsgdesign.design.comparison import (
        BEST_FIXED,
        Compared,
        Comparison,
        Contender,
        compare_on_grids,
        comparison_axes,
        contender_of,
    )
    from vsgdesign.design.single import best_fixed
    from vsgdesign.execution.executors import one_thread

    without_voltage_droop(study, "the comparison with fixed gains")
    tell = progress or silent
    spec = study.specification
    if spec is None or not spec.settles:
        raise InfeasibleStudyError(
            'a comparison needs a [specification] with aim = "settling": it gives the requirements and '
            "their box. Add one."
        )
    axes = comparison_axes(spec)
    grids = list(itertools.product(*axes))
    nodes = list(itertools.product(spec.scr, spec.x_over_r))
    with one_thread():
        contenders: list[tuple[Contender, Any]] = []
        for controller in study.controllers:
            structure = controller.target.structure
            if structure in {other.structure for other, _ in contenders}:
                continue
            found = best_fixed(study, controller.target, nodes, seed=seed, progress=progress)
            like = contender_of(study, controller, ready)
            contenders.append((Contender(f"best_{structure}", structure, BEST_FIXED, like.droop, found.gains), found))
        contenders += [(contender_of(study, controller, ready), None) for controller in study.controllers]
        contenders = _by_structure(contenders)
        compared: list[Compared] = []
        for k, (contender, tuning) in enumerate(contenders):
            tell("compare", k / len(contenders))
            linear = compare_on_grids(study, spec, contender, grids)
            steps = emt_steps(study, spec, contender) if emt else ()
            compared.append(Compared(contender, linear, steps, tuning))
        tell("compare", 1.0)
    seen = {(grid.scr, grid.x_over_r) for grid in compared[0].grids}
    outside = tuple(grid for grid in grids if grid not in seen)
    return Comparison(
        study=study,
        specification=spec,
        scr=axes[0],
        x_over_r=axes[1],
        contenders=tuple(compared),
        outside=outside,
        seed=seed,
    )


def _by_structure(contenders: Sequence[tuple[Contender, Any]]) -> list[tuple[Contender, Any]]:
    """Structures in order of appearance, in each the best fixed tuning first."""
    order = list(dict.fromkeys(contender.structure for contender, _ in contenders))
    return sorted(contenders, key=lambda pair: order.index(pair[0].structure))


def emt_grids(spec: Specification) -> list[tuple[float, float]]:
    """Grids of the EMT steps, (SCR, X/R)."""
    scr, ratio = (
        [float(f"{value:.3g}") for value in np.geomspace(axis[0], axis[-1], count)]
        for axis, count in ((spec.scr, EMT_SCR), (spec.x_over_r, EMT_X_OVER_R))
    )
    return list(itertools.product(scr, ratio))


def emt_steps(study: Study, spec: Specification, contender: Contender) -> tuple[EmtStep, ...]:
    """A step of each reference on every grid of :func:`emt_grids` that carries power, known exactly."""
    from vsgdesign.design.comparison import EmtStep, gains_at, nominal_powers
    from vsgdesign.simulation.steps import STEP_PU, emt_step

    steps = []
    for scr, x_over_r in emt_grids(spec):
        powers = nominal_powers(study, spec, scr, x_over_r)
        if powers is None:
            continue
        P, Q = EMT_SHARE * powers[0], EMT_SHARE * powers[1]
        gains = gains_at(study, spec, contender, scr, x_over_r, P, Q)
        grid = Place(scr, x_over_r, spec.scr_basis).grid(study.converter)
        for signal in "PQ":
            response = None
            if gains is not None:
                response = emt_step(study, grid, gains, P, Q, signal, duration=SETTLINGS * spec.settling_time)
            if response is not None and (response.peak_deviation or 0.0) > LOST * STEP_PU * study.converter.S_rated:
                response = None
            steps.append(EmtStep(scr, x_over_r, signal, response))
    return tuple(steps)


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """results.json of a comparison."""
    from vsgdesign.design.comparison import summary_of

    study, spec = comparison.study, comparison.specification
    return {
        "schema": 1,
        "study": study.identity,
        "provenance": provenance(),
        "seed": comparison.seed,
        "specification": asdict(spec),
        "scr": comparison.scr,
        "x_over_r": comparison.x_over_r,
        "outside": comparison.outside,
        "contenders": [_summary(summary_of(compared)) | _details(compared) for compared in comparison.contenders],
    }


def _summary(found: dict[str, Any]) -> dict[str, Any]:
    return found | {side: named(found[side], "reduced") for side in ("worst_exact", "worst_wrong")}


def named(figures: dict[str, Any] | None, model: str) -> dict[str, Any] | None:
    """Figures by the names of docs/definitions.md. ``model``: ``reduced`` or ``full_order``."""
    names = {"disk_margin": "disk_margin_output", "damping_ratio": damping_of(model)}
    return None if figures is None else {names.get(name, name): value for name, value in figures.items()}


def _grid(grid: GridFigures) -> dict[str, Any]:
    sides = {"exact": "reduced", "wrong": "reduced", "real_exact": "full_order", "real_wrong": "full_order"}
    whole: dict[str, Any] = asdict(grid) | {"state": grid.state, "ideal_state": grid.ideal_state}
    return whole | {side: named(whole[side], model) for side, model in sides.items()}


def _details(compared: Compared) -> dict[str, Any]:
    tuning = compared.tuning
    return {
        "tuning": None if tuning is None else asdict(tuning) | {"gains": tuning.gains.named()},
        "grids": [_grid(grid) for grid in compared.grids],
        "emt_steps": [asdict(step) for step in compared.emt],
    }


_FIGURES = {
    "overshoot": "overshoot",
    "settling_time": "settling_time",
    "cross_peak": "cross_peak",
    "disk_margin": "disk_margin_output",
    "damping_ratio": "damping_power_loops",
}
"""Figures of the coupled model, with their names in the CSV file."""

CSV_HEADER = (
    "contender",
    "structure",
    "origin",
    "scr",
    "x_over_r",
    "state",
    *(f"{name} {side}" for side in ("exact", "wrong") for name in _FIGURES.values()),
    "missed exact",
    "missed wrong",
    "droop [W/Hz]",
    "H [s]",
    "state with ideal inner loops",
)


def csv_rows(comparison: Comparison) -> Iterator[list[object]]:
    """One row a contender and grid."""
    from vsgdesign.design.comparison import per_hz

    for compared in comparison.contenders:
        c = compared.contender
        for grid in compared.grids:
            row: list[object] = [c.name, c.structure, c.origin, grid.scr, grid.x_over_r, grid.state]
            for figures in (grid.exact, grid.wrong):
                row += [None if figures is None else getattr(figures, name) for name in _FIGURES]
            exact, wrong = grid.missed_exact | grid.lost_exact, grid.missed_wrong | grid.lost_wrong
            missed = [" ".join(names) for names in (exact, wrong)]
            yield [*row, *missed, per_hz(grid.D_p), grid.inertia, grid.ideal_state]
