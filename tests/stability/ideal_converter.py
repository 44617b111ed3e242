"""The reduced model's assumptions as a nonlinear ODE: an ideal voltage V∠δ behind a quasi-static R + jX.

Written from the mathematics alone in complex numbers, integrated by DOP853: nothing of ``vsgdesign`` is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root

Array = NDArray[np.float64]


@dataclass(frozen=True)
class IdealConverter:
    """Published power loops on an ideal voltage source. Volts are phase rms, powers three-phase."""

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

    def power(self, delta: Any, V: Any, V_g: float) -> Any:
        """S = 3 E conj((E − V_g)/Z) with E = V∠δ."""
        E = V * np.exp(1j * delta)
        return 3.0 * E * np.conj((E - V_g) / (self.R + 1j * self.X))

    def rates(self, x: Array, P_ref: float, Q_ref: float, omega_g: float, V_g: float) -> list[float]:
        """d/dt of (δ, ω, V, P_f, Q_f); a filter without time constant follows at once."""
        delta, omega, V, P_f, Q_f = x
        S = self.power(delta, V, V_g)
        P = P_f if self.tau_P > 0.0 else S.real
        Q = Q_f if self.tau_Q > 0.0 else S.imag
        return [
            omega - omega_g,
            self.K_ip * (P_ref - P + self.D_p * (self.omega_0 - omega)),
            self.K_iq * (Q_ref - Q + self.D_q * (self.V_n - V)),
            (S.real - P_f) / self.tau_P if self.tau_P > 0.0 else 0.0,
            (S.imag - Q_f) / self.tau_Q if self.tau_Q > 0.0 else 0.0,
        ]

    def rest(self, inputs: tuple[float, float, float, float], guess: tuple[float, float]) -> Array:
        """Where nothing moves, near a guess of (δ, V), by a root finder."""
        P_ref, Q_ref, omega_g, V_g = inputs

        def residual(y: Array) -> list[float]:
            S = self.power(y[0], y[1] * self.V_n, V_g)
            P = P_ref + self.D_p * (self.omega_0 - omega_g)
            Q = Q_ref + self.D_q * self.V_n * (1.0 - y[1])
            return [(S.real - P) / self.scale, (S.imag - Q) / self.scale]

        found = root(residual, [guess[0], guess[1] / self.V_n], tol=1e-14)
        if not max(abs(value) for value in residual(found.x)) < 1e-10:
            raise RuntimeError(f"no rest: {found.message}")
        delta, V = float(found.x[0]), float(found.x[1]) * self.V_n
        S = self.power(delta, V, V_g)
        return np.array([delta, omega_g, V, S.real, S.imag])

    @property
    def scale(self) -> float:
        """A power to measure by: three-phase short circuit."""
        return 3.0 * self.V_n**2 / float(np.hypot(self.R, self.X))

    def run(self, x_0: Array, inputs: tuple[float, float, float, float], t: Array) -> tuple[Array, Array]:
        """States (5, K) and (P, Q, ω, V) (4, K) at times t, with the inputs held."""
        atol = 1e-13 * np.array([1.0, self.omega_0, self.V_n, self.scale, self.scale])
        solved = solve_ivp(
            lambda _, x: self.rates(x, *inputs), (t[0], t[-1]), x_0, "DOP853", t_eval=t, rtol=1e-12, atol=atol
        )
        if not solved.success:
            raise RuntimeError(solved.message)
        S = self.power(solved.y[0], solved.y[2], inputs[3])
        return solved.y, np.stack([S.real, S.imag, solved.y[1], solved.y[2]])

    def jacobian(self, x: Array, inputs: tuple[float, float, float, float], step: float = 1e-6) -> Array:
        """∂rates/∂x by central differences, over the states that move."""
        sizes = step * np.array([1.0, self.omega_0, self.V_n, self.scale, self.scale])
        columns = []
        for k, h in enumerate(sizes):
            up, down = x.copy(), x.copy()
            up[k] += h
            down[k] -= h
            columns.append((np.array(self.rates(up, *inputs)) - np.array(self.rates(down, *inputs))) / (2.0 * h))
        kept = [0, 1, 2, *([3] if self.tau_P > 0.0 else []), *([4] if self.tau_Q > 0.0 else [])]
        return np.stack(columns, axis=1)[np.ix_(kept, kept)]
