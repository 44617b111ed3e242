"""What a controller is held to in random cases, and from the results of a block of runs to its summary."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.verification.summary import (
    BROKEN,
    MAP,
    WORST,
    BrokenCase,
    CaseFigures,
    FamilyCount,
    PromiseCount,
    Summary,
    binned,
    worst_of,
)
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.linear.operating_point.many import DC_FAULTS, FAULTS
from vsgdesign.metrics.met import most_overshoot, most_settling_time
from vsgdesign.metrics.survival import HARDWARE_PU
from vsgdesign.simulation.lanes.cases import REACTIVE, LaneCases
from vsgdesign.simulation.lanes.results import IN_NOISE, JUDGED, NO_REST, OVER_LIMIT, STATUSES
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

LEFT_OUT = (NO_REST, OVER_LIMIT, IN_NOISE)
"""Statuses of cases that no converter is asked for, and of those that nobody can judge: they are counted apart."""


class Results(Protocol):
    """What a batch of N runs gives: arrays (N,), among them one for each figure."""

    @property
    def status(self) -> NDArray[np.int8]:
        """Index of :data:`vsgdesign.simulation.lanes.results.STATUSES`."""
        ...

    @property
    def fault(self) -> NDArray[np.int8]:
        """Index of :data:`vsgdesign.linear.operating_point.many.FAULTS`, where there is no rest."""
        ...

    @property
    def noise(self) -> Array:
        """What noise may do to the overshoot of a step, as a share of it; NaN or 0 where it is judged without."""
        ...


@dataclass(frozen=True, kw_only=True)
class MapAxes:
    """The bins of the map over the box of grids: MAP[0] of SCR and MAP[1] of X/R, equal in the logarithm."""

    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    scr_basis: str

    @property
    def scr_edges(self) -> tuple[float, ...]:
        """MAP[0] + 1 edges, ascending."""
        return _edges(*self.scr, MAP[0])

    @property
    def x_over_r_edges(self) -> tuple[float, ...]:
        """MAP[1] + 1 edges, ascending."""
        return _edges(*self.x_over_r, MAP[1])

    def bins(self, converter: Converter, R_g: Array, L_g: Array) -> NDArray[np.intp]:
        """The bin of each grid (N,), as an index of the raveled map. A grid outside belongs to the nearest bin."""
        scr = SCR_BASES[self.scr_basis].scr(R_g, L_g, converter.Z_base, converter.omega_n)
        with np.errstate(divide="ignore"):
            x_over_r = converter.omega_n * L_g / R_g
        k = np.searchsorted(np.array(self.scr_edges[1:-1]), scr, side="right")
        m = np.searchsorted(np.array(self.x_over_r_edges[1:-1]), x_over_r, side="right")
        return k * MAP[1] + m


def _edges(low: float, high: float, count: int) -> tuple[float, ...]:
    inner = (low * (high / low) ** (k / count) for k in range(1, count))
    return (low, *inner, high)


def last_grids(cases: LaneCases) -> tuple[Array, Array]:
    """R_g and L_g (N,) after the last change: the grid on which each case comes to rest."""
    R_g, L_g = cases.R_g.copy(), cases.L_g.copy()
    for k in range(cases.events.count):
        changed = np.isfinite(cases.events.t_s[:, k]) & np.isfinite(cases.events.R_g[:, k])
        R_g = np.where(changed, cases.events.R_g[:, k], R_g)
        L_g = np.where(changed, cases.events.L_g[:, k], L_g)
    return R_g, L_g


def figures_of(results: Results) -> Array:
    """Every figure of FIGURES as a column, (N, figures)."""
    return np.stack([np.asarray(getattr(results, name), dtype=float) for name in FIGURES], axis=1)


def judged_values(promise: Promise, status: NDArray[np.int8], figures: Array) -> Array:
    """The figure of a promise (N,), infinite where it does not exist: what a case that never settles has."""
    values = figures[:, tuple(FIGURES).index(promise.figure)]
    if promise.survival:
        values = np.where(status == JUDGED, values, math.inf)
    return np.where(np.isnan(values), math.inf, values)


def count_block(
    number: int,
    first: int,
    cases: LaneCases,
    family: NDArray[np.int8],
    results: Results,
    *,
    names: Sequence[str],
    promises: Sequence[Promise],
    axes: MapAxes,
    converter: Converter,
    instruction_set: str,
) -> Summary:
    """The summary of block ``number``, whose cases have the numbers from ``first`` on. ``names``: of the families."""
    status = np.asarray(results.status)
    figures = figures_of(results)
    bins = axes.bins(converter, *last_grids(cases))
    judged = ~np.isin(status, LEFT_OUT)
    families: dict[str, FamilyCount] = {}
    broken: list[BrokenCase] = []
    for k, name in enumerate(names):
        drawn = family == k
        if not drawn.any():
            continue
        asked = np.flatnonzero(drawn & judged)
        held = [promise for promise in promises if name in promise.families]
        found = {p.name: judged_values(p, status[asked], figures[asked]) for p in held}
        noise = np.asarray(results.noise)[asked]
        most = {p.name: p.most_of(cases.signal[asked], noise) for p in held}
        misses = {p.name: ~(found[p.name] <= most[p.name]) for p in held}
        any_broken = np.any(list(misses.values()), axis=0) if held else np.zeros(len(asked), bool)
        survives = any(promise.survival for promise in held)
        peaks = figures[asked, tuple(FIGURES).index("peak_pu")]
        beyond = asked[(peaks > HARDWARE_PU) & (status[asked] == JUDGED)] if survives else asked[:0]
        families[name] = FamilyCount(
            drawn=int(drawn.sum()),
            judged=len(asked),
            left_out=_reasons(status[drawn & ~judged], np.asarray(results.fault)[drawn & ~judged]),
            lost=_counts(status[asked][status[asked] != JUDGED]),
            beyond=len(beyond),
            beyond_worst=_beyond(first + beyond, figures[beyond]),
            broken=int(any_broken.sum()),
            promises={
                p.name: replace(
                    _promise(found[p.name], most[p.name], first + asked, status[asked], figures[asked], bins[asked]),
                    noise=float(np.nan_to_num(noise).max(initial=0.0)) if p.figure == "overshoot" else 0.0,
                )
                for p in sorted(held, key=lambda promise: promise.name)
            },
            judged_map=np.bincount(bins[asked], minlength=MAP[0] * MAP[1]).reshape(MAP),
            broken_map=np.bincount(bins[asked[any_broken]], minlength=MAP[0] * MAP[1]).reshape(MAP),
        )
        for j in np.flatnonzero(any_broken)[:BROKEN].tolist():
            which = tuple(p.name for p in held if misses[p.name][j])
            at = int(asked[j])
            broken.append(BrokenCase(first + at, name, which, STATUSES[status[at]], tuple(figures[at].tolist())))
    return Summary(
        blocks=(number,),
        instruction_sets=(instruction_set,),
        families=dict(sorted(families.items())),
        broken=tuple(sorted(broken)[:BROKEN]),
    )


def _beyond(numbers: NDArray[np.intp], figures: Array) -> tuple[CaseFigures, ...]:
    """Those survived cases with the largest currents, which hardware does not carry."""
    peaks = figures[:, tuple(FIGURES).index("peak_pu")] / HARDWARE_PU
    rows = zip(numbers.tolist(), peaks.tolist(), figures.tolist(), strict=True)
    return worst_of(CaseFigures(number, peak, STATUSES[JUDGED], tuple(own)) for number, peak, own in rows)


def _promise(
    values: Array,
    most: Array,
    index: NDArray[np.intp],
    status: NDArray[np.int8],
    figures: Array,
    bins: NDArray[np.intp],
) -> PromiseCount:
    worst_map = np.full(MAP[0] * MAP[1], -math.inf)
    np.maximum.at(worst_map, bins, values)
    severity = values / most
    order = np.lexsort((index, -severity))[:WORST]
    return PromiseCount(
        broken=int((~(values <= most)).sum()),
        worst=worst_of(
            CaseFigures(int(index[j]), float(severity[j]), STATUSES[status[j]], tuple(figures[j].tolist()))
            for j in order
        ),
        bins=binned(values),
        worst_map=worst_map.reshape(MAP),
    )


def _reasons(status: NDArray[np.int8], fault: NDArray[np.int8]) -> Mapping[str, int]:
    """How many cases are left out for which reason."""
    told = DC_FAULTS  # the dc side cannot, which is no limit of a current
    said = [
        FAULTS[f] if f in told or (s == NO_REST and f > 0) else STATUSES[s] for s, f in zip(status, fault, strict=True)
    ]
    return {name: said.count(name) for name in sorted(set(said))}


def _counts(status: NDArray[np.int8]) -> Mapping[str, int]:
    found, counts = np.unique(status, return_counts=True)
    return dict(sorted((STATUSES[k], int(count)) for k, count in zip(found, counts, strict=True)))


FIGURES = {
    "overshoot": "1",
    "settling_s": "s",
    "recovery_s": "s",
    "peak_pu": "pu",
    "first_peak_pu": "pu",
    "above_s": "s",
    "limited_s": "s",
    "swing_rad": "rad",
}
"""Every figure of a case with its unit, as the batch runner measures them. The overshoot is a share of the step."""

LIMIT_ROOM = 1.05
"""How far the current may be above its limit later than 5 ms after an event: the switched bridge's ripple, and what a
sampled loop overshoots."""


@dataclass(frozen=True, kw_only=True)
class Promise:
    """One limit that a figure has to keep in every case of some families."""

    name: str
    figure: str
    """A name of :data:`FIGURES`."""
    limit: float
    """What is asked for, in the figure's unit."""
    families: tuple[str, ...]
    limit_Q: float | None = None
    """What is asked of a step of Q_ref, where that is another value."""
    survival: bool = False
    """Whether a case that is not survived breaks it, whatever the figure says."""

    @property
    def unit(self) -> str:
        """Unit of the limit."""
        return FIGURES[self.figure]

    @property
    def most(self) -> float:
        """Largest value that keeps it (:mod:`vsgdesign.metrics.met`); of a step of P_ref, where ``limit_Q`` differs."""
        return self._most(self.limit)

    def most_of(self, signal: NDArray[np.int8], noise: Any = 0.0) -> NDArray[np.float64]:
        """Largest value that keeps it in each case, (N,). ``signal``: which reference a case steps; ``noise``: what
        noise may do to its overshoot, as a share of the step."""
        of_Q = self.most if self.limit_Q is None else self._most(self.limit_Q)
        more = np.nan_to_num(noise) if self.figure == "overshoot" else 0.0
        return np.where(np.asarray(signal) == REACTIVE, of_Q, self.most) + more

    def _most(self, limit: float) -> float:
        if self.figure == "settling_s":
            return float(most_settling_time(limit))
        return float(most_overshoot(limit)) if self.figure == "overshoot" else limit


def verified_promises(
    study: Study, spec: ControllerSpec, ready: Ready, families: Mapping[str, bool]
) -> tuple[Promise, ...]:
    """The promises of a controller. ``families``: whether the cases of a family are steps, by its name.

    A step keeps the overshoot and the settling time that the page of a run holds the controller to
    (:func:`vsgdesign.simulation.scenario.judging.promises_of`), by the same rule (:mod:`vsgdesign.metrics.met`). Any
    other case is survived: the converter is at its new rest in 2 T + 0.2 s, as in docs/survival.md. If the current
    is limited, it is at most 5 % above its limit later than 5 ms after an event.
    """
    from vsgdesign.simulation.scenario.judging import promises_of

    steps = tuple(name for name, step in families.items() if step)
    others = tuple(name for name, step in families.items() if not step)
    asked, found = promises_of(study, spec, ready), []
    if steps and asked.overshoot_pct is not None:
        limit, limit_Q = _share(asked.overshoot_pct), _share(asked.overshoot_Q_pct or 0.0)
        differs = None if limit_Q == limit else limit_Q
        found.append(Promise(name="overshoot", figure="overshoot", limit=limit, limit_Q=differs, families=steps))
    if steps and asked.settling_time is not None:
        found.append(Promise(name="settling", figure="settling_s", limit=asked.settling_time, families=steps))
    if others:
        limit = demand_of(study.converter, settling_time_of(spec, ready)).deadline_s
        found.append(Promise(name="survival", figure="recovery_s", limit=limit, families=others, survival=True))
    limit_pu = study.with_limit_of(spec).converter.current_limit_pu
    if limit_pu is not None:
        found.append(Promise(name="current", figure="peak_pu", limit=LIMIT_ROOM * limit_pu, families=tuple(families)))
    return tuple(found)


def _share(pct: float) -> float:
    """A share of a percentage, in twelve digits: an exponential in it may differ in the last one between machines."""
    return float(f"{pct / 100.0:.12g}")
