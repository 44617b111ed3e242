"""Fixed, closed-form and table gains side by side, on the same grids under the same specification."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.design.box import NOMINAL, Scenarios, scenarios_of_truth
from vsgdesign.design.evaluation import Evaluation, Figures, evaluate_gains, exact_worst, shortfalls
from vsgdesign.design.single import FixedTuning
from vsgdesign.design.verification import full_order_figures
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES, effective_inertia
from vsgdesign.metrics.step_response import ResponseMetrics
from vsgdesign.runtime.of_study import ControllerGains, gain_law
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

STATES = ("kept", "kept_exact", "broken", "unstable")
"""Of a grid: every promise is kept with the estimate wrong as specified; with an exact estimate only; not even so,
but every loop is stable; unstable somewhere in the box, or without gains. With the real inner loops: the full-order
model and the coupled one both keep it."""

BEST_FIXED, GIVEN, CLOSED_FORM, TABLE = "best fixed", "fixed", "closed form", "table"


@dataclass(frozen=True)
class Contender:
    """One way to have gains: the same on every grid (``gains``), or those of a controller (``law``)."""

    name: str
    structure: str
    origin: str
    """``best fixed``, ``fixed``, ``closed form`` or ``table``."""
    droop: float
    """P–f droop that its structure is asked for, W·s/rad; 0: none is asked."""
    gains: PowerLoopGains | None = None
    law: ControllerGains | None = None

    def gains_in(self, s: Scenarios) -> PowerLoopGains:
        """The gains that it has in each scenario, arrays (S,); NaN where its schedule has none."""
        if self.law is None:
            chosen: Any = self.gains
        else:
            known = self.law.schedule
            R_hat, L_hat = s.R_hat - known.R_2, s.X_hat / known.omega - known.L_2
            chosen = self.law(R_hat, L_hat, s.P, s.Q, s.V_rms)
        return PowerLoopGains(*(np.broadcast_to(np.asarray(value, dtype=float), s.P.shape) for value in chosen))


@dataclass(frozen=True, kw_only=True)
class GridFigures:
    """A contender on one grid. ``exact``, ``wrong``: the worst over the powers with an exact estimate and over the
    estimate's error too, coupled model; None without gains. ``real_*``: the same of the full-order model, None where it
    was not looked at, as the coupled model breaks the promise already. ``missed_*``: the promises that are not kept
    with ideal inner loops, ``lost_*``: with the real ones, each with what is reached."""

    scr: float
    x_over_r: float
    exact: Figures | None
    wrong: Figures | None
    missed_exact: dict[str, float]
    missed_wrong: dict[str, float]
    real_exact: Figures | None
    real_wrong: Figures | None
    lost_exact: dict[str, float]
    lost_wrong: dict[str, float]
    D_p: float
    """P–f droop, W·s/rad, at the design point."""
    inertia: float
    """H in s there (:eq:`effective-inertia`)."""

    @property
    def ideal_state(self) -> str:
        """One of STATES, with ideal inner loops."""
        return _state((self.exact, self.wrong), self.missed_exact, self.missed_wrong)

    @property
    def state(self) -> str:
        """One of STATES, with the real inner loops."""
        if self.ideal_state == "unstable":
            return "unstable"
        if any(f is not None and not f.abscissa < 0.0 for f in (self.real_exact, self.real_wrong)):
            return "unstable"
        exact, wrong = self.missed_exact | self.lost_exact, self.missed_wrong | self.lost_wrong
        return "broken" if exact else "kept_exact" if wrong else "kept"


def _state(sides: Sequence[Figures | None], missed_exact: dict[str, float], missed_wrong: dict[str, float]) -> str:
    if any(f is None or not f.abscissa < 0.0 for f in sides):
        return "unstable"
    return "broken" if missed_exact else "kept_exact" if missed_wrong else "kept"


@dataclass(frozen=True)
class EmtStep:
    """A step in EMT with the real inner loops; ``response`` None: unstable, or not settled in time."""

    scr: float
    x_over_r: float
    signal: str
    response: ResponseMetrics | None


@dataclass(frozen=True)
class Compared:
    """A contender with everything that was found of it."""

    contender: Contender
    grids: tuple[GridFigures, ...]
    emt: tuple[EmtStep, ...] = ()
    tuning: FixedTuning | None = None

    def share(self, *states: str, ideal: bool = False) -> float:
        """Share of the grids in any of the given states, with the real inner loops or with ideal ones."""
        found = sum((grid.ideal_state if ideal else grid.state) in states for grid in self.grids)
        return found / max(len(self.grids), 1)

    def broken(self) -> dict[str, int]:
        """On how many grids each promise is not kept with an exact estimate and the real inner loops, most first."""
        counts: dict[str, int] = {}
        for grid in self.grids:
            unstable = any(f is None or not f.abscissa < 0.0 for f in (grid.exact, *_looked_at(grid.real_exact)))
            for name in ["unstable"] if unstable else {**grid.missed_exact, **grid.lost_exact}:
                counts[name] = counts.get(name, 0) + 1
        return dict(sorted(counts.items(), key=lambda item: -item[1]))

    def worst(self, name: str, wrong: bool) -> float:
        """The worst of a figure over all grids; infinite (0 for margins) where a grid is unstable or has no gains."""
        large = name not in ("disk_margin", "damping_ratio")
        values = []
        for grid in self.grids:
            f = grid.wrong if wrong else grid.exact
            bad = f is None or not f.abscissa < 0.0
            values.append((np.inf if large else 0.0) if bad else getattr(f, name))
        return float(max(values) if large else min(values))


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All contenders on the same grids. ``outside``: grids on which nothing is asked, (SCR, X/R)."""

    study: Study
    specification: Specification
    scr: tuple[float, ...]
    x_over_r: tuple[float, ...]
    contenders: tuple[Compared, ...]
    outside: tuple[tuple[float, float], ...]
    seed: int


def comparison_axes(spec: Specification) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """SCR and X/R to compare on: the specification's nodes and the geometric means of neighbours."""

    def refined(axis: tuple[float, ...]) -> tuple[float, ...]:
        middles = [float(f"{np.sqrt(a * b):.4g}") for a, b in itertools.pairwise(axis)]
        return tuple(sorted({*axis, *middles}))

    return refined(spec.scr), refined(spec.x_over_r)


def contender_of(study: Study, spec: ControllerSpec, ready: Ready = NOTHING) -> Contender:
    """A controller of the study as a contender. Raises InfeasibleStudyError for gains that cannot be had."""
    target, c = spec.target, study.converter
    droops = target.P_droop, target.Q_droop
    droop, _ = STRUCTURES[target.structure].rated_droops(*droops, c.S_rated, c.omega_n, c.V_rated_rms)
    law = gain_law(study, spec, ready)
    if law.fixed is not None:
        return Contender(spec.name, target.structure, GIVEN, droop, gains=law.fixed)
    return Contender(spec.name, target.structure, TABLE if spec.schedule == "table" else CLOSED_FORM, droop, law=law)


def compare_on_grids(
    study: Study, spec: Specification, contender: Contender, grids: Sequence[tuple[float, float]]
) -> tuple[GridFigures, ...]:
    """A contender's figures on every grid (SCR, X/R) that the specification asks about.

    From the coupled model, and from the full-order one with an exact estimate, with a wrong one where the coupled model
    keeps it: a grid that does not keep a promise with ideal inner loops does not keep it with real ones.
    """
    found = [_sides(study, spec, scr, x_over_r) for scr, x_over_r in grids]
    kept = [(grid, sides) for grid, sides in zip(grids, found, strict=True) if sides is not None]
    if not kept:
        return ()
    boxes = [box for _, sides in kept for box in sides]
    joined = Scenarios(*(np.concatenate([getattr(box, f.name) for box in boxes]) for f in fields(Scenarios)))
    gains = contender.gains_in(joined)
    usable = np.flatnonzero(np.all([np.isfinite(value) for value in gains], axis=0))
    part = evaluate_gains(
        PowerLoopGains(*(value[usable] for value in gains)),
        joined.take(usable),
        spec.settling_time,
        study.power_lags,
    )
    row_of = np.full(len(joined), -1)
    row_of[usable] = np.arange(len(usable))
    rows, start = [], 0
    c = study.converter
    for (scr, x_over_r), sides in kept:
        first = PowerLoopGains(*(float(value[start + NOMINAL]) for value in gains))
        inertia = effective_inertia(first, c.S_rated, c.omega_n)
        figures: list[Figures | None] = []
        real: list[Figures | None] = []
        missed: list[dict[str, float]] = []
        lost: list[dict[str, float]] = []
        for k, box in enumerate(sides):
            span = slice(start, start + len(box))
            index = row_of[span]
            start += len(box)
            own = _taken(gains, span)
            whole = None if (index < 0).any() else exact_worst(_part(part, index), 0, own, box, study.power_lags)
            figures.append(whole)
            missed.append({} if whole is None else shortfalls(spec, whole, inertia))
            seen = None
            if whole is not None and (k == 0 or not (missed[0] or lost[0] or missed[1])) and whole.abscissa < 0.0:
                seen = full_order_figures(study, own, box, spec.settling_time).worst()
            real.append(seen)
            lost.append({} if whole is None or seen is None else _lost(spec, whole, seen, inertia))
        rows.append(
            GridFigures(
                scr=scr,
                x_over_r=x_over_r,
                exact=figures[0],
                wrong=figures[1],
                missed_exact=missed[0],
                missed_wrong=missed[1],
                real_exact=real[0],
                real_wrong=real[1],
                lost_exact=lost[0],
                lost_wrong=lost[1],
                D_p=first.D_p,
                inertia=inertia,
            )
        )
    return tuple(rows)


def _taken(gains: PowerLoopGains, span: slice) -> PowerLoopGains:
    return PowerLoopGains(*(value[span] for value in gains))


def _looked_at(figures: Figures | None) -> tuple[Figures, ...]:
    return () if figures is None else (figures,)


def _lost(spec: Specification, ideal: Figures, real: Figures, inertia: float) -> dict[str, float]:
    """Promises that the real inner loops do not keep. How the network's and the filter's modes are damped is no promise
    of the power loops, as in the design."""
    seen = replace(real, damping_ratio=max(real.damping_ratio, ideal.damping_ratio))
    return shortfalls(spec, seen, inertia)


def _sides(study: Study, spec: Specification, scr: float, x_over_r: float) -> tuple[Scenarios, Scenarios] | None:
    """Scenarios of a grid without and with the estimate's error; None where nothing is asked of it."""
    P, Q = study.target.P, study.target.Q
    exact = replace(spec, box=spec.box.exact())
    sides = tuple(scenarios_of_truth(study, side, scr, x_over_r, P, Q) for side in (exact, spec))
    return None if len(sides[0]) == 0 else (sides[0], sides[1])


def nominal_powers(study: Study, spec: Specification, scr: float, x_over_r: float) -> tuple[float, float] | None:
    """The design point (P, Q) as far as a grid's limits allow it; None where it has none."""
    s = scenarios_of_truth(study, spec, scr, x_over_r, study.target.P, study.target.Q)
    return None if len(s) == 0 else (float(s.P[NOMINAL]), float(s.Q[NOMINAL]))


def gains_at(
    study: Study, spec: Specification, contender: Contender, scr: float, x_over_r: float, P: float, Q: float
) -> PowerLoopGains | None:
    """The gains that a contender has on a known grid at (P, Q), as numbers; None where it has none."""
    exact = replace(spec, box=replace(spec.box.exact(), P=(P,), Q=(Q,)))
    s = scenarios_of_truth(study, exact, scr, x_over_r, P, Q)
    if len(s) == 0:
        return None
    gains = PowerLoopGains(*(float(value[NOMINAL]) for value in contender.gains_in(s)))
    return gains if np.isfinite(gains).all() else None


def summary_of(compared: Compared) -> dict[str, Any]:
    """One row of the comparison: shares of grids, the worst of every figure, droop, inertia, EMT."""
    c, grids = compared.contender, compared.grids
    droop = [per_hz(grid.D_p) for grid in grids if np.isfinite(grid.D_p)]
    inertia = [grid.inertia for grid in grids if np.isfinite(grid.inertia)]
    responses = [step.response for step in compared.emt]
    settled = [r for r in responses if r is not None and r.settling_time_s is not None]
    figures = ("overshoot", "settling_time", "disk_margin", "damping_ratio")
    return {
        "name": c.name,
        "structure": c.structure,
        "origin": c.origin,
        "shares": {state: compared.share(state) for state in STATES},
        "kept_exact": compared.share("kept", "kept_exact"),
        "kept_wrong": compared.share("kept"),
        "shares_ideal": {state: compared.share(state, ideal=True) for state in STATES},
        "kept_exact_ideal": compared.share("kept", "kept_exact", ideal=True),
        "kept_wrong_ideal": compared.share("kept", ideal=True),
        "broken": compared.broken(),
        "worst_exact": {name: compared.worst(name, False) for name in figures},
        "worst_wrong": {name: compared.worst(name, True) for name in figures},
        "droop_W_per_Hz": _range(droop),
        "droop_asked_W_per_Hz": per_hz(c.droop) if c.droop > 0.0 else None,
        "inertia_s": _range(inertia),
        "emt": {
            "steps": len(responses),
            "not_settled": len(responses) - len(settled),
            "overshoot": max((r.overshoot_pct or 0.0 for r in settled), default=float("nan")) / 100.0,
            "settling_time": max((r.settling_time_s or 0.0 for r in settled), default=float("nan")),
        },
    }


def per_hz(D_p: float) -> float:
    """W per Hz of a droop in W·s/rad."""
    return float(2.0 * np.pi * D_p)


def _range(values: Sequence[float]) -> tuple[float, float] | None:
    return (min(values), max(values)) if values else None


def _part(e: Evaluation, index: NDArray[Any]) -> Evaluation:
    return Evaluation(
        {name: values[None, index] for name, values in e.figures.items()},
        e.damping_ratio[None, index],
        e.abscissa[None, index],
    )
