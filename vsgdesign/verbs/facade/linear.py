"""The linear model of a study's controller on a grid, as a system of python-control."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.given import given_study, known_word

if TYPE_CHECKING:
    import control

_MODELS = ("reduced", "full")


def linear_model(
    study: Study | str | Path,
    controller: str | None = None,
    *,
    grid: Grid | Mapping[str, Any] | None = None,
    model: Literal["reduced", "full"] = "reduced",
    part: Literal["closed", "loop", "plant", "controller"] = "closed",
    P: float | str | None = None,
    Q: float | str | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> control.StateSpace:
    """The linear model of a controller (the last one, if none is named) at rest on a grid, for python-control.

    ``model="reduced"`` is continuous, with ideal inner loops; ``"full"`` is discrete, one step in a sampling period,
    with filter, inner loops and delay. ``part``: the closed loop; the loop broken at the measured powers, for negative
    feedback (``control.disk_margins``, ``control.nyquist_plot``); the plant from the commanded angle and voltage to the
    powers; or the power loops from the powers to angle and voltage, with their sign, so that loop = −plant·controller.
    Quantities are in SI, voltages are phase rms, and states, inputs and outputs have names.

    ``grid`` is ``vd.grid(...)`` or a Grid; None is that of the study. A controller with fixed gains keeps those of the
    study, a scheduled one has those for the grid. ``P`` and ``Q`` are the powers at rest in W and var, or texts with a
    unit; None stands for P_ref and Q_ref of the study. A gain table that no file and no earlier command has is designed
    once and kept below ``out``. Raises StudyError for a name or a grid that cannot be,
    and InfeasibleStudyError where there is no rest, there are no gains, or the study is of a plant that is more than
    equal units.
    """
    from vsgdesign.export.unit import controller_named
    from vsgdesign.linear.stability.cells import cells_under, full_order_cells, reduced_cells
    from vsgdesign.linear.stability.systems import PARTS, system_of
    from vsgdesign.runtime.of_study import gain_law
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.study_tables import kept_tables

    known_word("model", model, _MODELS)
    known_word("part", part, PARTS)
    study = given_study(study, "linear_model")
    own = as_unit(study, "linear_model")
    spec = controller_named(own, controller)
    ready = kept_tables(replace(own, controllers=(spec,)), progress=progress).ready
    law = gain_law(own, spec, ready)
    changes: dict[str, Any] = {} if grid is None or isinstance(grid, Grid) else {"grid": grid}
    if powers := {name: value for name, value in (("P_ref", P), ("Q_ref", Q)) if value is not None}:
        changes["simulation"] = powers
    if changes:
        there = as_unit(study.with_changes(**changes), "linear_model")
        own = replace(own, grid=there.grid, grid_source=there.grid_source, simulation=there.simulation)
    own = replace(own, grid=grid if isinstance(grid, Grid) else own.grid).with_limit_of(spec)
    rest = own.simulation.P_ref, own.simulation.Q_ref
    cells = cells_under(own, law, own.grid.R_g, own.grid.L_g, *rest)
    if cells.faults[0] is None and model == "reduced":
        return system_of(reduced_cells(own, cells), part)
    fault = cells.faults[0]
    if fault is None:
        full = full_order_cells(own, cells)
        fault = full.faults[0]
        if fault is None:
            return system_of(full, part)
    place = own.grid.place(own.converter, own.scr_basis)
    raise InfeasibleStudyError(f"{spec.name} on SCR {place.scr:.3g}, X/R {place.x_over_r:.3g}: {fault.rstrip('.')}.")
