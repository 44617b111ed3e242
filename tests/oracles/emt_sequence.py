"""The sequence controller of the limiter `balanced_power` in complex notation, for the reference EMT.

The ripple is a difference equation of second order in the power of the bridge, and the response of the voltage loop is
the solution of its three equations in phasors. Nothing of ``vsgdesign.equations`` is used.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from vsgdesign.study.parameters import Study


class SequenceController:
    """Its memory, and one call for each sample. The current must stay within its limit."""

    def __init__(self, study: Study) -> None:
        c, values = study.converter, study.limiter_values
        self.T, self.omega_n, self.L_1 = c.T_s, c.omega_n, study.filter.L_1
        V_pk = math.sqrt(2.0) * c.V_rated_rms
        self.nu, self.largest = 0j, values["negative_sequence_pu"] * V_pk
        self.untouched = values["untouched_ripple_pu"] * c.S_rated
        self.answer = -self.T / (values["balance_time"] * 0.75 * V_pk) * reference_over_current(study)
        width = 0.5 * math.sin(2.0 * c.omega_n * self.T)
        kept = (1.0 - width) / (1.0 + width)
        self.twice = 2.0 * math.cos(2.0 * c.omega_n * self.T)
        self.gain, self.ripple, self.ripple_before = 1.0 - kept, 0.0, 0.0
        self.seen: tuple[float, float] | None = None

    def hear(self, v: complex, i_s: complex, omega: float) -> None:
        """A sample in the frame of the converter. Afterwards ``nu`` is the negative sequence of the next one."""
        stored = 0.75 * self.L_1 * abs(i_s) ** 2
        at_node = 1.5 * (v * i_s.conjugate()).real
        if self.seen is None:
            self.seen = stored, at_node
        power = at_node + (stored - self.seen[0]) / self.T
        change, self.seen = power - self.seen[1], (stored, power)
        following = (self.twice - self.gain) * self.ripple - (1.0 - self.gain) * self.ripple_before + self.gain * change
        self.ripple_before, self.ripple = self.ripple, following
        beyond = math.copysign(max(abs(following) - self.untouched, 0.0), following)
        turn = cmath.exp(-2j * self.omega_n * self.T - self.T / 1.0)
        self.nu = self.nu * turn * (1.0 - 2j * (omega - self.omega_n) * self.T) + self.answer * beyond
        self.nu *= min(1.0, self.largest / abs(self.nu)) if self.nu else 1.0


def reference_over_current(study: Study) -> complex:
    """The negative sequence of the voltage reference over that of the grid current, with half of the grid: the voltage
    loop, its capacitor and the grid in the frame of the converter, where a negative sequence turns by −2ω."""
    f, g, inner, omega = study.filter, study.grid, study.inner_gains, study.converter.omega_n
    s = -2j * omega
    K = inner.K_pv + inner.K_iv / s
    drop = complex(inner.R_t, inner.X_t) * s / (s + study.omega_t)
    R, L = f.R_2 + 0.5 * g.R_g, f.L_2 + 0.5 * g.L_g
    # v, i and i_s for a reference of one volt.
    equations = [
        [1.0, -(R + (s + 1j * omega) * L), 0.0],
        [(s + 1j * omega) * f.C, 1.0, -1.0],
        [K - 1j * omega * f.C, K * drop - inner.K_ff, 1.0],
    ]
    return 1.0 / complex(np.linalg.solve(np.array(equations), np.array([0.0, 0.0, K]))[1])
