"""Passive measurement of the impedance by ΔV/ΔI between two windows, as in textbooks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vsgdesign.identification.frame import advanced, followed_frequency, sample_count, space_vector_variance, turned
from vsgdesign.identification.interface import (
    ComplexArray,
    Estimate,
    Installation,
    Needs,
    Samples,
    SpoiltBy,
    no_estimate,
    with_belief,
)


class TwoWindowState(NamedTuple):
    """State of the method."""

    angle: float
    omega: float
    v: ComplexArray
    """Fundamental phasors (apart,) of the last windows, the oldest first, V; NaN where there is none."""
    i: ComplexArray
    """A."""
    largest: float
    """Largest current so far, A."""
    R_g: float
    """The last answer, Ω; NaN before the first one."""
    L_g: float


@dataclass(frozen=True)
class TwoWindows:
    """Z = ΔV/ΔI from the fundamental phasors of a window and of the one ``apart`` windows before it
    (:eq:`two-windows`).

    There is a new answer only if the current has changed by ``gate`` times the largest current so far. Otherwise the
    last answer is held.
    """

    at: Installation
    apart: int = 10
    gate: float = 0.05
    believed: float = 0.3
    """An estimate is followed up to this standard deviation, relative to |Z|."""
    title: str = "Two windows ΔV/ΔI"
    signals: str = "two_windows"

    @property
    def needs(self) -> Needs:
        """It needs windows of α and β."""
        return Needs(self.at.samples, self.at.sample_interval)

    def first(self) -> TwoWindowState:
        """Nothing seen."""
        none = np.full(self.apart, np.nan, dtype=complex)
        return TwoWindowState(0.0, np.nan, none, none, 0.0, np.nan, np.nan)

    def probe(self, state: TwoWindowState) -> None:
        """This method needs no probe."""

    def update(self, state: TwoWindowState, samples: Samples) -> tuple[TwoWindowState, Estimate]:
        """The quotient for this window, or the last answer again."""
        at, length = self.at, self.at.sample_interval * sample_count(samples)
        spoilt = SpoiltBy(at.v_limit, at.i_limit).status(samples)
        if spoilt is not None:
            after = self._after(state, complex("nan"), complex("nan"))
            return after._replace(angle=advanced(state.angle, state.omega, length)), no_estimate(spoilt)
        omega = followed_frequency(state.omega, samples.omega, length)
        v, i, angle = turned(samples, state.angle, omega, at.sample_interval)
        v_now, i_now = complex(v.mean()), complex(i.mean())
        dv, di = v_now - complex(state.v[0]), i_now - complex(state.i[0])
        state = self._after(state, v_now, i_now)._replace(
            angle=angle, omega=omega, largest=max(state.largest, abs(i_now))
        )
        if not abs(di) > self.gate * state.largest:  # it is NaN if there is no window to compare with
            if np.isnan(state.R_g):
                return state, no_estimate("waiting", "the current has not changed yet: no estimate")
            return state, Estimate(state.R_g, state.L_g, "held")
        Z = dv / di
        state = state._replace(R_g=Z.real, L_g=Z.imag / omega)
        return state, with_belief(state.R_g, state.L_g, self._covariance(Z, di, omega, len(v)), omega, self.believed)

    def _after(self, state: TwoWindowState, v: complex, i: complex) -> TwoWindowState:
        return state._replace(v=np.append(state.v[1:], v), i=np.append(state.i[1:], i))

    def _covariance(self, Z: complex, di: complex, omega: float, count: int) -> np.ndarray | None:
        """Covariance of (R_g, L_g) from the noise of the sensors (:eq:`bound-two-windows`); None if this is not
        known."""
        if max(self.at.noise) == 0.0:
            return None
        s_v, s_i = (space_vector_variance(deviation) / count for deviation in self.at.noise)
        each = (s_v + abs(Z) ** 2 * s_i) / abs(di) ** 2
        return np.diag([each, each / omega**2])
