"""What inner loops keep between equal units at one node, each on its R_2 and L_2 alone (:eq:`plant-split`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.inner.frozen import Plants, law_matrix, modes, plants
from vsgdesign.design.inner.grids import (
    CHECKED,
    POWERS_PU,
    GridBox,
    GridPoint,
    angle_damped_target,
    axis,
    closed_form_cells,
    lattice,
    sampling_ratio,
    study_of,
)
from vsgdesign.design.inner.promises import DAMPING, PromiseReached, controller_settings
from vsgdesign.design.inner.search import closed_form_starts
from vsgdesign.equations.controller import ControllerSettings
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.full_order import steady_cells
from vsgdesign.linear.stability.modes_of_units import differential_modes
from vsgdesign.metrics.modes import least_damping
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.specification import decaying_time
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

FASTER = 0.5
"""The closed form that inner loops are judged with settles within so much of the time after which a mode of the asked
decay leaves 2 % (:eq:`inner-apart`). With inner loops that take nothing away its
units decay with 1.4 times what is asked. A table has gains that are as high where the estimate is wrong, so that less
would leave it no room."""

SEARCHED = slice(None, None, 2)
"""Of the lattice of a check: where a search begins."""


@dataclass(frozen=True, kw_only=True)
class ApartBench:
    """What inner loops are judged on between units: a filter alone, and closed-form power loops at N rests.

    Inner gains change neither these power loops nor P, Q and V at rest (:eq:`operating-point`).
    """

    study: Study
    """With any inner gains."""
    settings: ControllerSettings
    still: Plants
    """The circuit of the filter alone."""
    decay: float
    """That is asked for, 1/s."""
    where: tuple[GridPoint, ...]
    """SCR and X/R of each rest."""
    gains: PowerLoopGains
    """Of the closed form, (N,) each."""
    P: Array
    Q: Array
    V_rms: Array
    searched: NDArray[np.intp]
    """The rests that a search looks at."""

    def damping(self, gains: InnerLoopGains, omega_t: Array) -> Array:
        """The least damping ratio (M,) of M gain sets (arrays, SI) with the power loops held still."""
        return least_damping(modes(law_matrix(gains, omega_t, self.settings), self.still))[:, 0]

    def decays(self, gains: InnerLoopGains, omega_t: float, at: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The decay (N,) of the units against each other at rests, 1/s; −∞ where a unit alone has none."""
        study, own = (
            replace(self.study, inner_gains=gains, omega_t=omega_t),
            PowerLoopGains(*(g[at] for g in self.gains)),
        )
        s = differential_modes(study, own, self.P[at], self.Q[at], self.V_rms[at], study.converter.omega_n)
        return -np.nan_to_num(s.real, nan=math.inf)

    def scores(self, gains: InnerLoopGains, omega_t: Array, of: Array) -> Array:
        """What this promise leaves of the scores ``of`` (M,) of M gain sets (arrays, SI): where it is kept, all.

        A set that is unstable by itself keeps its score, and so does one that is not among the better half anyhow.
        """
        found, seen = of.copy(), []
        damped = self.damping(gains, omega_t) / DAMPING
        for k in np.argsort(-of, kind="stable").tolist():
            if not of[k] > 0.0 or (2 * len(seen) >= len(of) and of[k] <= np.median(seen)):
                break
            own = InnerLoopGains(*(float(value[k]) for value in gains))
            if damped[k] > 0.0 and len(self.P):
                decays = self.decays(own, float(omega_t[k]), self.searched)
                damped[k] = min(damped[k], float(decays.min()) / self.decay)
            found[k] = of[k] if damped[k] >= 1.0 else min(of[k], damped[k])
            seen.append(found[k])
        return found

    def joined(self, gains: InnerLoopGains, omega_t: float) -> ApartBench:
        """The bench of a search that looks at the worst rest of a gain set (SI), too."""
        if not len(self.P):
            return self
        return replace(self, searched=np.union1d(self.searched, [np.argmin(self.decays(gains, omega_t))]))


def apart_bench(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox,
    *,
    decay: float,
) -> ApartBench:
    """The bench of the grids of a box that carry the powers of a check.

    R_2 and L_2 of ``filter_`` contain the transformer of a unit. ``gains`` (SI) and ``omega_t`` (rad/s): any with which
    there are rests. ``decay`` (1/s) is asked for, and decides the closed form (:data:`FASTER`).
    """
    f, settings = filter_, controller_settings(converter, filter_)
    alone = FilterGrid(f.L_1, f.R_1, f.C, f.R_c, f.L_2, f.R_2, 0.0, 0.0)
    target = angle_damped_target(FASTER * decaying_time(decay), converter.omega_n)
    study = study_of(converter, filter_, gains, omega_t, box, target=target)
    cells, where = closed_form_cells(study, target, lattice(box, *CHECKED), box.basis, POWERS_PU)
    rests = steady_cells(study, cells)
    known = [k for k, fault in enumerate(rests.faults) if fault is None]
    coarse = {(a, b) for a in axis(box.scr, CHECKED[0])[SEARCHED] for b in axis(box.x_over_r, CHECKED[1])[SEARCHED]}
    P, Q, V_rms = np.empty((3, 0))
    if rests.states is not None:
        P, Q, V_rms = (np.asarray(one)[known] for one in (rests.states.P, rests.states.Q, rests.states.V))
    return ApartBench(
        study=study,
        settings=settings,
        still=plants([alone], settings, converter.delay_samples, converter.omega_n),
        decay=decay,
        where=tuple(where[k][:2] for k in known),
        gains=PowerLoopGains(*np.reshape([cells[k].gains for k in known], (len(known), -1)).T),
        P=P,
        Q=Q,
        V_rms=V_rms,
        searched=np.array([k for k, one in enumerate(known) if where[one][:2] in coarse], dtype=np.intp),
    )


_STARTS = (0.2, 0.4), (0.3, 0.24)
"""X_t over Z_b and ω_t over ω_n of starts; the second is for slow samplers."""


def searched_apart(
    converter: Converter, filter_: Filter, box: GridBox, decay: float
) -> tuple[ApartBench | None, list[tuple[InnerLoopGains, float]]]:
    """The bench of a search, and starts (gains in SI, ω_t in rad/s) with the transient reactances that are worth trying
    between units; nothing where no ``decay`` (1/s) is asked for."""
    if not decay > 0.0:
        return None, []
    first, omega_t = closed_form_starts(converter, filter_, sampling_ratio(converter, filter_, box))[0]
    bench = apart_bench(converter, filter_, first, omega_t, box, decay=decay)
    Z_base, omega_n = converter.Z_base, converter.omega_n
    return bench, [(first._replace(X_t=X_t * Z_base), corner * omega_n) for X_t, corner in _STARTS]


def check_apart(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox,
    *,
    decay: float,
) -> tuple[PromiseReached, PromiseReached]:
    """What inner loops keep between equal units: the damping ratio with the power loops held still, which no grid has a
    say in, and the slowest decay, of which ``decay`` (1/s) is asked, with closed-form power loops (:data:`FASTER`) for
    the grids and powers of :func:`vsgdesign.design.inner.check_full_order`."""
    bench = apart_bench(converter, filter_, gains, omega_t, box, decay=decay)
    damping = float(bench.damping(InnerLoopGains(*(np.array([one]) for one in gains)), np.array([omega_t]))[0])
    reached, scr, x_over_r = math.nan, math.nan, math.nan
    if len(bench.P):
        decays = bench.decays(gains, omega_t)
        worst = int(np.argmin(decays))
        reached, (scr, x_over_r) = float(decays[worst]), bench.where[worst]
    return (
        PromiseReached("damping_apart", damping, DAMPING, damping / DAMPING, math.nan, math.nan),
        PromiseReached("decay_apart", reached, bench.decay, reached / bench.decay, scr, x_over_r),
    )
