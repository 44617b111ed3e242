"""A gain table in the coupled reduced model: margins at its nodes, stale schedules, and a check of its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.artifacts.design_inputs import study_differences
from vsgdesign.artifacts.gain_table import GainTable, TableBase, base_differences, base_of
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import effective_inertia
from vsgdesign.errors import ArtifactError
from vsgdesign.linear.model.coupled import coupled_model
from vsgdesign.linear.stability.margins import reduced_margins
from vsgdesign.linear.stability.step_responses import reduced_step_metrics
from vsgdesign.metrics.step_response import ResponseMetrics
from vsgdesign.runtime.table import node_gains, table_grids, table_schedule
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Figure:
    """What is known of a margin that a table stores: how it is called, judged, and compared with a new computation."""

    title: str
    unit: str
    tolerance: float = 0.0
    """How well a stored value must agree with the reduced model, in the unit."""
    relative: bool = False
    """Whether the tolerance is of the value instead."""
    smaller_is_better: bool = False
    asked: str = ""
    """Key of the specification that limits it; empty where none does."""
    factor: float = 1.0
    """From the specification's unit to this one."""
    of_step: bool = False
    """Whether it is read from a step response: computed on demand, and no promise where the law is inertia."""
    is_time: bool = False
    """Whether it is drawn from its least value on, instead of from zero."""
    at_design_point: bool = True
    """Whether there is a value at the design point beside the worst of the box."""


_OVERSHOOT: dict[str, Any] = {"smaller_is_better": True, "asked": "overshoot", "factor": 100.0, "of_step": True}
_SETTLING: dict[str, Any] = {"smaller_is_better": True, "asked": "settling_time", "of_step": True, "is_time": True}


def _defined(name: str, tolerance: float, **more: Any) -> Figure:
    one = DEFINITIONS[name]
    return Figure(one.heading, one.unit, tolerance, **more)


FIGURES = {
    "overshoot_P_pct": Figure("Overshoot of P", "%", 0.1, **_OVERSHOOT),
    "settling_P_s": Figure("2 % settling of P", "s", 0.01, relative=True, **_SETTLING),
    "overshoot_Q_pct": Figure("Overshoot of Q", "%", 0.1, **_OVERSHOOT),
    "settling_Q_s": Figure("2 % settling of Q", "s", 0.01, relative=True, **_SETTLING),
    "disk_margin_output": _defined("disk_margin_output", 0.02, asked="disk_margin"),
    "disk_margin_input": _defined("disk_margin_input", 0.02),
    "damping_power_loops": _defined("damping_power_loops", 0.005, asked="damping_ratio"),
    "decay_1_s": Figure("Decay of the slowest mode", "1/s", 0.01, relative=True),
    "H_s": Figure("Inertia constant", "s", 1e-3, relative=True),
}
"""Margins by name."""
OF_BEFORE = {"disk_margin_smaller": _defined("disk_margin_smaller", 0.02)}
"""Margins that only files of earlier versions have."""

OF_THE_DESIGN = {
    "cross_peak": Figure("Peak of the other power per step", "1"),
    "full_order_decay_1_s": Figure("Decay of the slowest mode, full order", "1/s", at_design_point=False),
    "scenarios": Figure("Scenarios of the design", "1", at_design_point=False),
}
"""Margins that a design stores as well, over its whole box, and that no check computes again."""

WORST = "worst_"
"""A name with this prefix is the worst value over the specification's box."""

_GAIN_TOLERANCE = 1e-9


def figure_of(name: str) -> Figure:
    """What is known of a margin; a name that is not known is its own title."""
    named = FIGURES | OF_BEFORE | OF_THE_DESIGN
    if name.startswith(WORST) and name[len(WORST) :] in named:
        known = named[name[len(WORST) :]]
        return replace(known, title=f"{known.title}, worst of the box")
    return named.get(name, Figure(name, "1"))


def margins_of(
    base: TableBase,
    R_g: Array,
    L_g: Array,
    P: Any,
    Q: Any,
    gains: PowerLoopGains,
    names: Sequence[str] = tuple(FIGURES),
) -> dict[str, Array]:
    """Nominal margins of FIGURES on grids of any shape, each with its gains; NaN without operating point or gains.

    An unstable cell has its damping and decay rate (negative) and its inertia, but no other margin. A step that does
    not settle within the observed 10 time constants of the slowest cell has NaN.
    """
    shape = np.broadcast_shapes(R_g.shape, L_g.shape, *(np.shape(value) for value in gains))
    R = np.broadcast_to(base.R_2 + R_g, shape).ravel()
    X = np.broadcast_to(base.omega_n * (base.L_2 + L_g), shape).ravel()
    P, Q = (np.broadcast_to(np.asarray(value, dtype=float), shape).ravel() for value in (P, Q))
    flat = PowerLoopGains(*(np.broadcast_to(value, shape).ravel() for value in gains))
    with np.errstate(invalid="ignore"):
        V_rms, delta = operating_point(P, Q, base.V_g_rms, R, X)
    good = np.flatnonzero(np.isfinite(V_rms) & np.all([np.isfinite(value) for value in flat], axis=0))
    kept = PowerLoopGains(*(value[good] for value in flat))
    model = coupled_model(
        delta[good],
        V_rms[good],
        np.full(len(good), base.V_g_rms),
        R[good],
        X[good],
        kept,
        tau_P=base.tau_P,
        tau_Q=base.tau_Q,
    )
    found: dict[str, Array] = {name: np.full(len(R), np.nan) for name in names}
    if len(good):
        table = reduced_margins(model)
        columns = {
            "disk_margin_output": table.disk_output.value,
            "disk_margin_input": table.disk_input.value,
            "disk_margin_smaller": np.minimum(table.disk_output.value, table.disk_input.value),
            "damping_power_loops": table.least_damping,
            "decay_1_s": -table.spectral_abscissa,
            "H_s": effective_inertia(kept, base.S_rated, base.omega_n),
        }
        if any(figure_of(name).of_step for name in names):
            decay = columns["decay_1_s"][table.stable]
            t_end = float(np.clip(10.0 / decay.min(), 1.0, 120.0)) if len(decay) else 1.0
            for loop in "PQ":
                steps = reduced_step_metrics(model, f"{loop}_ref", loop, t_end, t_end / 10_000.0)
                columns[f"overshoot_{loop}_pct"] = np.array([_overshoot(step) for step in steps])
                columns[f"settling_{loop}_s"] = np.array([_settling(step) for step in steps])
        for name in names:
            found[name][good] = columns[name]
    return {name: values.reshape(shape) for name, values in found.items()}


def _overshoot(step: ResponseMetrics | None) -> float:
    return np.nan if step is None or step.overshoot_pct is None else step.overshoot_pct


def _settling(step: ResponseMetrics | None) -> float:
    return np.nan if step is None or step.settling_time_s is None else step.settling_time_s


def nominal_margins(table: GainTable, names: Sequence[str] = tuple(FIGURES)) -> dict[str, Array]:
    """Margins at a table's nodes (n, m), with its stored gains at its design point."""
    return margins_of(table.base, *table_grids(table), table.P_design, table.Q_design, table.gains, names)


def stale_margins(table: GainTable, x_over_r: float, name: str) -> Array:
    """One margin over the true SCR (rows) × the SCR for which the gains are made (columns), at the nodes of the
    table.

    ``x_over_r``: the nearest node of the axis is used for both.
    """
    column = int(np.argmin(np.abs(np.log(table.x_over_r / x_over_r))))
    R_g, L_g = (values[:, column] for values in table_grids(table))
    made = table_schedule(table).gains_over(R_g, L_g)
    gains = PowerLoopGains(*(np.asarray(value)[None, :] for value in made))
    return margins_of(table.base, R_g[:, None], L_g[:, None], table.P_design, table.Q_design, gains, (name,))[name]


@dataclass(frozen=True)
class TableCheck:
    """The result of a check. ``largest``: for each margin, the largest difference between the stored and the new
    value.
    """

    faults: tuple[str, ...]
    cells: int
    largest: dict[str, float]
    unknown: tuple[str, ...]
    """Stored margins that were not computed again."""

    @property
    def good(self) -> bool:
        """Whether there is no fault."""
        return not self.faults


def check_table(table: GainTable, study: Study | None = None) -> TableCheck:
    """Compare a table, read without a fault, with its own columns, the reduced model, and its study.

    The gains must follow from the columns, every met cell must be stable, and each stored margin of FIGURES must
    agree with the model. With a study, the values from which the table was designed and every field of the base must
    agree.
    """
    faults = [] if study is None else _study_faults(table, study)
    valid = table.valid
    for name, made in node_gains(table)._asdict().items():
        stored = getattr(table.gains, name)
        fits = np.abs(stored - made) <= _GAIN_TOLERANCE * np.maximum(np.abs(made), 1e-12)
        bad = valid & ~(fits | (np.isnan(stored) & np.isnan(made)))
        if bad.any():
            faults.append(f"gains.{name} is not what the columns give, {_where(table, bad)}")
    checked = FIGURES | OF_BEFORE
    found = nominal_margins(table, tuple(checked))
    unstable = (table.status == "met") & (found["decay_1_s"] <= 0.0)
    if unstable.any():
        faults.append(f"met, but unstable in the reduced model, {_where(table, unstable)}")
    largest: dict[str, float] = {}
    figures = table.figures
    for name in checked.keys() & figures.keys():
        stored, made, figure = figures[name], found[name], checked[name]
        both = valid & np.isfinite(stored)
        difference = np.where(both, np.abs(stored - made), 0.0)
        largest[name] = float(np.nanmax(difference))
        allowed = figure.tolerance * np.abs(made) if figure.relative else figure.tolerance
        bad = both & ~(difference <= allowed)
        if bad.any():
            faults.append(f"margins.{name} is not what the reduced model gives, {_where(table, bad)}")
    others = tuple(name for name in figures if name not in checked)
    return TableCheck(tuple(faults), int(valid.sum()), dict(sorted(largest.items())), others)


def _study_faults(table: GainTable, study: Study) -> list[str]:
    faults = study_differences(table, study)
    if faults and table.design_inputs:
        return faults  # they name the base's fields, too
    return faults + base_differences(table.base, base_of(study, table.base.scr_basis), "the study")


def _where(table: GainTable, cells: NDArray[np.bool_]) -> str:
    i, j = np.argwhere(cells)[0]
    rest = int(cells.sum()) - 1
    more = f" and {rest} more cell{'s' if rest > 1 else ''}" if rest else ""
    return f"at SCR {table.scr[i]:g}, X/R {table.x_over_r[j]:g}{more}"


@dataclass(frozen=True)
class Compared:
    """One of several tables on common grids: its interpolated gains and the resulting margins, each (n, m)."""

    table: GainTable
    gains: PowerLoopGains
    margins: dict[str, Array]

    def worst(self, name: str) -> float:
        """The least favourable value over the grids; NaN if no value is known."""
        values = self.margins[name][np.isfinite(self.margins[name])]
        if len(values) == 0:
            return float("nan")
        return float(values.max() if figure_of(name).smaller_is_better else values.min())


def compare_tables(tables: Sequence[GainTable]) -> list[Compared]:
    """Compare tables for the same system on the nodes of the first table, at its design point.

    A table with other nodes is interpolated as in its runtime. Raises ArtifactError if two bases differ.
    """
    first = tables[0]
    for other in tables[1:]:
        faults = base_differences(first.base, other.base, other.name)
        if faults:
            raise ArtifactError(
                f"{first.name} and {other.name} are for different systems; compare tables of one system.\n"
                + "\n".join(f"  - {fault}" for fault in faults)
            )
    R_g, L_g = table_grids(first)
    found = []
    for table in tables:
        made = table_schedule(table).gains_over(R_g, L_g)
        gains = PowerLoopGains(*(np.broadcast_to(value, first.shape) for value in made))
        margins = margins_of(table.base, R_g, L_g, first.P_design, first.Q_design, gains)
        found.append(Compared(table, gains, margins))
    return found


def largest_difference(
    one: Mapping[str, Array], other: Mapping[str, Array], name: str
) -> tuple[float, int, int] | None:
    """The largest absolute difference of a margin and its node; None if no node has both values."""
    difference = np.abs(other[name] - one[name])
    if not np.isfinite(difference).any():
        return None
    i, j = np.unravel_index(int(np.nanargmax(difference)), difference.shape)
    return float(other[name][i, j] - one[name][i, j]), int(i), int(j)
