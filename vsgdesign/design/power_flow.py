"""Power flow before any dynamics: where a controller rests with its droops, over grids and powers, and what limits."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.frames import peak_to_rms
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.linear.operating_point.equilibrium import static_limit_uses
from vsgdesign.linear.operating_point.many import (
    BRIDGE_VOLTAGE,
    CURRENT,
    FAULTS,
    LIMITER_ACTS,
    LIMITER_PULLS,
    NO_POINT,
    Lanes,
)
from vsgdesign.linear.operating_point.many_rests import GainsOfMany, many_rests_with_measured_gains
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_LIMITING = {
    NO_POINT: "power transfer",
    BRIDGE_VOLTAGE: "bridge voltage",
    CURRENT: "current",
    LIMITER_ACTS: "current",
    LIMITER_PULLS: "limiter's voltage",
}
"""The limit that a fault of a rest stands for."""


class FlowAxes(NamedTuple):
    """What a power flow is computed for: every combination of these."""

    scr_basis: str
    scr: tuple[float, ...]
    x_over_r: tuple[float, ...]
    P_ref: tuple[float, ...]
    """W."""
    Q_ref: tuple[float, ...]
    """var."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """SCR, X/R, and all powers of a grid."""
        return len(self.scr), len(self.x_over_r), len(self.P_ref) * len(self.Q_ref)


@dataclass(frozen=True, kw_only=True)
class PowerFlow:
    """Rests of one controller on N combinations of its axes, with the source at its nominal values.

    All arrays are (N,), and NaN where there is no rest.
    """

    controller: str
    axes: FlowAxes
    scr: Array
    x_over_r: Array
    P_ref: Array
    Q_ref: Array
    P: Array
    """W, at the filter's capacitor, as ``Q`` (var) and ``V_rms`` (phase)."""
    Q: Array
    V_rms: Array
    I_rms: Array
    """Through the converter-side inductor, A rms."""
    modulation_index: Array
    """The bridge's voltage over V_dc/2."""
    modulation_margin: Array
    """What is left of the bridge's largest voltage, as a share of it."""
    used: Array
    """Share that the rest uses of the limit nearest to it (:eq:`static-limits`); NaN without a rest."""
    limit: tuple[str, ...]
    """The name of this limit, or what prevents a rest."""
    obstacle: tuple[str, ...]
    """Why the converter cannot stay there; empty where it can."""

    @property
    def possible(self) -> NDArray[np.bool_]:
        """Where the converter can stay."""
        return np.array([not one for one in self.obstacle])

    def document(self) -> dict[str, Any]:
        """All of it in JSON's types, one list of N entries for each quantity."""
        lists = {name: getattr(self, name) for name in FIELDS}
        return {"controller": self.controller, "scr_basis": self.axes.scr_basis, **lists}


FIELDS = (
    *("scr", "x_over_r", "P_ref", "Q_ref", "P", "Q", "V_rms", "I_rms"),
    *("modulation_index", "modulation_margin", "used", "limit", "obstacle"),
)
"""The columns of a power flow."""


def flow_axes(study: Study) -> FlowAxes:
    """The grids and powers that a study asks for: its specification's, else the axes of its [stability]. Of a range of
    powers, its ends and zero between them."""
    asked = study.specification
    if asked is None:
        s = study.stability
        return FlowAxes(study.scr_basis, s.scr, s.x_over_r, s.P, s.Q)
    return FlowAxes(asked.scr_basis, asked.scr, asked.x_over_r, _ends(asked.box.P), _ends(asked.box.Q))


def _ends(values: Sequence[float]) -> tuple[float, ...]:
    low, high = min(values), max(values)
    return tuple(sorted({low, high} | ({0.0} if low < 0.0 < high else set())))


def power_flow(study: Study, spec: ControllerSpec, ready: Ready = NOTHING, axes: FlowAxes | None = None) -> PowerFlow:
    """The rests of a controller with both of its droops and its gains, and the limit that is nearest to each.

    A controller whose gain table is not there has the droops of this table, which are known before its design. Raises
    the errors of :func:`vsgdesign.runtime.of_study.gain_law`.
    """
    study, axes = study.with_limit_of(spec), axes or flow_axes(study)
    c, source = study.converter, study.grid_source
    combined = np.array(list(itertools.product(*axes[1:]))).T
    places = [Place(float(scr), float(x_over_r), axes.scr_basis).grid(c) for scr, x_over_r in combined[:2].T]
    R_g, L_g = np.array([[grid.R_g, grid.L_g] for grid in places]).T
    lanes = Lanes(R_g, L_g, source.V_g_rms, source.omega_g, combined[2], combined[3])
    states, _ = many_rests_with_measured_gains(study, lanes, _gains_of(study, spec, ready, R_g, L_g))
    X = source.omega_g * (study.filter.L_2 + L_g)
    uses = static_limit_uses(study, study.filter.R_2 + R_g, X, source.omega_g, states.P, states.Q, states.V)
    shares = np.array(list(uses.values()))
    nearest = np.argmax(np.where(np.isnan(shares), -np.inf, shares), axis=0)
    used, names = shares[nearest, np.arange(len(nearest))], list(uses)
    limit, obstacle = [], []
    for fault, k, share in zip(states.fault.tolist(), nearest.tolist(), used.tolist(), strict=True):
        beyond = "" if not share > 1.0 else f"beyond the limit of the {names[k]}"
        limit.append(_LIMITING.get(fault, FAULTS[fault]) if fault else names[k])
        obstacle.append(FAULTS[fault] or beyond)
    return PowerFlow(
        controller=spec.name,
        axes=axes,
        scr=combined[0],
        x_over_r=combined[1],
        P_ref=combined[2],
        Q_ref=combined[3],
        P=states.P,
        Q=states.Q,
        V_rms=states.V,
        I_rms=peak_to_rms(states.i_s_pk),
        modulation_index=states.v_b_pk / (0.5 * c.V_dc),
        modulation_margin=1.0 - states.v_b_pk / c.v_max_pk,
        used=used,
        limit=tuple(limit),
        obstacle=tuple(obstacle),
    )


def _gains_of(study: Study, spec: ControllerSpec, ready: Ready, R_g: Array, L_g: Array) -> GainsOfMany:
    """The gains at measured P, Q and V; of a table that is not there those with its droops, which decide a rest."""
    if spec.schedule == "table" and spec.name not in ready.tables:
        c, target = study.converter, spec.target
        structure = STRUCTURES[target.structure]
        if structure.P_droop and structure.Q_droop:
            droops = structure.rated_droops(target.P_droop, target.Q_droop, c.S_rated, c.omega_n, c.V_rated_rms)
            constant = PowerLoopGains(0.0, droops[0], 0.0, droops[1])
            return lambda P, _Q, _V: PowerLoopGains(*(np.full(P.shape, value) for value in constant))
        spec = replace(spec, schedule="closed_form")
    law = gain_law(study, spec, ready)
    return lambda P, Q, V: law(R_g, L_g, P, Q, V)
