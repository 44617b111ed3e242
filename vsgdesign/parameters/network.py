"""What stands at the grid besides its impedance: a local load, a short circuit, and the breaker to the grid."""

from __future__ import annotations

from dataclasses import dataclass

THREE_PHASE = "three_phase"
PHASE_TO_PHASE = "phase_to_phase"
FAULT_KINDS = (THREE_PHASE, PHASE_TO_PHASE)
PHASE_PAIRS = ("ab", "bc", "ca")


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A short circuit to the neutral of the three-wire system, or between two phases."""

    kind: str = THREE_PHASE
    """A name of :data:`FAULT_KINDS`."""
    at: float = 0.0
    """Where it is, as a share of the grid's impedance: 0 at the PCC, towards 1 at the source (below 1)."""
    R: float = 0.0
    """Ω: of each phase to the common point of a three-phase fault, or between the two phases. Zero is bolted."""
    phases: str = "bc"
    """A name of :data:`PHASE_PAIRS`, of a fault between two phases."""


@dataclass(frozen=True, kw_only=True)
class Load:
    """A balanced load at the PCC: a parallel and a series branch per phase, in SI. None: there is no such element.

    The parallel elements lie side by side from the phase to the neutral point. The series branch is a resistance with
    an inductance and a capacitance in series, as far as they are given.
    """

    R_parallel: float | None = None
    L_parallel: float | None = None
    C_parallel: float | None = None
    R_series: float | None = None
    L_series: float | None = None
    C_series: float | None = None


@dataclass(frozen=True, kw_only=True)
class Network:
    """What is connected at the PCC besides the grid's impedance. Equal values are equal networks."""

    load: Load | None = None
    fault: Fault | None = None
    connected: bool = True
    """Whether the breaker between the PCC (with its load and faults at the PCC) and the grid's impedance is closed."""

    @property
    def plain(self) -> bool:
        """Whether nothing but the grid's impedance is there."""
        return self.load is None and self.fault is None and self.connected


PLAIN = Network()
