"""The safe place of a schedule: the one grid whose gains suit every grid of a specification best.

A schedule that is never told its grid again stays there (docs/theory/runtime.md). The place is searched once, when a
table is designed or a run with a closed form begins. A controller gets the result alone. How often an
estimate is inside the error set of a table is counted here too (:eq:`error-set`).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.measured_errors import MeasuredErrors
from vsgdesign.equations.frames import base_impedance
from vsgdesign.equations.grid import SCR_BASES, error_half_widths
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.linear.model.coupled import coupled_model
from vsgdesign.linear.operating_point.equilibrium import static_limit_uses
from vsgdesign.linear.stability.maps import GainLaw, cell_set, full_order_cells
from vsgdesign.linear.stability.margins import eigenvalues_of, margins_named
from vsgdesign.runtime.guards import settings_of
from vsgdesign.runtime.of_study import ControllerGains, follows_measured
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.runtime.table import table_grids, table_schedule
from vsgdesign.study.parameters.grid import PLAIN, GridSource, Place
from vsgdesign.study.parameters.specification import Specification, SurvivalSpec
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

LEAST_DISK_MARGIN = 0.3
"""Disk margin that the gains of the safe place keep on every grid, or that of the middle of the grids if this is
less."""

LOWEST_DISK_MARGIN = 0.25
"""What they keep even where the middle has less: with 0.07, jumps to the strongest grids ring for seconds."""

_SCRS = 64
"""Places that are compared, by their SCR."""

_LOWEST_RAD_S, _POINTS = 0.1, 60
"""Frequencies on which a margin is looked for first."""


class PlaceFigures(NamedTuple):
    """What the gains of one place do on the grids of a specification, at their worst."""

    decay: float
    """Decay rate of the slowest mode, 1/s; not positive: unstable somewhere. It is the smaller one of the reduced and
    the full-order model."""
    disk_margin: float
    """Of the full-order model; 0 where it is unstable."""


@dataclass(frozen=True, eq=False)
class _Plants:
    """Grids with operating points within the static limits: arrays (N,)."""

    R_g: Array
    L_g: Array
    P: Array
    Q: Array
    V_rms: Array
    delta: Array

    def take(self, chosen: NDArray[np.bool_]) -> _Plants:
        """Some of them."""
        return _Plants(*(values[chosen] for values in vars(self).values()))


def middle_place(specification: Specification) -> Place:
    """The geometric means of SCR and of X/R over a specification's axes."""
    scr, x_over_r = (math.sqrt(axis[0] * axis[-1]) for axis in (specification.scr, specification.x_over_r))
    return Place(scr, x_over_r, specification.scr_basis)


def closed_form_place(study: Study, spec: ControllerSpec) -> Place | None:
    """The safe place of a closed form: that of :func:`safe_place` under the specification of its study. None without a
    specification. It is searched once in a process for equal designs."""
    if study.specification is None:
        return None
    if not STRUCTURES[spec.target.structure].safe_in_the_middle:
        return middle_place(study.specification)
    return _closed_form_place(_of_design(study, spec), follows_measured(spec))


def table_safe_place(study: Study, table: GainTable) -> tuple[float, float] | None:
    """SCR and X/R of the safe place of a table under the specification of its study. None where the schedule waits at
    the place of its structure: without a specification, and for structures that are not safe between the grids."""
    if study.specification is None or not STRUCTURES[table.structure].safe_in_the_middle:
        return None
    law = ControllerGains(table_schedule(table), None, True, settings_of(replace(table, safe_place=None)))
    place = safe_place(study, law)
    return place.scr, place.x_over_r


def safe_place(study: Study, law: GainLaw) -> Place:
    """The place whose gains have the best worst decay over the specification of a study (:eq:`safe-place`).

    ``law`` gives the gains for an assumed grid at measured powers. The impedances of the places have the angle that is
    least wrong on any grid, and their gains keep LEAST_DISK_MARGIN, or the margin of the middle of the grids if that is
    less, but at least LOWEST_DISK_MARGIN. The reduced model orders the places; the full-order model decides. Where no
    place keeps the margin, or no grid carries one of the powers, it is the middle. Raises ValueError without a
    specification.
    """
    asked = study.specification
    if asked is None:
        raise ValueError("the study has no [specification]: there are no grids to be safe on")
    study = replace(study, scr_basis=asked.scr_basis, grid_source=_source(asked))
    middle, corners = middle_place(asked), _plants(study, asked, scrs=3, x_over_rs=3, Ps=3, Qs=2)
    plants = _plants(study, asked, scrs=4, x_over_rs=4, Ps=5, Qs=2)
    if not len(plants.P):
        return middle
    of_middle, floor = place_figures(study, law, middle, corners), LEAST_DISK_MARGIN
    if of_middle.decay > 0.0:
        floor = max(min(floor, of_middle.disk_margin), LOWEST_DISK_MARGIN)
    places = _not_too_fast(study, law, _places(asked), corners, floor)
    decays = reduced_decays(study, law, places, plants)
    best, best_decay = middle, 0.0
    for k in np.argsort(-decays, kind="stable"):
        if not decays[k] > best_decay:
            break
        found = place_figures(study, law, places[k], corners)
        decay = min(float(decays[k]), found.decay)
        if found.disk_margin >= floor and decay > best_decay:
            best, best_decay = places[k], decay
    return best


def reduced_decays(study: Study, law: GainLaw, places: list[Place], plants: _Plants) -> Array:
    """Decay rate (1/s) of the slowest mode of the coupled model over all plants with the gains of each place;
    -infinity where a place has no gains."""
    R_hat, L_hat = _grids(study, places)
    gains = law(R_hat[:, None], L_hat[:, None], plants.P, plants.Q, plants.V_rms)
    shape = (len(places), len(plants.P))
    flat = PowerLoopGains(*(np.broadcast_to(value, shape).ravel() for value in gains))
    good = np.isfinite(np.stack(flat)).all(axis=0)
    every = [np.broadcast_to(values, shape).ravel()[good] for values in vars(plants).values()]
    R_g, L_g, _, _, V_rms, delta = every
    model = coupled_model(
        delta,
        V_rms,
        study.grid_source.V_g_rms,
        R_g + study.filter.R_2,
        study.grid_source.omega_g * (L_g + study.filter.L_2),
        PowerLoopGains(*(value[good] for value in flat)),
        lags=study.power_lags,
    )
    found = np.full(shape[0] * shape[1], -math.inf)
    found[good] = -eigenvalues_of(model).real.max(axis=1)
    return found.reshape(shape).min(axis=1)


def place_figures(study: Study, law: GainLaw, place: Place, plants: _Plants) -> PlaceFigures:
    """The full-order model's worst figures over plants with the gains of one place."""
    R_hat, L_hat = _grids(study, [place])
    decay, margin = _full_order(study, law, np.broadcast_to(R_hat, plants.P.shape), L_hat, plants)
    return PlaceFigures(float(decay.min(initial=math.inf)), float(margin.min(initial=math.inf)))


def _not_too_fast(study: Study, law: GainLaw, places: list[Place], corners: _Plants, floor: float) -> list[Place]:
    """The places whose gains keep a margin on the strongest grids. SCR rises from place to place: of these the first
    that keeps it, found by bisection, and all behind it, whose gains are slower still."""
    lengths = np.hypot(corners.R_g, study.converter.omega_n * corners.L_g)
    strong = corners.take(lengths <= 1.001 * lengths.min(initial=math.inf))
    low, high = 0, len(places)
    while low < high:
        middle = (low + high) // 2
        keeps = place_figures(study, law, places[middle], strong).disk_margin >= floor
        low, high = (low, middle) if keeps else (middle + 1, high)
    return places[low:]


def _full_order(study: Study, law: GainLaw, R_hat: Array, L_hat: Array, plants: _Plants) -> tuple[Array, Array]:
    """Decay (1/s) and disk margin of every plant; -infinity and 0 where there are no gains or there is no steady
    state."""
    gains = law(R_hat, L_hat, plants.P, plants.Q, plants.V_rms)
    cells = cell_set(study, plants.R_g, plants.L_g, plants.P, plants.Q, gains)
    model = full_order_cells(study, cells)
    index = np.flatnonzero(cells.good)[model.index]
    decay, margin = np.full(len(plants.P), -math.inf), np.zeros(len(plants.P))
    if len(index):
        omega = np.geomspace(_LOWEST_RAD_S, 0.999 * np.pi / model.T_s, _POINTS)
        decay[index] = -eigenvalues_of(model).real.max(axis=1)
        margin[index] = np.nan_to_num(margins_named(model, ["disk_output"], omega)["disk_output"].value, nan=0.0)
    return decay, margin


def _places(asked: Specification) -> list[Place]:
    """The places that are compared, by rising SCR. Their impedances have the middle of the grids' angles."""
    low, high = (math.atan(asked.x_over_r[k]) for k in (0, -1))
    x_over_r = _digits(math.tan(0.5 * (low + high)))
    scrs = np.geomspace(asked.scr[0], asked.scr[-1], _SCRS)
    return [Place(_digits(float(scr)), x_over_r, asked.scr_basis) for scr in scrs]


def _digits(value: float) -> float:
    """Four digits: what is shown is then what is used."""
    return float(f"{value:.4g}")


def _plants(study: Study, asked: Specification, *, scrs: int, x_over_rs: int, Ps: int, Qs: int) -> _Plants:
    """So many values of each, over the axes and the powers of a specification, within the static limits."""
    scr = np.geomspace(asked.scr[0], asked.scr[-1], scrs)
    x_over_r = np.geomspace(asked.x_over_r[0], asked.x_over_r[-1], x_over_rs)
    P, Q = (np.linspace(min(one), max(one), n) for one, n in ((asked.box.P, Ps), (asked.box.Q, Qs)))
    scr, x_over_r, P, Q = (values.ravel() for values in np.meshgrid(scr, x_over_r, P, Q, indexing="ij"))
    c, omega_g = study.converter, study.grid_source.omega_g
    R_g, L_g = SCR_BASES[asked.scr_basis].grid(scr, x_over_r, c.Z_base, c.omega_n)
    R, X = R_g + study.filter.R_2, omega_g * (L_g + study.filter.L_2)
    with np.errstate(invalid="ignore"):
        V_rms, delta = operating_point(P, Q, study.grid_source.V_g_rms, R, X)
        uses = static_limit_uses(study, R, X, omega_g, P, Q, V_rms)
        good = np.all([use <= 1.0 for use in uses.values()], axis=0)
    return _Plants(R_g, L_g, P, Q, V_rms, delta).take(good)


def _grids(study: Study, places: list[Place]) -> tuple[Array, Array]:
    grids = [place.grid(study.converter) for place in places]
    return np.array([grid.R_g for grid in grids]), np.array([grid.L_g for grid in grids])


def _source(asked: Specification) -> GridSource:
    """The source in the middle of what is asked for."""
    V, omega = ((min(one) + max(one)) / 2.0 for one in (asked.box.V_g_rms, asked.box.omega_g))
    return GridSource(V, omega)


def _of_design(study: Study, spec: ControllerSpec) -> Study:
    """The study with nothing but what the safe place depends on, so that equal designs are searched once."""
    asked: Any = study.specification
    fields: dict[str, Any] = dict.fromkeys(("name", "title", "source", "hash"), "")
    fields |= dict.fromkeys(("estimator", "inner_request", "verification", "background", "sensors", "replay"))
    return replace(
        study.with_limit_of(spec),
        **fields,
        grid=middle_place(asked).grid(study.converter),
        grid_source=_source(asked),
        scr_basis=asked.scr_basis,
        network=PLAIN,
        target=spec.target,
        controllers=(),
        events=(),
        simulation=replace(study.simulation, duration=1.0, log_interval=1.0, csv_interval=1.0, P_ref=0.0, Q_ref=0.0),
        survival=SurvivalSpec(),
        files=(),
        origin=None,
    )


@functools.lru_cache(maxsize=64)
def _closed_form_place(study: Study, measured: bool) -> Place:
    return safe_place(study, ControllerGains(closed_form_schedule(study, study.target), None, measured))


FEWEST = 50
"""With fewer answers a bin says nothing."""

SETTLED = 0.95
"""After a jump the estimate counts as inside from when on it is for so many of the jumps."""

_EDGE = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class InsideSet:
    """Shares of the time, or of the jumps, with the estimate inside the set."""

    shares: Array
    """(n, m) at rest, at the table's nodes; NaN where nothing was measured."""
    answers: NDArray[np.int64]
    """(n, m) answers behind each share."""
    since: tuple[tuple[float, float], ...]
    """Time since a jump, s, and share of the jumps; over all grids that were measured."""
    jumps: int

    @property
    def known(self) -> int:
        """Nodes at which something was measured."""
        return int(np.isfinite(self.shares).sum())

    @property
    def worst(self) -> tuple[int, int] | None:
        """The node of the smallest share; None where none is known."""
        if self.known == 0:
            return None
        i, j = np.unravel_index(int(np.nanargmin(self.shares)), self.shares.shape)
        return int(i), int(j)

    @property
    def settled_s(self) -> float | None:
        """When the share since a jump has come to SETTLED for good, s; None where it never has."""
        after = [t_s for t_s, share in self.since if share < SETTLED]
        later = [t_s for t_s, _ in self.since if not after or t_s > after[-1]]
        return later[0] if later else None


def within(errors: Array, error: float, error_Z: float) -> NDArray[np.bool_]:
    """(n,), which of the errors (n, 3) of R and X, with R of the true grid, each over |Z|, lie in the set. NaN does
    not."""
    R = errors[:, 2]
    X = np.sqrt(np.maximum(1.0 - R * R, 0.0))
    w_R, w_X = error_half_widths(R, X, error, error, error_Z)
    with np.errstate(invalid="ignore"):
        return (np.abs(errors[:, 0]) <= w_R) & (np.abs(errors[:, 1]) <= w_X)


def inside_set(table: GainTable, measured: MeasuredErrors) -> InsideSet:
    """Measured errors against the set of a table, node by node: the worst of the bins that a node lies in."""
    error, error_Z = table.validity.error, table.validity.error_Z
    R_g, L_g = table_grids(table)
    base = table.base
    Z_base = base_impedance(base.S_rated, base.V_rated_rms)
    scr = SCR_BASES["impedance"].scr(R_g, L_g, Z_base, base.omega_n)
    ratio = base.omega_n * L_g / R_g
    shares, answers = np.full(table.shape, np.nan), np.zeros(table.shape, dtype=np.int64)
    for one in measured.bins:
        if len(one.errors) < FEWEST:
            continue
        share = float(within(one.errors, error, error_Z).mean())
        here = _between(scr, one.scr) & _between(ratio, one.x_over_r) & ~(shares <= share)
        shares[here], answers[here] = share, len(one.errors)
    since = tuple(
        (one.t_s, float(within(one.errors, error, error_Z).mean())) for one in measured.jumps if len(one.errors)
    )
    jumps = max((len(one.errors) for one in measured.jumps), default=0)
    return InsideSet(shares=shares, answers=answers, since=since, jumps=jumps)


def inside_run(
    table: GainTable,
    truth: tuple[Array, Array],
    estimate: tuple[Array, Array],
    rest: NDArray[np.bool_],
) -> tuple[float, float]:
    """Shares of the answers of a run that are inside a table's set: of those at rest, (n,), and of all.

    ``truth``, ``estimate``: R_g (Ω) and L_g (H) at each answer, (n,). Where there is no estimate the last one holds;
    before the first there is none, and it is not inside. NaN where there is no such answer.
    """
    omega = table.base.omega_n
    held = np.maximum.accumulate(
        np.where(np.isfinite(estimate[0]) & np.isfinite(estimate[1]), np.arange(len(rest)), -1)
    )
    R_hat, L_hat = (np.where(held >= 0, values[np.maximum(held, 0)], np.nan) for values in estimate)
    size = np.hypot(truth[0], omega * truth[1])
    errors = np.stack([R_hat - truth[0], omega * (L_hat - truth[1]), truth[0]], axis=1) / size[:, None]
    inside = within(errors, table.validity.error, table.validity.error_Z)
    share, whole = (float(rows.mean()) if len(rows) else float("nan") for rows in (inside[rest], inside))
    return share, whole


def _between(values: Array, limits: tuple[float, float]) -> NDArray[np.bool_]:
    return (values >= limits[0] * (1.0 - _EDGE)) & (values <= limits[1] * (1.0 + _EDGE))
