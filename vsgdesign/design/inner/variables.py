"""The numbers that a search turns, without units, and the two gain sets that it begins with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.parameters.study import Converter, Filter

Array = NDArray[np.float64]

NAMES = ("k_c", "k_v", "r_v", "r_c", "R_t", "omega_t", "K_ff", "X_t", "kappa")
"""k_c = K_pc T_s/L_1, k_v = K_pv Z_b, r_v = K_iv/K_pv and r_c = K_ic/K_pc over ω_n, R_t and X_t over Z_b, ω_t over ω_n,
K_ff and κ. See :eq:`inner-variables`."""

LOGARITHMIC = 6
"""The first six are searched in the logarithm."""

_BOUNDS = {
    "k_c": (0.1, 1.5),  # below, the current limit would act through the voltage loop; above, the loop is deadbeat
    "k_v": (0.05, 8.0),
    "r_v": (0.01, 10.0),
    "r_c": (2e-4, 16.0),
    "R_t": (1e-3, 1.0),
    "omega_t": (0.1, 4.0),
    "K_ff": (-1.0, 1.2),
    "X_t": (-0.4, 0.6),
    "kappa": (0.0, 2.0),
}

START_DELAYED = {
    "k_c": 0.50, "k_v": 0.97, "r_v": 2.3, "r_c": 29.0, "R_t": 0.12, "omega_t": 0.64, "K_ff": 0.61, "X_t": 0.11,
    "kappa": 1.5,
}  # fmt: skip
START_UNDELAYED = {
    "k_c": 0.61, "k_v": 1.75, "r_v": 1.9, "r_c": 75.0, "R_t": 0.07, "omega_t": 1.0, "K_ff": 0.69, "X_t": 0.23,
    "kappa": 0.0,
}  # fmt: skip
"""A closed form that fits many converters (:eq:`inner-start`): k_v is K_pv K_pc here, r_v is K_iv Z_b/ω_n, and r_c is
K_ic/K_pc in 1/s."""


@dataclass(frozen=True)
class Variables:
    """The search's box (n numbers) and how a point in it becomes gains in SI. Without delay κ is 0 and left out."""

    names: tuple[str, ...]
    low: Array
    high: Array
    K_pc: float
    """V/A that k_c = 1 stands for."""
    Z_base: float
    omega_n: float

    def decode(self, x: Array) -> tuple[InnerLoopGains, Array]:
        """Gains (arrays (M,), SI) and ω_t (M,) in rad/s of points (M, n), all within 0 and 1."""
        y = self.low + np.asarray(x, dtype=float) * (self.high - self.low)
        value = {name: y[:, k] for k, name in enumerate(self.names)}
        for name in NAMES[:LOGARITHMIC]:
            value[name] = np.exp(value[name])
        K_pc, K_pv = self.K_pc * value["k_c"], value["k_v"] / self.Z_base
        gains = InnerLoopGains(
            K_pv=K_pv, K_iv=K_pv * value["r_v"] * self.omega_n,
            K_pc=K_pc, K_ic=K_pc * value["r_c"] * self.omega_n,
            K_ff=value["K_ff"], R_t=value["R_t"] * self.Z_base, X_t=value["X_t"] * self.Z_base,
            kappa=value.get("kappa", np.zeros(len(y))),
        )  # fmt: skip
        return gains, value["omega_t"] * self.omega_n

    def encode(self, gains: InnerLoopGains, omega_t: float) -> Array:
        """The point (n,) of one gain set, moved into the box."""
        value = {
            "k_c": gains.K_pc / self.K_pc, "k_v": gains.K_pv * self.Z_base,
            "r_v": gains.K_iv / gains.K_pv / self.omega_n, "r_c": gains.K_ic / gains.K_pc / self.omega_n,
            "R_t": gains.R_t / self.Z_base, "omega_t": omega_t / self.omega_n,
            "K_ff": gains.K_ff, "X_t": gains.X_t / self.Z_base, "kappa": gains.kappa,
        }  # fmt: skip
        tiny = np.finfo(float).tiny
        y = [np.log(max(value[n], tiny)) if n in NAMES[:LOGARITHMIC] else value[n] for n in self.names]
        return np.clip((np.array(y, dtype=float) - self.low) / (self.high - self.low), 0.0, 1.0)


def variables(converter: Converter, filter_: Filter) -> Variables:
    """The search's variables for a converter and its filter (:eq:`inner-variables`)."""
    names = NAMES if converter.delay_samples else NAMES[:-1]
    limits = np.array([np.log(_BOUNDS[n]) if n in NAMES[:LOGARITHMIC] else _BOUNDS[n] for n in names])
    K_pc = filter_.L_1 / converter.T_s
    return Variables(names, limits[:, 0], limits[:, 1], K_pc, converter.Z_base, converter.omega_n)


def closed_form_start(converter: Converter, filter_: Filter) -> tuple[InnerLoopGains, float]:
    """Gains in SI and ω_t in rad/s from the closed form that the search begins with (:eq:`inner-start`)."""
    k = START_DELAYED if converter.delay_samples else START_UNDELAYED
    K_pc = k["k_c"] * filter_.L_1 / converter.T_s
    Z, omega_n = converter.Z_base, converter.omega_n
    gains = InnerLoopGains(
        K_pv=k["k_v"] / K_pc, K_iv=k["r_v"] / Z * omega_n, K_pc=K_pc, K_ic=k["r_c"] * K_pc,
        K_ff=k["K_ff"], R_t=k["R_t"] * Z, X_t=k["X_t"] * Z, kappa=k["kappa"],
    )  # fmt: skip
    return gains, k["omega_t"] * omega_n
