"""Loads and faults of a suite, which are per unit, in SI."""

from __future__ import annotations

from dataclasses import replace

from vsgdesign.parameters.network import Fault, Load
from vsgdesign.parameters.study import Converter


def load_in_si(load: Load, converter: Converter) -> Load:
    """A load whose elements are R, ωL and 1/(ωC) over the base impedance at the nominal frequency, in Ω, H and F."""
    Z, omega = converter.Z_base, converter.omega_n

    def scaled(kind: str, value: float | None) -> float | None:
        if value is None:
            return None
        return {"R": value * Z, "L": value * Z / omega, "C": 1.0 / (omega * value * Z)}[kind]

    return Load(**{name: scaled(name[0], value) for name, value in vars(load).items()})


def fault_in_si(fault: Fault, converter: Converter) -> Fault:
    """A fault whose resistance is over the base impedance, in Ω."""
    return replace(fault, R=fault.R * converter.Z_base)


def admittance_pu(load: Load | None) -> complex:
    """Admittance of a suite's load at the nominal frequency, over that of the base."""
    if load is None:
        return 0j
    parallel = 0j
    if load.R_parallel:
        parallel += 1.0 / load.R_parallel
    if load.L_parallel:
        parallel += 1.0 / (1j * load.L_parallel)
    if load.C_parallel:
        parallel += 1j / load.C_parallel
    series = [load.R_series, load.L_series, load.C_series]
    if all(value is None for value in series):
        return parallel
    Z = complex(load.R_series or 0.0, (load.L_series or 0.0) - (load.C_series or 0.0))
    return parallel + (1.0 / Z if Z else complex("inf"))
