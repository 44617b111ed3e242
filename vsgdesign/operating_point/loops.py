"""The paper's open and closed power loops as python-control systems, and their classical margins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.model import decoupled_loops

if TYPE_CHECKING:
    import control

_ROUNDING_DB = 200.0
"""A gain margin beyond this is none: rounding moves a pole at s = 0 or a zero at infinity by some 1e-15 of the others,
and the loop then turns by half a turn where its gain is 1e13 or 1e-13."""


@dataclass(frozen=True)
class PowerLoops:
    """G_op and G_cl of both loops, as transfer functions in W/W and var/var."""

    P_open: control.TransferFunction
    P_closed: control.TransferFunction
    Q_open: control.TransferFunction
    Q_closed: control.TransferFunction


@dataclass(frozen=True)
class LoopMargins:
    """Classical margins of one loop; None where the loop crosses no such line."""

    gain_margin_db: float | None
    phase_margin_deg: float | None
    delay_margin_s: float | None
    crossover_rad_s: float | None


def power_loops(gains: PowerLoopGains, A: float, D: float) -> PowerLoops:
    """The decoupled loops (:eq:`decoupled-loops`; the paper's G_op and G_cl) for a Jacobian's A and D."""
    import control

    transfer = []
    for loop in decoupled_loops(gains, A, D):
        open_ = control.ss(loop.A, loop.b, loop.c, 0.0)
        transfer += [control.ss2tf(open_), control.ss2tf(control.feedback(open_, 1))]
    return PowerLoops(*transfer)


def loop_margins(open_loop: control.TransferFunction) -> LoopMargins:
    """Margins of a single loop closed with unity feedback: where it has several, the one nearest to the limit."""
    import control

    gain, phase, _, _, crossover, _ = control.stability_margins(open_loop)
    gain_db = float(20.0 * np.log10(gain))
    crosses = np.isfinite(phase) and np.isfinite(crossover) and crossover > 0.0
    return LoopMargins(
        gain_margin_db=gain_db if abs(gain_db) < _ROUNDING_DB else None,
        phase_margin_deg=float(phase) if crosses else None,
        delay_margin_s=float(np.deg2rad(phase) / crossover) if crosses else None,
        crossover_rad_s=float(crossover) if crosses else None,
    )
