"""The reduced model's assumptions as a nonlinear ODE: an ideal voltage V∠δ behind a quasi-static R + jX.

Written from the mathematics alone in complex numbers, integrated by DOP853: nothing of ``vsgdesign`` is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]


@dataclass(frozen=True)
class IdealConverter:
    """Power loops of any structure on an ideal voltage source. Volts are phase rms, powers three-phase."""

    R: float
    X: float
    K_ip: float
    D_p: float
    K_iq: float
    D_q: float
    omega_0: float
    V_n: float
    tau_P: float = 0.0
    tau_Q: float = 0.0
    K_pq: float = 0.0
    K_qp: float = 0.0
    k_P: float = 0.0
    k_Q: float = 0.0

    def power(self, delta: Any, V: Any, V_g: float) -> Any:
        """S = 3 E conj((E − V_g)/Z) with E = V∠δ."""
        E = V * np.exp(1j * delta)
        return 3.0 * E * np.conj((E - V_g) / (self.R + 1j * self.X))

    def measured(self, x: Array, V_g: float) -> tuple[float, float]:
        """P and Q as the loops have them."""
        S = self.power(x[0], x[2], V_g)
        return x[3] if self.tau_P > 0.0 else S.real, x[4] if self.tau_Q > 0.0 else S.imag

    def frequency(self, x: Array, V_g: float) -> float:
        """ω, of which a part may come straight from the powers: angle damping."""
        P, Q = self.measured(x, V_g)
        return x[1] - self.k_P * P - self.k_Q * (Q + self.D_q * x[2])

    def rates(self, x: Array, P_ref: float, Q_ref: float, omega_g: float, V_g: float) -> list[float]:
        """d/dt of (δ, ω_i, V, P_f, Q_f); a filter without time constant follows at once."""
        S = self.power(x[0], x[2], V_g)
        P, Q = self.measured(x, V_g)
        omega = self.frequency(x, V_g)
        e_P = P_ref - P + self.D_p * (self.omega_0 - omega)
        e_Q = Q_ref - Q + self.D_q * (self.V_n - x[2])
        return [
            omega - omega_g,
            self.K_ip * e_P + self.K_pq * e_Q,
            self.K_qp * e_P + self.K_iq * e_Q,
            (S.real - x[3]) / self.tau_P if self.tau_P > 0.0 else 0.0,
            (S.imag - x[4]) / self.tau_Q if self.tau_Q > 0.0 else 0.0,
        ]

    @property
    def scale(self) -> float:
        """A power to measure by: three-phase short circuit."""
        return 3.0 * self.V_n**2 / float(np.hypot(self.R, self.X))

    def run(self, x_0: Array, inputs: Sequence[float], t: Array) -> tuple[Array, Array]:
        """States (5, K) and (P, Q, ω, V) (4, K) at times t, with P_ref, Q_ref, ω_g and V_g held."""
        atol = 1e-13 * np.array([1.0, self.omega_0, self.V_n, self.scale, self.scale])
        solved = solve_ivp(
            lambda _, x: self.rates(x, *inputs), (t[0], t[-1]), x_0, "DOP853", t_eval=t, rtol=1e-12, atol=atol
        )
        if not solved.success:
            raise RuntimeError(solved.message)
        S = self.power(solved.y[0], solved.y[2], inputs[3])
        omega = np.array([self.frequency(x, inputs[3]) for x in solved.y.T])
        return solved.y, np.stack([S.real, S.imag, omega, solved.y[2]])
