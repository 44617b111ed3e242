"""The swing of a limited converter in a quasi-static network, and its energy function (docs/theory/large-signal.md)."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.swing.conditions import SwingLaw
from vsgdesign.equations.power_flow import power_flow
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.frames import PHASES

Array = NDArray[np.float64]


class Limited(NamedTuple):
    """What the limiter makes of one angle: the angle φ by which the reference leads the admitted voltage (rad; zero if
    the limiter does not act), and the power that the grid then takes (W, var)."""

    phi: float
    P: float
    Q: float


@dataclass(frozen=True)
class SwingLoops:
    """A converter V∠δ behind R + jX (Ω) at the grid voltage V_g, both phase rms, with V held.

    ``P`` and ``Q`` are those of its rest (W, var), ``I_rated_rms`` and ``Z_base`` are the units of ``law``.
    ``angle_error`` is that of the estimated impedance angle, in rad. The gains are held. The states are δ and Δ, the
    frequency over that of the grid at which the frequency integrator would rest (:eq:`swing-loops`).
    """

    R: float
    X: float
    V: float
    V_g: float
    P: float
    Q: float
    gains: PowerLoopGains
    law: SwingLaw
    I_rated_rms: float
    Z_base: float
    angle_error: float = 0.0

    @property
    def kept(self) -> float:
        """m = 1 − k_P D_p."""
        return 1.0 - self.gains.k_P * self.gains.D_p

    @property
    def rest(self) -> float:
        """δ_0 in rad."""
        P, Q = self.P, self.Q
        return math.atan2(self.X * P - self.R * Q, PHASES * self.V**2 - self.R * P - self.X * Q)

    def limited(self, delta: float) -> Limited:
        """The power and the angle φ at the angle δ (:eq:`held-current`, :eq:`projection`)."""
        law, Z = self.law, complex(self.R, self.X)
        soft, hard = law.i_soft * self.I_rated_rms, law.i_max * self.I_rated_rms
        turn = cmath.exp(1j * (cmath.phase(Z) + self.angle_error))
        u = cmath.rect(self.V, delta)
        gap = u - self.V_g
        i = gap / Z
        if abs(i) <= soft:
            return Limited(0.0, *power_flow(delta, self.V, self.V_g, self.R, self.X))
        if abs(i) <= hard:
            P, Q = power_flow(delta, self.V, self.V_g, self.R, self.X)
            admitted = u - law.Z_v * self.Z_base * turn * i * (1.0 - soft / abs(i))
        else:
            radius = abs(Z) * hard
            chord = math.sqrt(abs(gap) ** 2 - (radius * math.sin(self.angle_error)) ** 2)
            short = chord - radius * math.cos(self.angle_error)
            towards = gap * complex(chord, radius * math.sin(self.angle_error)) / abs(gap) ** 2
            S = PHASES * (u - short * towards) * (hard * towards / turn).conjugate()
            P, Q = S.real, S.imag
            admitted = u - towards * (short + law.Z_v * self.Z_base * (hard - soft))
        return Limited(-cmath.phase(admitted / u), P, Q)

    def unstable_rest(self) -> float:
        """The other angle in rad, within ±π, at which the power error is zero while the limiter does not act
        (:eq:`unstable-rest`); the rest itself where it is unstable with V held."""
        g = self.gains
        crest = math.atan2(self.R, self.X) + math.atan(g.K_pq / g.K_ip)
        if math.cos(self.rest - crest) <= 0.0:
            return self.rest
        return math.remainder(math.pi + 2.0 * crest - self.rest, 2.0 * math.pi)

    def errors(self, at: Limited, speed: float) -> tuple[float, float]:
        """The power error with which the loops turn and pull (W), and its part that shapes the energy: one-sided
        while the limiter acts (:eq:`one-sided-error`)."""
        g = self.gains
        slope = g.K_pq / g.K_ip
        e_P, e_Q = at.P - self.P, slope * (at.Q - self.Q)
        loads = e_P + g.D_p * speed - g.D_p * g.k_P / self.kept * e_Q
        if at.phi == 0.0 or not self.law.one_sided:
            return loads + e_Q / self.kept, e_P + e_Q
        sign = math.copysign(1.0, at.phi)
        return sign * max(sign * loads, 0.0) + e_Q / self.kept, sign * max(sign * e_P, 0.0) + e_Q

    def pull(self, phi: float) -> float:
        """s in rad/s: what the frequency integrator follows of the pull of θ."""
        return min(max(phi / self.law.tau, -self.law.largest_pull), self.law.largest_pull)

    def rates(self, delta: float, speed: float) -> tuple[float, float]:
        """dδ/dt in rad/s and dΔ/dt in rad/s² (:eq:`swing-loops`)."""
        at = self.limited(delta)
        used, _ = self.errors(at, speed)
        turning = speed - at.phi / self.law.tau - self.gains.k_P * used
        return turning, -self.law.g * self.pull(at.phi) / self.kept - self.gains.K_ip * used

    def slope(self, delta: float, speed: float) -> float:
        """dW/dt in rad²/s³ (:eq:`swing-falls`)."""
        at = self.limited(delta)
        _, shaping = self.errors(at, speed)
        d_delta, d_speed = self.rates(delta, speed)
        force = self.law.g * self.pull(at.phi) + self.gains.K_ip * shaping
        return self.kept * speed * d_speed + force * d_delta

    def potential(self, deltas: Array) -> Array:
        """U of :eq:`swing-function` at rising angles, in rad²/s², zero at the first: by the trapezoidal rule."""
        force = []
        for delta in deltas:
            at = self.limited(float(delta))
            force.append(self.law.g * self.pull(at.phi) + self.gains.K_ip * self.errors(at, 0.0)[1])
        steps = 0.5 * (np.array(force[1:]) + np.array(force[:-1])) * np.diff(deltas)
        return np.concatenate([[0.0], np.cumsum(steps)])
