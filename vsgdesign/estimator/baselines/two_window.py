"""ΔV/ΔI of two windows: the textbook's passive measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.estimator.baselines.record import ComplexArray, Estimates, Record, held


@dataclass(frozen=True)
class TwoWindows:
    """Z = ΔV/ΔI of the fundamental phasors of a window and of the one ``apart`` windows before it
    (:eq:`two-windows`). Answers only where the current has moved by ``gate`` of the largest current seen; holds the
    last answer otherwise."""

    apart: int = 10
    gate: float = 0.05
    name: str = "Two windows ΔV/ΔI"
    probe: None = None
    signals: str = "two_windows"

    def estimate(self, record: Record) -> Estimates:
        """From the frame that turns with the grid, where a steady phasor is a constant."""
        v, i = (x.reshape(len(x), record.windows, -1).mean(axis=2) for x in record.rotating())
        dv, di = (np.zeros_like(v) for _ in range(2))
        dv[:, self.apart :], di[:, self.apart :] = (x[:, self.apart :] - x[:, : -self.apart] for x in (v, i))
        seen = np.maximum.accumulate(np.abs(i), axis=1)
        valid = np.abs(di) > self.gate * seen
        with np.errstate(divide="ignore", invalid="ignore"):
            Z: ComplexArray = np.where(valid, dv / di, np.nan)
        return Estimates(held(Z.real, valid), held(Z.imag / record.omega[:, None], valid))
