"""What is judged of a scenario: the promises of each controller, and whether it keeps them where it rests; and the
quality of its estimates: errors, delays, and the response compared with that for the true grid.

Promises are checked with ideal and with real inner loops.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import in_words
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.placing import overshoot_of
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.linear.model.coupled import CoupledModel
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.maps import CellSet, cell_set, full_order_cells, reduced_cells
from vsgdesign.linear.stability.margins import eigenvalues_of, margins_named
from vsgdesign.linear.stability.safe_place import inside_run
from vsgdesign.metrics.answers import ChangeSeen, RestError, changes_seen, errors_at_rest, rows_at_rest
from vsgdesign.metrics.met import MARGIN_ROOM
from vsgdesign.metrics.modes import least_damping
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.rest import Rest
from vsgdesign.simulation.scenario.controllers import ControllerResult, ScenarioResult
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import ControllerSpec, Study


@dataclass(frozen=True, kw_only=True)
class StepAgainstTruth:
    """One reference step of a controller with the estimate, and of the same controller with the truth."""

    t_s: float
    name: str
    signal: str
    settling_time_s: float | None
    settling_time_truth_s: float | None
    overshoot_pct: float | None
    overshoot_truth_pct: float | None


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """One controller that estimates."""

    name: str
    log: EstimateLog
    statuses: dict[str, int]
    rest: tuple[RestError, ...]
    changes: tuple[ChangeSeen, ...]
    with_the_truth: str | None
    """The controller that differs by knowing the truth alone, and by when it is told, if the study has one."""
    steps: tuple[StepAgainstTruth, ...]
    inside: tuple[float, float] | None = None
    """Shares of the answers, at rest and of all, that are inside the error set of the controller's table; None without
    a table, or with one that was designed for an exact estimate."""

    @property
    def rate_limit(self) -> tuple[float, float, float] | None:
        """Where the rate limit (1/s) of a table's scheduler held gains back: limit, for how long, of how long (s)."""
        log = self.log
        if log.rate is None or not log.limited.any():
            return None
        return log.rate, log.period * float(log.limited.sum()), log.period * len(log.limited)


def judge_estimates(result: ScenarioResult) -> tuple[Judgement, ...]:
    """The judgements of all controllers of a scenario that estimate the grid, in order."""
    study, timeline = result.study, result.timeline
    instants = sorted({event.t_s for event in study.events})
    changes = timeline.truth_changes()
    end_s = study.simulation.duration
    found = []
    for controller in result.controllers:
        log = controller.estimates
        if log is None:
            continue
        table = result.ready.table(controller.spec)
        inside = None
        if table is not None and (table.validity.error or table.validity.error_Z):
            rest = rows_at_rest(log.t_s, instants, end_s)
            inside = inside_run(table, (log.R_g, log.L_g), (log.R_g_hat, log.L_g_hat), rest)
        rows = (log.t_s, log.R_g, log.L_g, log.R_g_hat, log.L_g_hat)
        truth = same_with_truth(result, controller)
        found.append(
            Judgement(
                name=controller.spec.name,
                log=log,
                statuses=dict(Counter(log.status)),
                rest=errors_at_rest(*rows, instants, end_s),
                changes=changes_seen(*rows, log.period, changes, instants, end_s),
                with_the_truth=None if truth is None else truth.spec.name,
                steps=() if truth is None else _against(controller, truth),
                inside=inside,
            )
        )
    return tuple(found)


def same_with_truth(result: ScenarioResult, controller: ControllerResult) -> ControllerResult | None:
    """The controller that differs by knowing the truth alone, and by when it is told; None if the study has none."""
    return next(
        (other for other in result.controllers if _knows_the_truth_alone(controller, other, result.ready)), None
    )


def _knows_the_truth_alone(controller: ControllerResult, other: ControllerResult, ready: Ready) -> bool:
    changes = {"name": other.spec.name, "estimate": "truth", "update_period": other.spec.update_period}
    alike = replace(controller.spec, **changes) == other.spec
    return other.estimates is None and alike and ready.table(controller.spec) == ready.table(other.spec)


def _against(controller: ControllerResult, truth: ControllerResult) -> tuple[StepAgainstTruth, ...]:
    steps = []
    for ours in controller.events:
        # A step together with the clearing of a fault comes at an instant of each run.
        alike = [one for one in truth.events if (one.kind, one.signal) == (ours.kind, ours.signal)]
        if ours.kind == "step" and alike:
            theirs = min(alike, key=lambda one: abs(one.t_s - ours.t_s))
            a, b = (e.cycle_mean for e in (ours, theirs))
            steps.append(
                StepAgainstTruth(
                    t_s=ours.t_s,
                    name=ours.name,
                    signal=ours.signal,
                    settling_time_s=a.settling_time_s,
                    settling_time_truth_s=b.settling_time_s,
                    overshoot_pct=a.overshoot_pct,
                    overshoot_truth_pct=b.overshoot_pct,
                )
            )
    return tuple(steps)


Array = NDArray[np.float64]

TABLE, CLOSED_FORM, GATES = "its table's specification", "its closed form's target", "the study's gates"


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
    """A table is held to its specification; a closed form, fixed on its design grid or scheduled, to its own target and
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
    own = overshoot_of(0.5 * target.d_1 / math.sqrt(target.k_1))  # more than is promised only with poles of a study
    of_P, of_Q = (max(own, pct) for pct in STRUCTURES[target.structure].overshoot_pct)
    return Promises(CLOSED_FORM, target.settling_time, of_P, of_Q, **margins)


def not_promised(table: GainTable | None, study: Study, rest: Rest | None) -> str:
    """The reason why a table promises nothing where a controller rests: the limits of its box that are exceeded.

    The text is empty where the table promises something.
    """
    if table is None or rest is None or rest.point is None:
        return ""
    box, basis, c, point = table.validity, table.base.scr_basis, study.converter, rest.point
    values = {
        "SCR": (rest.grid.scr(c, basis), box.scr, 1.0),
        "X/R": (rest.grid.x_over_r(c.omega_n), box.x_over_r, 1.0),
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


def given_up(table: GainTable | None, study: Study, rest: Rest | None, promise: str) -> str:
    """Where and why a table has given up a promise around the grid of a rest; empty where it has not, or does not say.

    ``promise``: a name of its figures, ``settling_time`` or ``overshoot``. The nodes are those that the gains are
    interpolated from.
    """
    if table is None or rest is None:
        return ""
    scr, x_over_r = rest.grid.scr(study.converter, table.base.scr_basis), rest.grid.x_over_r(study.converter.omega_n)
    rows, columns = table.around(scr, x_over_r)
    nodes = [
        cause
        for cause in table.causes
        if cause["missed"].get(promise) is not None
        and cause["scr"] in table.scr[rows]
        and cause["x_over_r"] in table.x_over_r[columns]
    ]
    if not nodes:
        return ""
    worst = max(nodes, key=lambda cause: float(cause["missed"][promise]))
    what, reached = in_words(promise), float(worst["missed"][promise])
    value = f"{100.0 * reached:.3g} %" if promise == "overshoot" else f"{reached:.3g} s"
    because = ", ".join(dict.fromkeys(str(cause["cause"]) for cause in nodes))
    at = f"SCR {worst['scr']:g}, X/R {worst['x_over_r']:g}"
    return f"its table gives up the {what} there: up to {value} at {at}, because of {because}"


@dataclass(frozen=True, kw_only=True)
class Kept:
    """One promise of a controller at one rest of a scenario: its limit, and the values of both models.

    Values are NaN if a loop is unstable, powers if there is no rest. ``excuse`` is the reason why nothing is promised
    or known here, or empty.
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
        return value >= self.limit * (1.0 - MARGIN_ROOM) if self.at_least else value <= self.limit * (1.0 + MARGIN_ROOM)


def promises_kept(result: ScenarioResult) -> tuple[Kept, ...]:
    """Every promise of every controller wherever it rests in the scenario, for both models, with the gains that it has
    there: of a controller with an estimator those of its estimate."""
    found: list[Kept] = []
    for controller in result.controllers:
        found += _of_controller(result, controller)
    return tuple(found)


def _of_controller(result: ScenarioResult, controller: ControllerResult) -> list[Kept]:
    spec, ready = controller.spec, result.ready
    study, promises, found = result.study.with_limit_of(spec), promises_of(result.study, spec, ready), []
    asked_by = promises.source if promises.source == TABLE else GATES
    limits = {name: float(limit) for name, _ in _MARGINS if (limit := getattr(promises, name))}
    for source in dict.fromkeys(rest.source for rest in controller.rests):
        rests = [rest for rest in controller.rests if rest.source == source]
        here = replace(study, grid_source=source)
        cells = _cells(here, rests)
        good, model = np.flatnonzero(cells.good), full_order_cells(here, cells)
        ideal, full = (_figures(of_cells, limits) for of_cells in (reduced_cells(here, cells), model))
        row_ideal = {int(k): j for j, k in enumerate(good)}
        row_full = {int(good[k]): j for j, k in enumerate(model.index)}
        faults = {int(good[k]): fault for k, fault in enumerate(model.faults)}
        for k, rest in enumerate(rests):
            excuse = rest.obstacle or not_promised(ready.table(spec), study, rest) or cells.outside[k]
            excuse = excuse or cells.faults[k] or faults.get(k) or ""
            for name, at_least in _MARGINS:
                if name not in limits:
                    continue
                reached = _figure(ideal[name], row_ideal.get(k)), _figure(full[name], row_full.get(k))
                if name == "damping_ratio" and asked_by == TABLE and math.isfinite(reached[1]):
                    # A promise of the power loops: how the network's modes are damped is the inner loops' matter.
                    reached = reached[0], reached[0]
                found.append(
                    Kept(
                        controller=spec.name,
                        source=asked_by,
                        t_s=rest.t_s,
                        grid=rest.grid,
                        P=float(cells.P[k]),
                        Q=float(cells.Q[k]),
                        name=name,
                        limit=limits[name],
                        at_least=at_least,
                        ideal=reached[0],
                        full_order=reached[1],
                        excuse=excuse,
                    )
                )
    return sorted(found, key=lambda one: one.t_s)


def _cells(study: Study, rests: Sequence[Rest]) -> CellSet:
    """One cell for each rest; NaN where there is none."""
    R_g, L_g = np.array([(rest.grid.R_g, rest.grid.L_g) for rest in rests]).T
    P, Q = np.array([(rest.point.P, rest.point.Q) if rest.point else (math.nan, math.nan) for rest in rests]).T
    return cell_set(study, R_g, L_g, P, Q, PowerLoopGains(*np.array([rest.gains for rest in rests]).T))


_MARGINS = (
    ("damping_ratio", True),
    ("disk_margin", True),
    ("gain_margin_db", True),
    ("phase_margin_deg", True),
    ("M_s", False),
)


_COLUMNS = {
    "disk_margin": ("disk_output",),  # where the optimizer has it
    "gain_margin_db": ("loop_P", "loop_Q"),
    "phase_margin_deg": ("loop_P", "loop_Q"),
    "M_s": ("M_s",),
}
"""The columns of a table of margins that a promise is about; a damping ratio needs none."""


def _figures(model: CoupledModel | FullOrderModel, names: Collection[str]) -> dict[str, Array]:
    """Some of the figures of _MARGINS by name, for each cell; NaN in unstable ones. Others are not looked for."""
    eigenvalues = eigenvalues_of(model)
    tables = margins_named(model, dict.fromkeys(column for name in names for column in _COLUMNS.get(name, ())))
    found: dict[str, Array] = {}
    for name in names:
        if name == "damping_ratio":
            stable = eigenvalues.real.max(axis=1) < 0.0
            found[name] = np.where(stable, least_damping(eigenvalues), np.nan)
        elif name in ("disk_margin", "M_s"):
            found[name] = tables[_COLUMNS[name][0]].value
        else:
            loop_P, loop_Q = (getattr(tables[column], name) for column in _COLUMNS[name])
            found[name] = np.minimum(loop_P, loop_Q)
    return found


def _figure(figures: Array, row: int | None) -> float:
    """One figure of a cell; NaN where it is not there."""
    return float("nan") if row is None else float(figures[row])
