"""The probe of an estimator as a run injects it, between the stretches of the compiled loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.field.lock_in import probe_offset
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.identification import Probe

if TYPE_CHECKING:
    from vsgdesign.equations.controller import ControllerState
    from vsgdesign.equations.power_loops import References
    from vsgdesign.study.parameters.study import Study


class HeldProbe:
    """The probes of a run of so many samples, each value held for ``hold`` s. It remembers what it sent."""

    def __init__(self, hold: float, study: Study, samples: int) -> None:
        T_s = study.converter.T_s
        self._every = round(hold / T_s)
        if self._every < 1 or abs(hold / T_s - self._every) > 1e-6:
            raise InfeasibleStudyError(
                f"probe: hold = {hold:.6g} s is not a whole multiple of the controller's sampling period, "
                f"{T_s:.6g} s. Choose one that is, or another carrier frequency."
            )
        self._V_rated_rms, self._S_rated = study.converter.V_rated_rms, study.converter.S_rated
        self._sent = np.zeros(samples // self._every + 1, dtype=complex)
        self._asked: Probe | None = None
        self._probe, self._begin = Probe(np.zeros(1, dtype=complex), hold), 0

    def cuts(self, samples: int) -> set[int]:
        """Samples at which what is added may change."""
        return set(range(0, samples + 1, self._every))

    def ask(self, sample: int, probe: Probe | None) -> None:
        """What is to be sent from the next change on; None: nothing. The probe that is sent already goes on."""
        if probe is not self._asked:
            if probe is not None and (abs(probe.hold - self._probe.hold) > 1e-9 or len(probe.values) == 0):
                raise InfeasibleStudyError(
                    f"probe: {len(probe.values)} values of {probe.hold:.6g} s are asked for in a run that holds each "
                    f"for {self._probe.hold:.6g} s. Give at least one value, held as long as probe_hold says."
                )
            self._asked = probe
            self._probe = Probe(np.zeros(1, dtype=complex), self._probe.hold) if probe is None else probe
            self._begin = -(-sample // self._every)

    def value(self, sample: int) -> complex:
        """What is sent at a sample."""
        at, values = sample // self._every, self._probe.values
        if at >= self._begin:  # else what was sent before is held to the end
            self._sent[at] = values[(at - self._begin) % len(values)]
        return complex(self._sent[at])

    def sent_over(self, begin: int, end: int, step: int) -> NDArray[np.complex128]:
        """What was sent at every ``step``-th sample from ``begin`` up to before ``end``."""
        return self._sent[np.arange(begin, end, step) // self._every]

    def offset(self, sample: int, V_rms: float) -> tuple[float, float]:
        """What is added from a sample on to V (rms) and to θ (rad) (:eq:`probe`)."""
        value = self.value(sample)
        if self._probe.quantity != "voltage":
            return 0.0, 0.0
        added_V, added_theta = probe_offset(value.real, value.imag, V_rms, self._V_rated_rms)
        return float(added_V), float(added_theta)

    def references(self, sample: int, refs: References) -> References:
        """The references with what a probe of power adds from a sample on."""
        if self._probe.quantity != "power":
            return refs
        power = self.value(sample) * self._S_rated
        return refs._replace(P_ref=refs.P_ref + power.real, Q_ref=refs.Q_ref + power.imag)


def add_offset(state: ControllerState, V_rms: float, theta: float) -> ControllerState:
    """The state with V and θ moved."""
    return state._replace(V=state.V + V_rms, theta=state.theta + theta)
