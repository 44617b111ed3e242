"""The promises of each controller, and whether it keeps them at the operating points of a scenario.

They are checked with ideal and with real inner loops.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.closed_form import overshoot_of
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.many_rests import rest_with_measured_gains
from vsgdesign.linear.stability.cells import GainLaw, cells_under, full_order_cells, reduced_cells
from vsgdesign.linear.stability.margins import MarginTable, full_order_margins, reduced_margins
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.feeds import as_told
from vsgdesign.simulation.scenario.controllers import OperatingPointRow, ScenarioResult
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.source import GridSource
from vsgdesign.study.parameters.study import ControllerSpec, Study

TABLE, CLOSED_FORM, GATES = "its table's specification", "its closed form's target", "the study's gates"
_SLACK = 1e-3
"""A figure within a thousandth of its limit keeps it: the optimizer stops on the limit."""


@dataclass(frozen=True)
class Promises:
    """The promises of a controller. None means that there is no such promise."""

    source: str
    settling_time: float | None
    """2 % settling of P and Q after a step of their own reference, s."""
    overshoot_pct: float | None
    """Of a step of P_ref, in per cent of it."""
    overshoot_Q_pct: float | None
    """Of a step of Q_ref."""
    damping_ratio: float | None = None
    disk_margin: float | None = None
    gain_margin_db: float | None = None
    phase_margin_deg: float | None = None
    M_s: float | None = None


def promises_of(study: Study, spec: ControllerSpec, ready: Ready = NOTHING) -> Promises:
    """A table is held to its specification; a closed form, fixed on its design grid or scheduled, to its own poles and
    the study's gates; gains that are given to the gates, which limit no overshoot."""
    gates, target = study.stability.gates, spec.target
    margins = {
        "damping_ratio": gates.damping_ratio,
        "gain_margin_db": gates.gain_margin_db,
        "phase_margin_deg": gates.phase_margin_deg,
        "M_s": gates.M_s,
    }
    if spec.gains is not None:
        return Promises(GATES, gates.settling_time, None, None, **margins)
    table = ready.table(spec)
    if table is not None:
        asked = table.specification
        settles = asked.get("aim", "settling") == "settling"
        share = asked.get("overshoot") if settles else None
        overshoot = None if share is None else 100.0 * float(share)
        time = asked.get("settling_time") if settles else None
        return Promises(
            TABLE,
            time,
            overshoot,
            overshoot,
            damping_ratio=asked.get("damping_ratio"),
            disk_margin=asked.get("disk_margin"),
        )
    if STRUCTURES[target.structure].uncoupled:  # Q is a first-order loop there
        return Promises(CLOSED_FORM, target.settling_time, overshoot_of(target.damping_ratio), 0.0, **margins)
    own = overshoot_of(0.5 * target.d_1 / math.sqrt(target.k_1))
    return Promises(CLOSED_FORM, target.settling_time, own, own, **margins)


def not_promised(table: GainTable | None, study: Study, row: OperatingPointRow | None) -> str:
    """The reason why a table promises nothing at an operating point: the limits of its box that are exceeded.

    The text is empty where the table promises something.
    """
    if table is None or row is None or row.point is None:
        return ""
    box, basis, c, point = table.validity, table.base.scr_basis, study.converter, row.point
    values = {
        "SCR": (row.grid.scr(c, basis), box.scr, 1.0),
        "X/R": (row.grid.x_over_r(c.omega_n), box.x_over_r, 1.0),
        "P": (point.P, box.P, 1e3),
        "Q": (point.Q, box.Q, 1e3),
        "V": (point.V_rms, box.V_rms, 1.0),
    }
    units = {"P": " kW", "Q": " kvar", "V": " V"}
    left = [
        f"{name} {value / unit:.4g} outside {low / unit:.4g} to {high / unit:.4g}{units.get(name, '')}"
        for name, (value, (low, high), unit) in values.items()
        if not low - 1e-6 * abs(low) <= value <= high + 1e-6 * abs(high)
    ]
    return "; ".join(left)


@dataclass(frozen=True, kw_only=True)
class Kept:
    """One promise of a controller at one operating point of a scenario: its limit, and the values of both models.

    Values are NaN if a loop is unstable. ``excuse`` is the reason why nothing is promised or known here, or empty.
    """

    controller: str
    source: str
    t_s: float
    grid: Grid
    P: float
    Q: float
    name: str
    limit: float
    at_least: bool
    ideal: float
    full_order: float
    excuse: str = ""

    @property
    def kept_ideal(self) -> bool:
        """With ideal inner loops."""
        return self._keeps(self.ideal)

    @property
    def kept(self) -> bool:
        """With the real inner loops, delay and filters."""
        return self._keeps(self.full_order)

    def _keeps(self, value: float) -> bool:
        if not math.isfinite(value):  # an infinite margin is kept, an unstable loop keeps nothing
            return math.isinf(value) and (value > 0.0) == self.at_least
        return value >= self.limit * (1.0 - _SLACK) if self.at_least else value <= self.limit * (1.0 + _SLACK)


def promises_kept(result: ScenarioResult) -> tuple[Kept, ...]:
    """Every promise of every controller at every operating point of the scenario, for both models.

    A controller that is told a wrong grid is checked with it. One with an estimator is checked with the exact grid:
    the effect of its estimate is judged in the time domain.
    """
    found: list[Kept] = []
    for controller in result.controllers:
        found += _of_controller(result, controller.spec)
    return tuple(found)


def _of_controller(result: ScenarioResult, spec: ControllerSpec) -> list[Kept]:
    study, timeline, ready = result.study.with_limit_of(spec), result.timeline, result.ready
    law, promises, found = as_told(gain_law(study, spec, ready), spec), promises_of(study, spec, ready), []
    points = [row for row in result.operating_points if row.point is not None]
    sources = [timeline.source_at(row.t_s) for row in points]
    asked_by = promises.source if promises.source == TABLE else GATES
    for V_g, omega in dict.fromkeys((source.V_g_rms, source.omega) for source in sources):
        rows = [row for row, s in zip(points, sources, strict=True) if (s.V_g_rms, s.omega) == (V_g, omega)]
        here = replace(study, grid_source=GridSource(V_g, omega))
        R_g, L_g = np.array([(row.grid.R_g, row.grid.L_g) for row in rows]).T
        rests = [_rest(here, law, row, timeline.references_at(row.t_s)) for row in rows]
        P, Q = np.array([(P, Q) for P, Q, _ in rests]).T
        cells = cells_under(here, law, R_g, L_g, P, Q)
        good, model = np.flatnonzero(cells.good), full_order_cells(here, cells)
        ideal, full = reduced_margins(reduced_cells(here, cells)), full_order_margins(model)
        row_ideal = {int(k): j for j, k in enumerate(good)}
        row_full = {int(good[k]): j for j, k in enumerate(model.index)}
        faults = {int(good[k]): fault for k, fault in enumerate(model.faults)}
        for k, row in enumerate(rows):
            excuse = not_promised(ready.table(spec), study, row) or cells.outside[k] or rests[k][2] or cells.faults[k]
            excuse = excuse or faults.get(k) or ""
            for name, at_least in _MARGINS:
                limit = getattr(promises, name)
                if limit is None or limit == 0.0:
                    continue
                reached = _figure(ideal, row_ideal.get(k), name), _figure(full, row_full.get(k), name)
                if name == "damping_ratio" and asked_by == TABLE and math.isfinite(reached[1]):
                    # A promise of the power loops: how the network's modes are damped is the inner loops' matter.
                    reached = reached[0], reached[0]
                found.append(
                    Kept(
                        controller=spec.name,
                        source=asked_by,
                        t_s=row.t_s,
                        grid=row.grid,
                        P=float(P[k]),
                        Q=float(Q[k]),
                        name=name,
                        limit=float(limit),
                        at_least=at_least,
                        ideal=reached[0],
                        full_order=reached[1],
                        excuse=excuse,
                    )
                )
    return sorted(found, key=lambda one: one.t_s)


def _rest(study: Study, law: GainLaw, row: OperatingPointRow, refs: References) -> tuple[float, float, str]:
    """P and Q at which the converter rests under its droops, and why it does not rest."""

    def gains_of(P: float, Q: float, V_rms: float) -> PowerLoopGains:
        return PowerLoopGains(*(float(value) for value in law(row.grid.R_g, row.grid.L_g, P, Q, V_rms)))

    try:
        at = rest_with_measured_gains(study, row.grid, study.grid_source, refs, gains_of)[0]
    except InfeasibleStudyError as error:
        return refs.P_ref, refs.Q_ref, str(error)
    return float(at.controller.P_f), float(at.controller.Q_f), ""


_MARGINS = (
    ("damping_ratio", True),
    ("disk_margin", True),
    ("gain_margin_db", True),
    ("phase_margin_deg", True),
    ("M_s", False),
)


def _figure(table: MarginTable, row: int | None, name: str) -> float:
    """One figure of a cell; NaN where it is unstable or not there."""
    if row is None or not table.stable[row]:
        return float("nan")
    columns = {
        "damping_ratio": table.least_damping,
        "disk_margin": table.disk_output.value,  # where the optimizer has it
        "gain_margin_db": np.minimum(table.loop_P.gain_margin_db, table.loop_Q.gain_margin_db),
        "phase_margin_deg": np.minimum(table.loop_P.phase_margin_deg, table.loop_Q.phase_margin_deg),
        "M_s": table.M_s.value,
    }
    return float(columns[name][row])
