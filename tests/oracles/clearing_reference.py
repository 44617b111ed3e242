"""Faults that end phase by phase at the zeros of their currents, found by SciPy's detection of events.

The rule is written again from its description: after a fault is cleared, the phase whose current is zero first is
interrupted, and the other two, through twice the resistance, at the zero of theirs. The currents are those of this
oracle's own circuit, and the instants are roots on DOP853's dense output.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.oracles.emt_circuit import Changing
from tests.oracles.network_reference import network_matrices, states
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Fault

_TURN = {phase: cmath.exp(2j * math.pi * k / 3.0) for k, phase in enumerate("abc")}


class Interrupting(Changing):
    """The circuit of a study that clears one fault, with the instants that it finds."""

    def __init__(self, study: Study, asked_s: float) -> None:
        super().__init__(study, lambda grid: grid)
        self.asked_s = asked_s
        self.found: list[tuple[float, str]] = []
        """Instants, and the phases whose current ends then."""
        self._study = study
        events = sorted(study.events, key=lambda event: event.t_s)
        self._grid = ([study.grid] + [e.grid for e in events if e.grid is not None and e.t_s < asked_s])[-1]
        self._network = ([study.network] + [e.network for e in events if e.network and e.t_s < asked_s])[-1]
        faults = {e.network.fault.at for e in events if e.network is not None and e.network.fault is not None}
        self._shares = tuple(sorted(faults - {0.0}))
        self._load = any(e.network is not None and e.network.load is not None for e in events)
        self._left: Fault | None = self._network.fault
        self._held: Any = None
        self._hold()

    def _hold(self) -> None:
        network = replace(self._network, fault=self._left)
        self._held = network_matrices(self._study, self._grid, network, self._shares, self._load)

    def at(self, instant: float) -> tuple:
        if self._left is not None and instant >= self.asked_s:
            return self._held
        return super().at(instant)

    def moved(
        self, x: NDArray[np.complex128], pieces: Any, atol: NDArray[np.float64], _begin: float = 0.0
    ) -> NDArray[np.complex128]:
        begin = _begin
        for length, v_b, given, _ in pieces:
            source, end = given, begin + length
            while self._left is not None and 0.5 * (begin + end) > self.asked_s:
                zero = self._zero(x, end - begin, v_b, source)
                if zero is None:
                    break
                tau, phase, x = zero
                begin, source = begin + tau, _later(source, tau)
                self._interrupt(begin, phase)
                P, P_conj = self.at(0.5 * (begin + end))[1]
                self.now = (P, P_conj)
                x = P @ x + P_conj @ x.conj()
            x = super().moved(x, [(end - begin, v_b, source, self.at(0.5 * (begin + end)))], atol)
            begin = end
        return x

    def _interrupt(self, instant: float, phase: str) -> None:
        left = self._left
        assert left is not None
        if left.kind == "three_phase":
            pair = {"a": "bc", "b": "ca", "c": "ab"}[phase]
            self.found.append((instant, phase))
            self._left = Fault(kind="phase_to_phase", at=left.at, R=2.0 * left.R, phases=pair)
            self._hold()
        else:
            self.found.append((instant, "".join(sorted(left.phases))))
            self._left = None

    def fault_current(self, x: NDArray[np.complex128]) -> complex:
        """The space vector of the current into the fault, from the currents of its node."""
        assert self._left is not None
        at = dict(zip(states(self._shares, self._load), x, strict=True))
        if self._left.at > 0.0:
            node = self._shares.index(self._left.at)
            return at[f"i_g{node}"] - at[f"i_g{node + 1}"]
        return at["i_2"] - at["i_g0"] - at.get("i_lp", 0.0) - at.get("i_ls", 0.0)

    def _zero(self, x: NDArray[np.complex128], length: float, v_b: complex, source: tuple) -> Any:
        """(time, phase, state) of the first zero within a piece; None if there is none."""
        assert self._left is not None
        A, b, e, A_conj, b_conj, e_conj = self._held[0]
        phases = "abc" if self._left.kind == "three_phase" else self._left.phases[0]
        forced = b * v_b + b_conj * v_b.conjugate()

        def derivative(t: float, y: NDArray[np.complex128]) -> NDArray[np.complex128]:
            peak, peak_slope, phase, omega, omega_slope, *_ = source
            v_g = (peak + peak_slope * t) * cmath.exp(1j * (phase + t * (omega + 0.5 * omega_slope * t)))
            return A @ y + A_conj @ y.conj() + forced + e * v_g + e_conj * v_g.conjugate()

        crossings = [
            lambda _t, y, turn=_TURN[phase]: (self.fault_current(y) * turn.conjugate()).real for phase in phases
        ]
        for crossing in crossings:
            crossing.terminal = True  # type: ignore[attr-defined]
        found = solve_ivp(
            derivative, (0.0, length), x, method="DOP853", rtol=1e-11, atol=1e-10, events=crossings, first_step=length
        )
        times = [
            (float(t[0]), phase, y[0])
            for t, phase, y in zip(found.t_events, phases, found.y_events, strict=True)
            if len(t)
        ]
        return min(times, key=lambda one: one[0]) if times else None


def _later(source: tuple, tau: float) -> tuple:
    """The same ramp of the fundamental, described from ``tau`` later on."""
    peak, peak_slope, phase, omega, omega_slope, *rest = source
    turned = phase + tau * (omega + 0.5 * omega_slope * tau)
    return (peak + peak_slope * tau, peak_slope, turned, omega + omega_slope * tau, omega_slope, *rest)
