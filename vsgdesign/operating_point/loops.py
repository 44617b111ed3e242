"""The paper's open and closed power loops, without coupling."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.model import decoupled_loops
from vsgdesign.operating_point.transfer import TransferFunction, transfer_function


@dataclass(frozen=True)
class PowerLoops:
    """G_op and G_cl of both loops, as transfer functions in W/W and var/var."""

    P_open: TransferFunction
    P_closed: TransferFunction
    Q_open: TransferFunction
    Q_closed: TransferFunction


def power_loops(gains: PowerLoopGains, A: float, D: float) -> PowerLoops:
    """The decoupled loops (:eq:`decoupled-loops`; the paper's G_op and G_cl) for a Jacobian's A and D."""
    P, Q = (transfer_function(loop.A, loop.b, loop.c) for loop in decoupled_loops(gains, A, D))
    return PowerLoops(P, P.closed(), Q, Q.closed())
