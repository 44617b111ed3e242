"""The response of a voltage source with inertia behind a reactance to a phase jump, and the curves about it.

The procedure is that of RTE's tool DyCoV for its test IGFM1 (docs/theory/envelopes.md), written anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SLOW_S = 0.3
"""Time constant with which the tunnel opens, s."""
CLOSED_S = 0.02
"""For so long after the event the tunnel is closed, s."""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What a plant declares: inertia and damping behind a reactance, per unit of its rating."""

    H_s: float
    """Inertia constant, s."""
    D_pu: float
    """Damping: power over a difference of frequency, both per unit."""
    X_pu: float
    """Reactance from the source in the plant to the source of the grid."""
    omega_n: float
    """rad/s."""

    @property
    def damping_ratio(self) -> float:
        """ε of :eq:`swing`; at most 1 where the response swings."""
        return 0.5 * self.D_pu * math.sqrt(self.X_pu / (2.0 * self.H_s * self.omega_n))


def power_after_jump(t_s: Array, jump_rad: float, machine: Machine) -> Array:
    """Change of power at times (n,) after a jump of ``jump_rad`` between the sources, pu (:eq:`swing-response`).

    It is P_peak = jump/X at the jump and decays. Before the jump it is zero.
    """
    m = machine
    omega = math.sqrt(m.omega_n / (2.0 * m.H_s * m.X_pu))
    sigma = m.damping_ratio * omega
    t = np.maximum(t_s, 0.0)
    # σ ± √(σ² − ω²) are the decay rates, or a pair of complex ones: one expression serves both.
    rate = np.sqrt(complex(sigma**2 - omega**2))
    if abs(rate) < 1e-9 * omega:
        shape = (1.0 + sigma * t) * np.exp(-sigma * t)
    else:
        fast, slow = sigma + rate, sigma - rate
        shape = ((fast * np.exp(-slow * t) - slow * np.exp(-fast * t)) / (fast - slow)).real
    return np.where(t_s >= 0.0, jump_rad / m.X_pu * shape, 0.0)


@dataclass(frozen=True, kw_only=True)
class Margins:
    """How far a response may be from that of the declared machine."""

    variation: float = 0.1
    """Share by which H and D are varied together, both ways."""
    above: float = 0.5
    below: float = 0.5
    """Shares of the response by which it may be larger and smaller."""
    tunnel_share: float = 0.05
    """Of P_peak; the tunnel is at least ``tunnel_pu`` wide, to either side."""
    tunnel_pu: float = 0.02
    delay_s: float = 0.01
    """For so long the smaller response need not begin."""


def change_curves(t_s: Array, jump_rad: float, machine: Machine, margins: Margins) -> tuple[Array, Array]:
    """Least and largest change of power at times (n,) after a jump of ``jump_rad`` > 0, pu (:eq:`swing-curves`)."""
    nominal = power_after_jump(t_s, jump_rad, machine)
    peak = jump_rad / machine.X_pu
    curves = [nominal]
    for factor in (1.0 - margins.variation, 1.0 + margins.variation):
        varied = replace(machine, H_s=factor * machine.H_s, D_pu=factor * machine.D_pu)
        curves.append(power_after_jump(t_s, jump_rad, varied))
    late = t_s - margins.delay_s
    if machine.damping_ratio > 1.0:
        curves.append((1.0 + margins.above) * nominal)
        curves.append((1.0 - margins.below) * power_after_jump(late, jump_rad, machine))
    else:
        decay = np.exp(-machine.D_pu / (4.0 * machine.H_s) * np.maximum(late, 0.0)) * peak
        curves.append((1.0 + margins.above) * decay)
        curves.append(np.where(late >= 0.0, (1.0 - margins.below) * decay, 0.0))
    tunnel = tunnel_width(peak, margins) * np.maximum(1.0 - np.exp((CLOSED_S - t_s) / SLOW_S), 0.0)
    return np.min(curves, axis=0) - tunnel, np.max(curves, axis=0) + tunnel


def tunnel_width(peak_pu: float, margins: Margins) -> float:
    """Half of the tunnel's width at the end, pu (:eq:`swing-tunnel`)."""
    return max(margins.tunnel_pu, margins.tunnel_share * peak_pu)


def power_curves(
    t_s: Array, jump_rad: float, P_pu: float, P_max_pu: float, machine: Machine, margins: Margins
) -> tuple[Array, Array]:
    """Least and largest power at times (n,) after the grid's phase has jumped by ``jump_rad``, pu.

    A positive jump takes power away. The curve that asks for power stops at 1 pu less the tunnel, and the one that
    allows it at ``P_max_pu`` (:eq:`swing-limits`).
    """
    sign = math.copysign(1.0, jump_rad)
    least, largest = (P_pu - sign * change for change in change_curves(t_s, abs(jump_rad), machine, margins))
    asked = 1.0 - tunnel_width(abs(jump_rad) / machine.X_pu, margins)
    bounds = (asked, P_max_pu) if P_pu * sign < 0.0 else (P_max_pu, asked)
    one, other = (np.clip(curve, -most, most) for curve, most in zip((least, largest), bounds, strict=True))
    return np.minimum(one, other), np.maximum(one, other)
