"""The differential mode of equal units at one node: a unit alone on its own path, with the gains that it has there
(:eq:`plant-pair`, :eq:`differential-mode`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import source_behind
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.stability.maps import MarginMap
from vsgdesign.linear.stability.verdict import describe_cell
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def asked_apart(study: Study) -> float:
    """The decay of the units against each other that the specification asks for, 1/s; 0: none, as of a converter that
    stands alone."""
    return 0.0 if study.specification is None else study.specification.differential_decay


def differential_modes(
    study: Study, gains: PowerLoopGains, P: Array, Q: Array, V_rms: Array, omega_g: float | Array
) -> Complex:
    """The least stable differential mode (N,) of units that give P and Q at V each, by the full-order model of one unit
    on its R_2 and L_2 alone; NaN where there is no steady state. Gains are arrays (N,) or scalars."""
    c, f = study.converter, study.filter
    each = [np.broadcast_to(np.asarray(one, dtype=float), P.shape) for one in (omega_g, *gains)]
    omega, own = each[0], PowerLoopGains(*each[1:])
    V_node, _ = source_behind(P, Q, V_rms, f.R_2, omega * f.L_2)
    P_ref, Q_ref = P - own.D_p * (c.omega_n - omega), Q - own.D_q * (c.V_rated_rms - V_rms)
    cells = [
        Cell(
            Grid(0.0, 0.0),
            PowerLoopGains(*(float(value[k]) for value in own)),
            float(P_ref[k]),
            float(Q_ref[k]),
            GridSource(float(V_node[k]), float(omega[k])),
        )
        for k in range(len(P))
    ]
    model = linearise_full_order(study, cells)
    found = np.full(len(P), np.nan + 0j)
    if len(model.index):
        s = to_continuous(np.linalg.eigvals(model.A), model.T_s)
        slowest = s[np.arange(len(s)), np.argmax(s.real, axis=1)]
        found[model.index] = slowest.real + 1j * np.abs(slowest.imag)
    return found


@dataclass(frozen=True, kw_only=True)
class DifferentialWorst:
    """The least stable differential mode over the cells of a map that count."""

    controller: str
    cells: int
    s: complex
    """NaN where no cell counts, or one has no steady state."""
    where: str
    asked: float
    """Decay that the specification asks for, 1/s; 0 without one."""
    missing: int
    """Cells that do not have this decay."""

    @property
    def decay(self) -> float:
        """In 1/s; negative where the mode grows."""
        return -self.s.real


def worst_differential(study: Study, controller: str, field: MarginMap) -> DifferentialWorst:
    """The differential mode in every cell of a map that counts, with the gains of the cell."""
    flat = field.analysed[field.counted]
    cells = field.cells.take(flat)
    asked = asked_apart(study)
    if len(flat) == 0:
        nowhere = complex(np.nan, np.nan)
        return DifferentialWorst(controller=controller, cells=0, s=nowhere, where="", asked=asked, missing=0)
    s = differential_modes(study, cells.gains, cells.P, cells.Q, cells.V_rms, study.grid_source.omega_g)
    real = np.where(np.isnan(s.real), np.inf, s.real)
    k = int(np.argmax(real))
    return DifferentialWorst(
        controller=controller,
        cells=len(flat),
        s=complex(s[k]),
        where=describe_cell(field, int(flat[k])),
        asked=asked,
        missing=int(np.sum(~(-real >= asked))),
    )
