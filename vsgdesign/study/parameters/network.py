"""What stands at the grid besides its impedance: a local load, a short circuit, and the breaker to the grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters.fields import number, section

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

    def admittance(self, omega: float) -> complex:
        """Admittance of a phase in S at an angular frequency in rad/s."""
        Y = 0.0 + 0.0j
        if self.R_parallel is not None:
            Y += 1.0 / self.R_parallel
        if self.L_parallel is not None:
            Y += 1.0 / (1j * omega * self.L_parallel)
        if self.C_parallel is not None:
            Y += 1j * omega * self.C_parallel
        if (self.R_series, self.L_series, self.C_series) != (None, None, None):
            Y += 1.0 / self.series_impedance(omega)
        return Y

    def series_impedance(self, omega: float) -> complex:
        """Impedance of the series branch in Ω at an angular frequency in rad/s; zero without one."""
        Z = complex(self.R_series or 0.0)
        if self.L_series is not None:
            Z += 1j * omega * self.L_series
        if self.C_series is not None:
            Z += 1.0 / (1j * omega * self.C_series)
        return Z

    def times(self, factor: float) -> Load:
        """A load of so many times the impedance."""

        def of(value: float | None, share: float) -> float | None:
            return None if value is None else value * share

        return Load(
            R_parallel=of(self.R_parallel, factor),
            L_parallel=of(self.L_parallel, factor),
            C_parallel=of(self.C_parallel, 1.0 / factor),
            R_series=of(self.R_series, factor),
            L_series=of(self.L_series, factor),
            C_series=of(self.C_series, 1.0 / factor),
        )

    def in_si(self, Z_base: float, omega_n: float) -> Load:
        """A load whose elements are reactances in pu (R, ωL, 1/(ωC)) in SI. ``Z_base`` in Ω, ``omega_n`` in rad/s."""

        def times(value: float | None, unit: float) -> float | None:
            return None if value is None else value * unit

        def capacitance(X_pu: float | None) -> float | None:
            return None if X_pu is None else 1.0 / (omega_n * Z_base) / X_pu

        return Load(
            R_parallel=times(self.R_parallel, Z_base),
            L_parallel=times(self.L_parallel, Z_base / omega_n),
            C_parallel=capacitance(self.C_parallel),
            R_series=times(self.R_series, Z_base),
            L_series=times(self.L_series, Z_base / omega_n),
            C_series=capacitance(self.C_series),
        )


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


@section
class SynchroCheck:
    """How near the voltages on both sides of an open breaker have to be before it closes (:eq:`synchro-check`)."""

    angle: float = number("rad", math.radians(0.1), 0.5 * math.pi, default=math.radians(10.0))
    """Largest difference of the angles."""
    V_pu: float = number("1", 0.001, 1.0, default=0.1)
    """Largest difference of the amplitudes, pu of rated."""
    omega: float = number("Hz", 0.001, 10.0, default=0.3, name="df", scale=2.0 * math.pi)
    """Largest difference of the frequencies."""
    around: float = number("rad", -math.pi, math.pi, default=0.0)
    """By how much the converter's side leads in the middle of the range of angles; not zero: out of phase on
    purpose."""


def only_a_grid(network: Network, what: str) -> None:
    """Raises InfeasibleStudyError for ``what``, which knows nothing but a grid, where there is more at the start."""
    if not network.plain:
        raise InfeasibleStudyError(
            f"{what} has nothing but a grid: leave [network] out of the study. vsgdesign run simulates it with its "
            "events."
        )
