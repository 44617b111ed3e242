"""One control period in the source's frame, written again in complex numbers, with scipy's matrix exponential.

Nothing of ``vsgdesign.linear.model`` or ``vsgdesign.equations`` is used.
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from tests.oracles.emt_circuit import circuit_matrices
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Grid

Array = NDArray[np.float64]


class OnePeriod:
    """z → z' and outputs for a study on a grid, with ``push`` as the model's inputs (all deviations)."""

    def __init__(self, study: Study, grid: Grid, gains: dict[str, float], refs: dict[str, float]) -> None:
        """``refs`` has P_ref, Q_ref, V_g (rms) and omega_g."""
        self.study, self.gains, self.refs = study, gains, refs
        self.T = 1.0 / (study.converter.f_sw * study.converter.samples_per_carrier)
        self.A, self.b, self.e = circuit_matrices(study, grid)
        c = study.converter
        rated = math.sqrt(2.0) * c.S_rated / (3.0 * c.V_rated_rms)
        self.i_max = math.inf if c.current_limit_pu is None else c.current_limit_pu * rated
        self.v_max = c.V_dc / math.sqrt(3.0) if c.zero_sequence else 0.5 * c.V_dc
        self.limited = 0

    def shorten(self, vector: complex, limit: float) -> complex:
        """The vector, no longer than the limit."""
        if abs(vector) <= limit:
            return vector
        self.limited += 1
        return vector * (limit / abs(vector))

    def plant(self, x: NDArray[np.complex128], v_b: complex, V_g: float, omega: float) -> NDArray[np.complex128]:
        """Circuit after a period, in the frame that has turned along: states, held bridge, oscillating source."""
        M = np.zeros((5, 5), complex)
        M[:3, :3], M[:3, 3], M[:3, 4] = self.A, self.b, self.e
        M[4, 4] = 1j * omega
        after: Any = expm(M * self.T) @ np.array([*x, v_b, math.sqrt(2.0) * V_g])
        return after[:3] * cmath.exp(-1j * omega * self.T)

    def __call__(self, z: dict[str, float], push: dict[str, float]) -> tuple[dict[str, float], dict[str, float]]:
        study, T = self.study, self.T
        c, f, inner, g = study.converter, study.filter, study.inner_gains, self.gains
        refs = {name: value + push.get(name, 0.0) for name, value in self.refs.items()}
        x = np.array([complex(z[f"{n}_d"], z[f"{n}_q"]) for n in ("i_s", "v_c", "i_g")])
        v = x[1] + f.R_c * (x[0] - x[2])
        S = 1.5 * v * x[2].conjugate()
        P, Q = S.real + push.get("P_meas", 0.0), S.imag + push.get("Q_meas", 0.0)
        following = dict(z)
        used = []
        for name, tau, value in (("P_f", study.tau_P, P), ("Q_f", study.tau_Q, Q)):
            if tau > 0.0:
                value = z[name] + (1.0 - math.exp(-T / tau)) * (value - z[name])
                following[name] = value
            used.append(value)
        omega = z["omega_i"] - g["k_P"] * used[0] - g["k_Q"] * (used[1] + g["D_q"] * z["V"])
        e_P = refs["P_ref"] - used[0] + g["D_p"] * (c.omega_n - omega)
        e_Q = refs["Q_ref"] - used[1] + g["D_q"] * (c.V_rated_rms - z["V"])
        following["omega_i"] = z["omega_i"] + T * (g["K_ip"] * e_P + g["K_pq"] * e_Q)
        following["V"] = z["V"] + T * (g["K_qp"] * e_P + g["K_iq"] * e_Q)
        following["delta"] = z["delta"] + T * (omega - refs["omega_g"])

        theta, V = z["delta"] + push.get("theta_cmd", 0.0), z["V"] + push.get("V_cmd", 0.0)
        frame = cmath.exp(-1j * theta)
        v_dq, i_s, i_g = v * frame, x[0] * frame, x[2] * frame
        error = math.sqrt(2.0) * V - v_dq
        if "i_f_d" in z:
            change = i_g - complex(z["i_f_d"], z["i_f_q"])
            error -= complex(inner.R_t, inner.X_t) * change
            used_to = complex(z["i_f_d"], z["i_f_q"]) + (1.0 - math.exp(-study.omega_t * T)) * change
            following["i_f_d"], following["i_f_q"] = used_to.real, used_to.imag
        xi_v, xi_i = complex(z["xi_vd"], z["xi_vq"]), complex(z["xi_id"], z["xi_iq"])
        wanted = inner.K_pv * error + xi_v + inner.K_ff * i_g + 1j * c.omega_n * f.C * v_dq
        i_ref = self.shorten(wanted, self.i_max)
        xi_v += T * inner.K_iv * (error + (i_ref - wanted) / inner.K_pv)
        known = complex(z.get("pending_d", 0.0), z.get("pending_q", 0.0))
        known *= frame * cmath.exp(-0.5j * c.omega_n * T)
        error = i_ref - i_s - inner.kappa * T / f.L_1 * (known - v_dq - 1j * c.omega_n * f.L_1 * i_s)
        wanted = inner.K_pc * error + xi_i + v_dq + 1j * c.omega_n * f.L_1 * i_s
        v_b = self.shorten(wanted, self.v_max)
        xi_i += T * inner.K_ic * (error + (v_b - wanted) / inner.K_pc)
        v_b = v_b / frame * cmath.exp(1j * c.omega_n * (c.delay_samples + 0.5) * T)
        applied = complex(z["pending_d"], z["pending_q"]) if c.delay_samples else v_b
        back = cmath.exp(-1j * refs["omega_g"] * T)
        parts = {"xi_v": xi_v, "xi_i": xi_i}
        for name, value in parts.items():
            following[f"{name}d"], following[f"{name}q"] = value.real, value.imag
        if c.delay_samples:
            following["pending_d"], following["pending_q"] = (v_b * back).real, (v_b * back).imag
        x = self.plant(x, applied, refs["V_g"], refs["omega_g"])
        for name, value in zip(("i_s", "v_c", "i_g"), x, strict=True):
            following[f"{name}_d"], following[f"{name}_q"] = float(value.real), float(value.imag)
        outputs = {
            "P": P,
            "Q": Q,
            "omega": omega,
            "V": z["V"],
            "delta": z["delta"],
            "v_b_d": applied.real,
            "v_b_q": applied.imag,
        }
        return following, outputs
