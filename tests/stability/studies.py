"""Studies and random cells that the tests of the small-signal models share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.linear.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.study.parameters import Grid, Study, study_from_text
from vsgdesign.study.parameters.grid import GridSource, Place
from vsgdesign.study.parameters.study import ClosedFormTarget

Array = NDArray[np.float64]

PUBLISHED, LABORATORY, UTILITY = "hoang2025_5kva", "lab_12kva_lcl", "utility_1mva_60hz"
CASES = (PUBLISHED, LABORATORY, UTILITY)

_INNER = ("K_pv", "K_iv", "K_pc", "K_ic", "K_ff")

_TEXT = """
base = "case:{case}"
[simulation]
duration = "1 s"
log_interval = "10 ms"
P_ref = "0 W"
Q_ref = "0 var"
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""


def case_study(
    case: str, *, tau_P: float = 0.0, tau_Q: float = 0.0, delay: int | None = None, f_sw: float | None = None
) -> Study:
    """A packaged case with one scheduled controller, logging every sample of a run."""
    study = study_from_text(_TEXT.format(case=case))
    converter = study.converter
    if delay is not None:
        converter = replace(converter, delay_samples=delay)
    if f_sw is not None:
        converter = replace(converter, f_sw=f_sw)
    simulation = replace(study.simulation, log_interval=converter.T_s)
    return replace(study, converter=converter, simulation=simulation, tau_P=tau_P, tau_Q=tau_Q)


@dataclass(frozen=True)
class Situation:
    """A study and one point of it, with the full-order model there."""

    study: Study
    cell: Cell
    model: FullOrderModel

    @property
    def growth(self) -> float:
        """Largest real part of the full-order modes, 1/s."""
        z = np.linalg.eigvals(self.model.A[0])
        return float(np.log(np.abs(z).max()) / self.model.T_s)


def situation(study: Study, cell: Cell) -> Situation:
    """The full-order model of one cell; InfeasibleStudyError where it has no steady state."""
    model = linearise_full_order(study, [cell])
    if model.faults[0] is not None:
        raise InfeasibleStudyError(model.faults[0])
    return Situation(study, cell, model)


def designed(study: Study, grid: Grid, settling_time: float = 1.0, damping_ratio: float = 1.0) -> PowerLoopGains:
    """Closed-form gains for a grid at the study's design point."""
    target = study.target
    aim = ClosedFormTarget(
        settling_time=settling_time, damping_ratio=damping_ratio, droop_ratio=target.droop_ratio, P=target.P, Q=target.Q
    )
    return closed_form_schedule(study, aim).gains(grid.R_g, grid.L_g)


def rated(study: Study, names: tuple[str, ...]) -> Array:
    """The rated value of each state."""
    c = study.converter
    V_pk = np.sqrt(2.0) * c.V_rated_rms
    I_pk = np.sqrt(2.0) * c.S_rated / (3.0 * c.V_rated_rms)
    table = {
        "i": I_pk,
        "v": V_pk,
        "pending": V_pk,
        "delta": 1.0,
        "omega": c.omega_n,
        "V": c.V_rated_rms,
        "P": c.S_rated,
        "Q": c.S_rated,
    }
    return np.array(
        [I_pk if n.startswith("xi_v") else V_pk if n.startswith("xi_i") else table[n.split("_")[0]] for n in names]
    )


def another_structure(rng: np.random.Generator, gains: PowerLoopGains) -> PowerLoopGains:
    """Off-diagonal integral gains of either sign, and half of the damping moved from the droop to the angle."""
    share = float(rng.uniform(0.2, 0.9))
    return gains._replace(
        D_p=(1.0 - share) * gains.D_p,
        k_P=share * gains.K_ip * gains.D_p * float(rng.uniform(0.5, 1.5)) / (gains.K_ip * gains.D_p**2),
        K_pq=gains.K_ip * float(rng.uniform(-0.5, 0.5)),
        K_qp=gains.K_iq * float(rng.uniform(-0.3, 0.3)),
        k_Q=float(rng.uniform(-0.2, 0.2)) / gains.D_p,
    )


def random_situations(count: int, seed: int) -> list[Situation]:
    """Random cases, delays, filters, grids, gains, inner loops, powers and grid frequencies that have a steady state.

    Nothing is asked of their stability.
    """
    rng = np.random.default_rng(seed)
    found: list[Situation] = []
    while len(found) < count:
        tau_P, tau_Q = (float(rng.choice([0.0, 10.0 ** rng.uniform(-3.0, -1.5)])) for _ in "PQ")
        study = case_study(str(rng.choice(CASES)), tau_P=tau_P, tau_Q=tau_Q, delay=int(rng.integers(2)))
        moved = {n: getattr(study.inner_gains, n) * 10.0 ** rng.uniform(-0.15, 0.15) for n in _INNER}
        study = replace(study, inner_gains=study.inner_gains._replace(**moved))
        scr, ratio = 10.0 ** rng.uniform(0.2, 1.4), 10.0 ** rng.uniform(-0.5, 1.2)
        grid = Place(float(scr), float(ratio), study.scr_basis).grid(study.converter)
        S = study.converter.S_rated
        P, Q = float(rng.uniform(-0.6, 0.9) * S), float(rng.uniform(-0.4, 0.4) * S)
        source = GridSource(
            study.grid_source.V_g_rms * float(rng.uniform(0.95, 1.05)),
            study.grid_source.omega_g * float(rng.uniform(0.9998, 1.0002)),
        )
        try:
            gains = designed(study, grid, float(10.0 ** rng.uniform(-1.0, 0.2)), float(rng.uniform(0.5, 1.5)))
            if rng.random() < 0.4:
                gains = another_structure(rng, gains)
            found.append(situation(study, Cell(grid, gains, P, Q, source)))
        except (InfeasibleStudyError, NoOperatingPointError):
            continue
    return found
