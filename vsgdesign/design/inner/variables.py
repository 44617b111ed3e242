"""The numbers that a search turns, without units, and the two gain sets that it begins with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.parameters.converter import Converter, Filter

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

SLOW = 5.0
"""Sampling frequency over the highest resonance, below which a second closed form is worth a start."""


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
            K_pv=K_pv,
            K_iv=K_pv * value["r_v"] * self.omega_n,
            K_pc=K_pc,
            K_ic=K_pc * value["r_c"] * self.omega_n,
            K_ff=value["K_ff"],
            R_t=value["R_t"] * self.Z_base,
            X_t=value["X_t"] * self.Z_base,
            kappa=value.get("kappa", np.zeros(len(y))),
        )
        return gains, value["omega_t"] * self.omega_n

    def encode(self, gains: InnerLoopGains, omega_t: float) -> Array:
        """The point (n,) of one gain set, moved into the box."""
        value = {
            "k_c": gains.K_pc / self.K_pc,
            "k_v": gains.K_pv * self.Z_base,
            "r_v": gains.K_iv / gains.K_pv / self.omega_n,
            "r_c": gains.K_ic / gains.K_pc / self.omega_n,
            "R_t": gains.R_t / self.Z_base,
            "omega_t": omega_t / self.omega_n,
            "K_ff": gains.K_ff,
            "X_t": gains.X_t / self.Z_base,
            "kappa": gains.kappa,
        }
        tiny = np.finfo(float).tiny
        y = [np.log(max(value[n], tiny)) if n in NAMES[:LOGARITHMIC] else value[n] for n in self.names]
        return np.clip((np.array(y, dtype=float) - self.low) / (self.high - self.low), 0.0, 1.0)


def variables(converter: Converter, filter_: Filter) -> Variables:
    """The search's variables for a converter and its filter (:eq:`inner-variables`)."""
    names = NAMES if converter.delay_samples else NAMES[:-1]
    limits = np.array([np.log(_BOUNDS[n]) if n in NAMES[:LOGARITHMIC] else _BOUNDS[n] for n in names])
    K_pc = filter_.L_1 / converter.T_s
    return Variables(names, limits[:, 0], limits[:, 1], K_pc, converter.Z_base, converter.omega_n)


def closed_form_starts(
    converter: Converter, filter_: Filter, sampling_ratio: float
) -> list[tuple[InnerLoopGains, float]]:
    """Gains in SI with ω_t in rad/s that the search begins with (:eq:`inner-start`).

    With a delay and a low ``sampling_ratio`` (sampling frequency over the highest resonance) there are two.
    """
    Z, omega_n, fastest = converter.Z_base, converter.omega_n, filter_.L_1 / converter.T_s

    def made(K_pc: float, K_pv: float, K_iv: float, K_ic: float, K_ff: float, Z_t: complex, omega: float, kappa: float):
        gains = InnerLoopGains(K_pv, K_iv, K_pc, K_ic, K_ff, Z_t.real * Z, Z_t.imag * Z, kappa)
        return gains, omega * omega_n

    if converter.delay_samples == 0:
        K_pc = 0.61 * fastest
        return [made(K_pc, 1.75 / K_pc, 1.9 * omega_n / Z, 75.0 * K_pc, 0.69, 0.07 + 0.23j, 1.0, 0.0)]
    K_pc = 0.50 * fastest
    starts = [made(K_pc, 0.97 / K_pc, 2.3 * omega_n / Z, 29.0 * K_pc, 0.61, 0.12 + 0.11j, 0.64, 1.5)]
    if sampling_ratio < SLOW:
        K_pc = 0.11 * fastest
        starts.append(made(K_pc, 6.0 / Z, 0.9 * omega_n / Z, 1.9 * omega_n * K_pc, 0.4, 0.9 - 0.13j, 3.0, 1.95))
    return starts
