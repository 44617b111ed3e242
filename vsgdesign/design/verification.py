"""What a design does with the inner loops, the filters and the delay: full-order figures in every scenario."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.box import Scenarios
from vsgdesign.design.evaluation import Figures, exact_disk_margins, final_Q
from vsgdesign.design.kernels import HORIZON
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS
from vsgdesign.linear.operating_point.dc_rest import links_at_rest
from vsgdesign.linear.operating_point.full_order import Cell, FullOrderModel, linearise_full_order, steady_cells
from vsgdesign.linear.stability.loops import FullOrderLoop
from vsgdesign.linear.stability.modes_of_units import differential_modes
from vsgdesign.linear.stability.step_responses import sampled_steps
from vsgdesign.metrics.margins import disk_margin_per_frequency
from vsgdesign.metrics.modes import least_damping, to_continuous
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_POINTS = 320
"""At how many instants of HORIZON responses are looked at."""
_FREQUENCIES = 120
_NO_REST = 1e6
"""Growth of a mode that has no steady state to be about, 1/s: a number, which a file can keep."""
_POWERS = ("P", "Q")
_STEPS = ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q")
_WORST_LEAST = ("disk_margin", "damping_ratio")
"""Figures of which the least is the worst."""


@dataclass(frozen=True, kw_only=True)
class FullOrderFigures:
    """Figures (S,) of one design in every scenario; NaN margins where it is unstable or has no steady state."""

    overshoot_P: Array
    settling_P: Array
    overshoot_Q: Array
    settling_Q: Array
    cross_peak: Array
    disk_margin: Array
    """At the output. The least is exact, the others are those that a few frequencies find."""
    damping_ratio: Array
    abscissa: Array
    fastest_rad_s: Array
    """|s| of the mode with the largest real part: far above the power loops' bandwidth where the inner loops fail."""
    differential: Array | None = None
    """Largest real part of the differential mode; None where nobody asks."""

    def worst(self) -> Figures:
        """The worst over the scenarios."""
        return Figures(
            overshoot_P=float(np.max(self.overshoot_P)),
            settling_P=float(np.max(self.settling_P)),
            overshoot_Q=float(np.max(self.overshoot_Q)),
            settling_Q=float(np.max(self.settling_Q)),
            cross_peak=float(np.max(self.cross_peak)),
            disk_margin=float(np.min(self.disk_margin)),
            damping_ratio=float(np.min(self.damping_ratio)),
            abscissa=float(np.max(self.abscissa)),
            differential_decay=np.inf if self.differential is None else -float(np.max(self.differential)),
        )


CHARGES = (0.0, 0.5, 1.0)
"""Of a battery, at which a design is looked at besides that of the study: both ends, and the middle."""


def links_over_charge(study: Study) -> tuple[DcLink, ...]:
    """The dc links of a study at other charges, where the voltage follows the charge; none otherwise."""
    if study.dc is None or "open_circuit" not in study.dc.values:
        return ()
    own = study.dc.values["charge"]
    return tuple(study.dc.after({"dc_charge": charge}) for charge in CHARGES if charge != own)


def range_of_link(study: Study, powers: Sequence[float]) -> dict[str, Any] | None:
    """The charges at which designs are looked at, and the voltages (V) that the link has there while the bridge takes
    these powers (W), where the battery can; None where the voltage does not follow a charge."""
    others = links_over_charge(study)
    if study.dc is None or not others:
        return None
    links, p = (study.dc, *others), np.array(powers, dtype=float)
    v = np.concatenate([links_at_rest(study, [link] * len(p), p) for link in links])
    charges = sorted(link.values["charge"] for link in links)
    known = v[np.isfinite(v)]
    return {"charges": charges, "v_dc": [float(known.min()), float(known.max())] if known.size else []}


def full_order_figures(
    study: Study, gains: PowerLoopGains, s: Scenarios, settling_time: float, apart: tuple[float, float] | None = None
) -> FullOrderFigures:
    """Gains, arrays (S,), in S scenarios on the full-order model: averaged bridge, inner loops, delay, sampling. With a
    battery on the dc link they are the worst over its charge, and over the voltages of the link that belong to it;
    a charge at which the battery cannot give or take the power of a scenario is left out.

    ``apart``: the path between equal units, where the decay of their differential mode is asked for."""
    cells = _cells(study, gains, s)
    found = _of_cells(study, cells, gains, s, settling_time, apart)
    for link in links_over_charge(study):
        states = steady_cells(study, [replace(cell, link=link) for cell in cells]).states
        if states is None:
            continue
        # Where a clamp holds the power elsewhere, the scenario is another one.
        near = np.abs(states.P - s.P) < 1e-3 * study.converter.S_rated
        there = np.flatnonzero((states.fault == 0) & near)
        if not len(there):
            continue
        own = PowerLoopGains(*(np.broadcast_to(np.asarray(value, dtype=float), s.P.shape)[there] for value in gains))
        at_charge = [replace(cells[k], link=link) for k in there.tolist()]
        other = _of_cells(study, at_charge, own, s.take(there), settling_time, None)
        found = _worse(found, other, there)
    return found


def _worse(found: FullOrderFigures, other: FullOrderFigures, at: NDArray[np.intp]) -> FullOrderFigures:
    """The worse of two figures, of which the second are those of the scenarios ``at``."""
    out = {name: getattr(found, name).copy() for name in (*_STEPS, *_WORST_LEAST, "cross_peak", "abscissa")}
    fastest = found.fastest_rad_s.copy()
    slower = other.abscissa > out["abscissa"][at]
    fastest[at[slower]] = other.fastest_rad_s[slower]
    for name in out:
        worse = np.minimum if name in _WORST_LEAST else np.maximum
        out[name][at] = worse(out[name][at], getattr(other, name))
    return replace(found, **out, fastest_rad_s=fastest)


def _of_cells(
    study: Study,
    cells: list[Cell],
    gains: PowerLoopGains,
    s: Scenarios,
    settling_time: float,
    apart: tuple[float, float] | None,
) -> FullOrderFigures:
    model = linearise_full_order(study, cells)
    count, index = len(s), model.index
    eigenvalues = to_continuous(np.linalg.eigvals(model.A), model.T_s)
    rightmost = np.argmax(eigenvalues.real, axis=1)
    rows = np.arange(len(index))
    abscissa = eigenvalues.real.max(axis=1)
    out = {name: np.full(count, np.inf) for name in (*_STEPS, "cross_peak", "abscissa")}
    out |= {name: np.full(count, -np.inf) for name in ("disk_margin", "damping_ratio")}
    out["fastest_rad_s"] = np.full(count, np.nan)
    out["abscissa"][index] = abscissa
    out["fastest_rad_s"][index] = np.abs(eigenvalues[rows, rightmost])
    out["damping_ratio"][index] = least_damping(eigenvalues)
    stable = abscissa < 0.0
    good = index[stable]
    for name, values in _responses(model, stable, gains, s, settling_time).items():
        out[name][good] = values
    omega = np.geomspace(0.3 / settling_time, 0.9 * np.pi / model.T_s, _FREQUENCIES)
    out["disk_margin"][good] = disk_margin_per_frequency(FullOrderLoop(model).on(omega)[stable]).min(axis=1)
    if len(good) == count:
        out["disk_margin"] = exact_disk_margins(
            out["disk_margin"], lambda near: linearise_full_order(study, [cells[k] for k in near])
        )
    differential = None
    if apart is not None:
        rates = differential_modes(study, gains, s.P, s.Q, s.V_rms, s.omega_g).real
        differential = np.where(np.isnan(rates), _NO_REST, rates)
    return FullOrderFigures(**out, differential=differential)


def _cells(study: Study, gains: PowerLoopGains, s: Scenarios) -> list[Cell]:
    """Cells whose references put each scenario at its powers in spite of droop."""
    c, f = study.converter, study.filter
    gains = PowerLoopGains(*(np.broadcast_to(np.asarray(value, dtype=float), s.P.shape) for value in gains))
    P_ref = s.P - gains.D_p * (c.omega_n - s.omega_g)
    Q_ref = s.Q - gains.D_q * (c.V_rated_rms - s.V_rms)
    return [
        Cell(
            Grid(float(s.R[k] - f.R_2), float(s.X[k] / s.omega_g[k] - f.L_2)),
            PowerLoopGains(*(float(value[k]) for value in gains)),
            float(P_ref[k]),
            float(Q_ref[k]),
            GridSource(float(s.V_g_rms[k]), float(s.omega_g[k])),
        )
        for k in range(len(s))
    ]


def _responses(
    model: FullOrderModel, stable: NDArray[np.bool_], gains: PowerLoopGains, s: Scenarios, settling_time: float
) -> dict[str, Array]:
    """Overshoot, settling and cross peak over both reference steps of the stable cells."""
    every = max(round(HORIZON * settling_time / _POINTS / model.T_s), 1)
    t_s = every * np.arange(1, _POINTS + 1, dtype=np.float64) * model.T_s
    columns, rows = [INPUTS.index(f"{name}_ref") for name in _POWERS], [OUTPUTS.index(name) for name in _POWERS]
    parts = model.B[stable][:, :, columns], model.C[stable][:, rows], model.D[stable][:, rows][:, :, columns]
    y = sampled_steps(model.A[stable], *parts, every, _POINTS + 1)[:, 1:]
    at = model.index[stable]
    J = np.array(jacobian_from_powers(s.P[at], s.Q[at], s.V_rms[at], s.R[at], s.X[at])).T.reshape(-1, 2, 2)
    D_q = np.broadcast_to(np.asarray(gains.D_q, dtype=float), s.P.shape)[at]
    finals = {"P": np.ones(len(at)), "Q": final_Q(J, D_q)}
    found: dict[str, Array] = {"cross_peak": np.zeros(len(at))}
    for k, own in enumerate(_POWERS):
        progress = y[:, :, k, k] / finals[own][:, None]
        found[f"overshoot_{own}"] = np.maximum(progress.max(axis=1) - 1.0, 0.0)
        found[f"settling_{own}"] = _settling(t_s, np.abs(progress - 1.0))
        found["cross_peak"] = np.maximum(found["cross_peak"], np.abs(y[:, :, 1 - k, k]).max(axis=1))
    return found


def _settling(t_s: Array, error: Array) -> Array:
    """Last entry into the band per row, interpolated; infinite where the last instant is outside."""
    count = error.shape[1]
    last = count - 1 - np.argmax(error[:, ::-1] > SETTLING_BAND, axis=1)
    never = ~(error > SETTLING_BAND).any(axis=1)
    rows, after = np.arange(len(error)), np.minimum(last + 1, count - 1)
    span = error[rows, last] - error[rows, after]
    part = np.where(span > 0.0, (error[rows, last] - SETTLING_BAND) / np.where(span > 0.0, span, 1.0), 0.0)
    found = t_s[last] + part * (t_s[after] - t_s[last])
    return np.where(never, 0.0, np.where(last == count - 1, np.inf, found))
