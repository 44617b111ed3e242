"""A small voltage added to the converter's own, to measure the grid with; added between stretches, not in the loop."""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError

if TYPE_CHECKING:
    from vsgdesign.equations.controller import ControllerState
    from vsgdesign.parameters.study import Study


@dataclass(frozen=True, eq=False)
class Probe:
    """What is added to the reference of the inner voltage loop, over and over from t = 0 on (:eq:`probe`).

    ``values`` (K,), complex, are d and q in the converter's frame, relative to the rated voltage; each is held for
    ``hold`` s, a whole multiple of the controller's sampling period. The power loops see its answer in P and Q,
    and the Q loop's droop sees the added magnitude. The angle that a run logs includes the probe.
    """

    values: NDArray[np.complex128]
    hold: float


class HeldProbe:
    """A probe, as a run takes it."""

    def __init__(self, probe: Probe, study: Study) -> None:
        T_s = study.converter.T_s
        self._every = round(probe.hold / T_s)
        if self._every < 1 or abs(probe.hold / T_s - self._every) > 1e-6:
            raise InfeasibleStudyError(
                f"probe: hold = {probe.hold:.6g} s is no whole multiple of the controller's sampling period, "
                f"{T_s:.6g} s. Choose one that is, or another carrier frequency."
            )
        self._voltages = [complex(value) * study.converter.V_rated_rms for value in probe.values]

    def cuts(self, samples: int) -> set[int]:
        """Samples at which the added voltage may change."""
        return set(range(0, samples + 1, self._every))

    def offset(self, sample: int, V_rms: float) -> tuple[float, float]:
        """What is added from a sample on to V (rms) and to θ (rad)."""
        whole = V_rms + self._voltages[sample // self._every % len(self._voltages)]
        return abs(whole) - V_rms, cmath.phase(whole)


def add_offset(state: ControllerState, V_rms: float, theta: float) -> ControllerState:
    """The state with V and θ moved."""
    return state._replace(V=state.V + V_rms, theta=state.theta + theta)
