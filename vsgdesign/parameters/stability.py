"""Reads the [stability] section: the axes of the margin maps and the gates."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.study import ClosedFormTarget

DEFAULT_SCR = (1.2, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 12.5, 16.0, 20.0)
DEFAULT_X_OVER_R = (0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 14.0, 20.0)
DEFAULT_ERRORS = (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)


@dataclass(frozen=True)
class Gates:
    """Gates: limits for the margins of a design. They are set in the study and do not come from a grid code."""

    damping_ratio: float = 0.3
    gain_margin_db: float = 6.0
    phase_margin_deg: float = 30.0
    M_s: float = 2.0
    settling_time: float = 1.0


@dataclass(frozen=True)
class StabilitySpec:
    """Axes of the margin maps: SCR × X/R × every combination of P (W) and Q (var), and estimate errors."""

    scr: tuple[float, ...]
    x_over_r: tuple[float, ...]
    P: tuple[float, ...]
    Q: tuple[float, ...]
    errors: tuple[float, ...]
    """Relative errors of R_g and L_g, each taking every value."""
    gates: Gates


def read_stability(
    table: TableReader | None, converter: Converter, target: ClosedFormTarget, settling_time: float
) -> StabilitySpec:
    """The section, or its defaults: SCR 1.2–20 × X/R 0.5–20 at the design point of the power loops.

    ``settling_time`` (s) is what the study asks of its steps: the gate's default.
    """
    gates = Gates(settling_time=settling_time)
    if table is None:
        return StabilitySpec(DEFAULT_SCR, DEFAULT_X_OVER_R, (target.P,), (target.Q,), DEFAULT_ERRORS, gates)
    limit = 2.0 * converter.S_rated
    spec = StabilitySpec(
        scr=table.quantities("scr", "1", 0.05, 1e4, DEFAULT_SCR),
        x_over_r=table.quantities("x_over_r", "1", 1e-3, 1e4, DEFAULT_X_OVER_R),
        P=table.quantities("P", "W", -limit, limit, (target.P,)),
        Q=table.quantities("Q", "var", -limit, limit, (target.Q,)),
        errors=table.quantities("errors", "1", -0.9, 10.0, DEFAULT_ERRORS),
        gates=_read_gates(table.child("gates"), gates),
    )
    table.finish()
    return spec


def _read_gates(table: TableReader | None, default: Gates) -> Gates:
    if table is None:
        return default
    gates = Gates(
        damping_ratio=table.quantity("damping_ratio", "1", 0.0, 1.0, default=default.damping_ratio),
        gain_margin_db=table.quantity("gain_margin_db", "1", 0.0, 60.0, default=default.gain_margin_db),
        phase_margin_deg=table.quantity("phase_margin_deg", "1", 0.0, 180.0, default=default.phase_margin_deg),
        M_s=table.quantity("M_s", "1", 1.0, 100.0, default=default.M_s),
        settling_time=table.quantity("settling_time", "s", 1e-3, 1000.0, default=default.settling_time),
    )
    table.finish()
    return gates
