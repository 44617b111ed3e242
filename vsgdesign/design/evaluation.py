"""Figures of many designs in all scenarios of a cell, from the coupled model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.box import Scenarios
from vsgdesign.design.kernels import FIGURES, figures
from vsgdesign.equations.power_flow import Lags, scheduled_jacobian, source_behind
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.signals import interrupts_deferred
from vsgdesign.linear.model.coupled import CoupledModel, coupled_model
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.margins import margins_named
from vsgdesign.metrics.met import overshoot_met, settling_met
from vsgdesign.metrics.modes import least_damping
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.study import ClosedFormTarget, Study


@dataclass(frozen=True, kw_only=True)
class Figures:
    """The worst of a design over a cell's scenarios; fractions, s, and 1/s."""

    overshoot_P: float
    settling_P: float
    overshoot_Q: float
    settling_Q: float
    cross_peak: float
    """Largest of the other power, per unit step."""
    disk_margin: float
    damping_ratio: float
    abscissa: float
    differential_decay: float = math.inf
    """Of the differential mode of equal units, 1/s; infinite where nobody asks."""

    @property
    def overshoot(self) -> float:
        """Of either power after a step of its own reference."""
        return max(self.overshoot_P, self.overshoot_Q)

    @property
    def settling_time(self) -> float:
        """Of either power after a step of its own reference."""
        return max(self.settling_P, self.settling_Q)


def worst(e: Evaluation, design: int = 0) -> Figures:
    """The worst figures of one evaluated design."""
    at = {name: values[design] for name, values in e.figures.items()}
    steps = {name: float(at[name].max()) for name in ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q")}
    return Figures(
        **steps,
        cross_peak=float(np.maximum(at["cross_P"], at["cross_Q"]).max()),
        disk_margin=float(at["disk_margin"].min()),
        damping_ratio=float(e.damping_ratio[design].min()),
        abscissa=float(e.abscissa[design].max()),
        differential_decay=math.inf if e.differential is None else -float(e.differential[design].max()),
    )


def worse(one: Figures, other: Figures) -> Figures:
    """The worse of two of each figure."""
    low = ("disk_margin", "damping_ratio", "differential_decay")
    values = {f.name: (getattr(one, f.name), getattr(other, f.name)) for f in fields(Figures)}
    return Figures(**{name: min(pair) if name in low else max(pair) for name, pair in values.items()})


def shortfalls(spec: Specification, f: Figures, inertia: float) -> dict[str, float]:
    """Promises that figures do not keep, each with the value that would have to be allowed."""
    missed: dict[str, float] = {}
    if spec.settles and not overshoot_met(f.overshoot, spec.overshoot):
        missed["overshoot"] = f.overshoot
    if spec.settles and not settling_met(f.settling_time, spec.settling_time):
        missed["settling_time"] = f.settling_time
    if not f.disk_margin >= spec.disk_margin:
        missed["disk_margin"] = f.disk_margin
    if not f.damping_ratio >= spec.damping_ratio:
        missed["damping_ratio"] = f.damping_ratio
    if not f.differential_decay >= spec.differential_decay:
        missed["differential_decay"] = f.differential_decay
    if inertia < spec.H_min * (1.0 - 1e-9):
        missed["H_min"] = inertia
    if inertia > spec.H_max * (1.0 + 1e-9):
        missed["H_max"] = inertia
    return missed


Array = NDArray[np.float64]

_NEAR, _MOST_NEAR = 1.03, 8
"""Scenarios whose disk margin is computed anew: those within three per cent of the least, and at most so many."""


def exact_disk_margins(found: Array, model_of: Callable[[NDArray[np.intp]], CoupledModel | FullOrderModel]) -> Array:
    """Disk margins at the output (S,) of stable scenarios whose least is exact, from those that a few frequencies gave.

    These are never too small, and too large by half a per cent at most (by 28 frequencies) in what was compared. The
    smallest ones are computed anew, by the function that all pages use. ``model_of`` makes the models of scenarios.
    """
    least = float(found.min())
    if not least > 0.0:
        return found
    near = np.argsort(found, kind="stable")[:_MOST_NEAR]
    near = near[found[near] <= _NEAR * least]
    exact = found.copy()
    exact[near] = margins_named(model_of(near), ["disk_output"])["disk_output"].value
    return exact


def exact_worst(e: Evaluation, design: int, gains: PowerLoopGains, s: Scenarios, lags: Lags) -> Figures:
    """:func:`worst` with the least of :func:`exact_disk_margins`. ``gains`` (S,) are those of the design, ``lags``
    those of the study."""

    def model_of(index: NDArray[np.intp]) -> CoupledModel:
        every = PowerLoopGains(*(np.broadcast_to(np.asarray(value, dtype=float), s.P.shape)[index] for value in gains))
        return model_in(every, s.take(index), lags)

    return replace(worst(e, design), disk_margin=float(exact_disk_margins(e["disk_margin"][design], model_of).min()))


_FREQUENCIES = np.geomspace(0.5, 400.0, 28)
"""Where the disk margin is looked at while searching, over the settling time's inverse."""


@dataclass(frozen=True, kw_only=True)
class LawOfStudy:
    """What makes gains of normalised parameters: the structure, its law, the droops and the ratings."""

    structure: str
    law: str
    """``poles`` or ``inertia``."""
    D_p: float
    D_q: float
    S_rated: float
    omega_n: float
    lags: Lags
    apart: tuple[float, float] | None = None
    """R (Ω) and L (H) of the path between equal units, where the decay of their differential mode is asked for."""

    def gains(self, normalised: NormalisedGains, s: Scenarios) -> PowerLoopGains:
        """The gains that the runtime has in each scenario: estimated grid, measured P, Q, V. Arrays broadcast."""
        A, B, C, D = scheduled_jacobian(s.P, s.Q, s.V_rms, s.R_hat, s.X_hat)
        return self.gains_of_jacobian(A, B, C, D, normalised)

    def gains_of_jacobian(self, A: Any, B: Any, C: Any, D: Any, normalised: NormalisedGains) -> PowerLoopGains:
        """Gains of a Jacobian (:eq:`structure-gains`); also of symbols."""
        by_inertia = self.law == "inertia"
        structure = STRUCTURES[self.structure]
        return structure.gains(A, B, C, D, normalised, self.D_p, self.D_q, self.S_rated, self.omega_n, by_inertia)


def law_of(study: Study, target: ClosedFormTarget, aim: str) -> LawOfStudy:
    """The law of a controller's target under a specification's aim."""
    c = study.converter
    droops = target.P_droop, target.Q_droop
    D_p, D_q = STRUCTURES[target.structure].rated_droops(*droops, c.S_rated, c.omega_n, c.V_rated_rms)
    return LawOfStudy(
        structure=target.structure,
        law="inertia" if aim == "inertia" else "poles",
        D_p=D_p,
        D_q=D_q,
        S_rated=c.S_rated,
        omega_n=c.omega_n,
        lags=study.power_lags,
        apart=apart_of(study),
    )


def apart_of(study: Study) -> tuple[float, float] | None:
    """The path between equal units at one node, where a study asks for the decay of their differential mode: that of a
    unit alone on an ideal source at the node (:eq:`differential-mode`)."""
    asked, f = study.specification, study.filter
    if asked is None or asked.differential_decay == 0.0:
        return None
    if f.L_2 == 0.0:
        raise InfeasibleStudyError(
            f"specification: differential_decay = {asked.differential_decay:g} 1/s, but nothing lies between units of "
            "an LC filter at one node. Give the unit's transformer and feeder: reactance of [plant], or L_2 and R_2 of "
            "[filter]; or ask for a decay of 0."
        )
    return f.R_2, f.L_2


@dataclass(frozen=True)
class Evaluation:
    """FIGURES by name and figures of the modes: of M designs in S scenarios, (M, S) each, or of S pairs, (S,)."""

    figures: dict[str, Array]
    damping_ratio: Array
    """Least over the modes."""
    abscissa: Array
    """Largest real part, 1/s."""
    differential: Array | None = None
    """The same of the differential mode; None where nobody asks."""

    def __getitem__(self, name: str) -> Array:
        return self.damping_ratio if name == "damping_ratio" else self.figures[name]


def final_Q(J: Array, D_q: Array) -> Array:
    """ΔQ after a unit step of Q_ref: with P held, V and Q move along the grid's line, and droop keeps its share."""
    stiffness = J[:, 1, 1] - J[:, 1, 0] * J[:, 0, 1] / J[:, 0, 0]
    return stiffness / (stiffness + D_q)


def evaluate(law: LawOfStudy, designs: NormalisedGains, s: Scenarios, settling_time: float) -> Evaluation:
    """Figures (M, S) of M designs (arrays of shape (M,), or scalars for one) in S scenarios each."""
    every, repeated, shape = _crossed(designs, s)
    return _shaped(evaluate_pairs(law, NormalisedGains(*every), repeated, settling_time), shape)


def evaluate_fixed(gains: PowerLoopGains, s: Scenarios, settling_time: float, lags: Lags) -> Evaluation:
    """Figures (M, S) of M sets of gains (arrays of shape (M,), or scalars for one), each the same in S scenarios."""
    every, repeated, shape = _crossed(gains, s)
    return _shaped(evaluate_gains(PowerLoopGains(*every), repeated, settling_time, lags), shape)


def evaluate_pairs(law: LawOfStudy, normalised: NormalisedGains, s: Scenarios, settling_time: float) -> Evaluation:
    """Figures (S,) of one design per scenario: ``normalised`` holds arrays (S,)."""
    gains = law.gains(normalised, s)
    found = evaluate_gains(gains, s, settling_time, law.lags)
    if law.apart is None:
        return found
    every = PowerLoopGains(*(np.broadcast_to(np.asarray(value, dtype=float), s.P.shape) for value in gains))
    A = model_in(every, between_units(s, *law.apart), law.lags).A
    return replace(found, differential=np.linalg.eigvals(A).real.max(axis=1))


def between_units(s: Scenarios, R: float, L: float) -> Scenarios:
    """The differential mode of scenarios: their powers and voltage with the path between the units alone."""
    X = s.omega_g * L
    V_g_rms, delta = source_behind(s.P, s.Q, s.V_rms, R, X)
    return replace(s, R=0.0 * X + R, X=X, V_g_rms=V_g_rms, delta=delta)


def evaluate_gains(gains: PowerLoopGains, s: Scenarios, settling_time: float, lags: Lags) -> Evaluation:
    """Figures (S,) of one set of gains per scenario, arrays (S,) or scalars."""
    gains = PowerLoopGains(*(np.broadcast_to(np.asarray(value, dtype=float), s.P.shape) for value in gains))
    model = model_in(gains, s, lags)
    eigenvalues: Any = np.linalg.eigvals(model.A).astype(complex)
    abscissa = eigenvalues.real.max(axis=1)
    with interrupts_deferred():
        table = figures(
            model.A,
            np.ascontiguousarray(model.B[:, :, :2]),
            np.ascontiguousarray(model.C[:, :2]),
            model.A_o,
            model.B_o,
            model.C_o,
            model.J_o,
            final_Q(model.J, gains.D_q),
            abscissa < 0.0,
            settling_time,
            _FREQUENCIES / settling_time,
        )
    named = {name: table[:, k] for k, name in enumerate(FIGURES)}
    return Evaluation(named, least_damping(eigenvalues), abscissa)


def model_in(gains: PowerLoopGains, s: Scenarios, lags: Lags) -> CoupledModel:
    """The coupled model of each scenario with its gains, arrays (S,)."""
    return coupled_model(s.delta, s.V_rms, s.V_g_rms, s.R, s.X, gains, lags=lags)


def _crossed(designs: Iterable[Any], s: Scenarios) -> tuple[list[Array], Scenarios, tuple[int, int]]:
    """Every design with every scenario, row by row: values (M·S,), scenarios (M·S,), and (M, S)."""
    over = [np.asarray(value, dtype=float).reshape(-1, 1) for value in designs]
    shape = (max(len(value) for value in over), len(s))
    every = [np.broadcast_to(value, shape).ravel() for value in over]
    return every, Scenarios(*(np.broadcast_to(getattr(s, f.name), shape).ravel() for f in fields(Scenarios))), shape


def _shaped(found: Evaluation, shape: tuple[int, int]) -> Evaluation:
    return Evaluation(
        {name: values.reshape(shape) for name, values in found.figures.items()},
        found.damping_ratio.reshape(shape),
        found.abscissa.reshape(shape),
        None if found.differential is None else found.differential.reshape(shape),
    )
