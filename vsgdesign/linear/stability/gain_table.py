"""A gain table in the coupled reduced model: margins at its nodes, stale schedules, and a check of its file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.design_inputs import study_differences
from vsgdesign.artifacts.gain_table import GainTable, TableBase, base_differences, base_of
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import effective_inertia
from vsgdesign.errors import ArtifactError
from vsgdesign.linear.model.coupled import CoupledModel, coupled_model
from vsgdesign.linear.stability.margins import eigenvalues_of, margins_named
from vsgdesign.linear.stability.step_responses import reduced_step_metrics
from vsgdesign.linear.stability.table_claims import (
    FIGURES,
    OF_BEFORE,
    claim_faults,
    figure_of,
    is_carried,
    shown,
    where,
)
from vsgdesign.metrics.modes import least_damping
from vsgdesign.metrics.step_response import ResponseMetrics
from vsgdesign.runtime.table import node_gains, table_grids, table_schedule
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


_GAIN_TOLERANCE = 1e-9


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
        lags=base.lags,
    )
    found: dict[str, Array] = {name: np.full(len(R), np.nan) for name in names}
    if len(good):
        eigenvalues = eigenvalues_of(model)
        columns = _disk_margins(model, names) | {
            "damping_power_loops": least_damping(eigenvalues),
            "decay_1_s": -eigenvalues.real.max(axis=1),
            "H_s": effective_inertia(kept, base.S_rated, base.omega_n),
        }
        if any(figure_of(name).of_step for name in names):
            decay = columns["decay_1_s"][columns["decay_1_s"] > 0.0]
            t_end = float(np.clip(10.0 / decay.min(), 1.0, 120.0)) if len(decay) else 1.0
            for loop in "PQ":
                steps = reduced_step_metrics(model, f"{loop}_ref", loop, t_end, t_end / 10_000.0)
                columns[f"overshoot_{loop}_pct"] = np.array([_overshoot(step) for step in steps])
                columns[f"settling_{loop}_s"] = np.array([_settling(step) for step in steps])
        for name in names:
            found[name][good] = columns[name]
    return {name: values.reshape(shape) for name, values in found.items()}


def _disk_margins(model: CoupledModel, names: Sequence[str]) -> dict[str, Array]:
    """The disk margins among some FIGURES; others of a table of margins are not looked for."""
    disks = {
        "disk_margin_output": ("disk_output",),
        "disk_margin_input": ("disk_input",),
        "disk_margin_smaller": ("disk_output", "disk_input"),
    }
    wanted = [name for name in names if name in disks]
    tables = margins_named(model, dict.fromkeys(disk for name in wanted for disk in disks[name])) if wanted else {}
    return {name: np.min([tables[disk].value for disk in disks[name]], axis=0) for name in wanted}


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
    carried: tuple[str, ...]
    """What the file states and the check does not compute again."""

    @property
    def good(self) -> bool:
        """Whether everything that the file states was computed again, without a fault."""
        return not self.faults and not self.carried


def check_table(table: GainTable, study: Study | None = None) -> TableCheck:
    """Compare a table, read without a fault, with itself, its own columns, the reduced model, and its study.

    The gains must follow from the columns, every met cell must be stable, and each stored margin of FIGURES must
    agree with the model. Whatever the file says twice must agree (:func:`claim_faults`). With a study, the values from
    which the table was designed and every field of the base must agree. The certificate is not looked at.
    """
    faults = [] if study is None else _study_faults(table, study)
    valid = table.valid
    for name, made in node_gains(table)._asdict().items():
        stored = getattr(table.gains, name)
        fits = np.abs(stored - made) <= _GAIN_TOLERANCE * np.maximum(np.abs(made), 1e-12)
        bad = valid & ~(fits | (np.isnan(stored) & np.isnan(made)))
        if bad.any():
            at, place = where(table, bad)
            faults.append(f"gains.{name} is {stored[at]:.12g} {place}, the columns give {made[at]:.12g}")
    checked = FIGURES | OF_BEFORE
    found = nominal_margins(table, tuple(checked))
    unstable = (table.status == "met") & (found["decay_1_s"] <= 0.0)
    if unstable.any():
        at, place = where(table, unstable)
        faults.append(f"status is met {place}, but the reduced model decays at {shown(found['decay_1_s'][at])} 1/s")
    largest: dict[str, float] = {}
    figures = table.figures
    for name in checked.keys() & figures.keys():
        stored, made, figure = figures[name], found[name], checked[name]
        both = valid & np.isfinite(stored)
        difference = np.where(both, np.abs(stored - made), 0.0)
        largest[name] = float(np.max(difference, initial=0.0, where=np.isfinite(difference)))
        allowed = figure.tolerance * np.abs(made) if figure.relative else figure.tolerance
        bad = both & ~(difference <= allowed)
        if bad.any():
            at, place = where(table, bad)
            faults.append(f"margins.{name} is {shown(stored[at])} {place}, the reduced model gives {shown(made[at])}")
    faults += claim_faults(table)
    return TableCheck(tuple(faults), int(valid.sum()), dict(sorted(largest.items())), tuple(_carried(table)))


def _carried(table: GainTable) -> Iterator[str]:
    """What a table states beside what its gains give."""
    for name in table.figures:
        if is_carried(name):
            yield name
    if np.any(table.price[np.isfinite(table.price)] != 0.0):
        yield "price"
    if np.any(table.active != ""):
        yield "active"
    for name in ("between", "causes", "safe_place", "verification"):
        if getattr(table, name):
            yield name


def _study_faults(table: GainTable, study: Study) -> list[str]:
    faults = study_differences(table, study)
    if faults and table.design_inputs:
        return faults  # they name the base's fields, too
    return faults + base_differences(table.base, base_of(study, table.base.scr_basis), "the study")


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


def compare_tables(tables: Sequence[GainTable], names: Sequence[str]) -> list[Compared]:
    """Compare tables for the same system on the nodes of the first table, at its design point.

    A table with other nodes is interpolated as in its runtime. Raises ArtifactError if two bases differ, with the
    ``names`` of the tables, such as their files.
    """
    first = tables[0]
    for other, name in zip(tables[1:], names[1:], strict=True):
        faults = base_differences(first.base, other.base, name)
        if faults:
            raise ArtifactError(
                f"{names[0]} and {name} are for different systems; compare tables of one system.\n"
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
