"""The dc link of the reference EMT: the balance of a capacitor and its source, integrated by DOP853 with the circuit.

Nothing of ``vsgdesign.equations`` is used. The sources are written from their physics, and what they decide at a sample
is decided here at the sample as well.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.optimize import brentq

from tests.oracles.emt_circuit import Changing
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.event import Event

Array = NDArray[np.complex128]


class Battery:
    """dq/dt = −i, v_oc by straight lines between six points; one more state, the state of charge."""

    def __init__(self, study: Study, memory: Sequence[float]) -> None:
        assert study.dc is not None
        self.p, self.nominal, self.s = study.dc.values, study.dc.values, memory[0]

    def decide(self, v: float, _p_b: float) -> None:
        i = (self._open(self.s) - v) / self.p["R_i"]
        high = self.p["i_max"] if self.s > 0.0 else 0.0
        low = -self.p["i_charge_max"] if self.s < 1.0 else 0.0
        self.held = None if low <= i <= high else min(max(i, low), high)

    def change(self, event: Event) -> None:
        if event.dc_power is not None:
            self.p |= {name: event.dc_power * self.nominal[name] for name in ("i_max", "i_charge_max")}
        if event.dc_charge is not None:
            self.s = event.dc_charge

    def _open(self, charge: float) -> float:
        points = self.p["open_circuit"]
        k = min(max(int(charge * 5.0), 0), 4)
        return points[k] + (points[k + 1] - points[k]) * (5.0 * charge - k)

    def current(self, v: float, s: float) -> tuple[float, float]:
        """Current, and the slope of the source's own state."""
        i = (self._open(s) - v) / self.p["R_i"] if self.held is None else self.held
        return i, -i / (3600.0 * self.p["capacity_Ah"])


class Stage:
    """A power that follows a target; its state is the power."""

    def __init__(self, study: Study, memory: Sequence[float]) -> None:
        assert study.dc is not None
        self.p, self.T, self.V = study.dc.values, study.converter.T_s, study.converter.V_dc
        self.s, self.target, self.nominal = *memory[:2], self.p["p_max"]

    def change(self, event: Event) -> None:
        if event.dc_power is not None:
            self.p["p_max"] = event.dc_power * self.nominal

    def decide(self, v: float, p_b: float) -> None:
        asked = self.p["k_p"] * (self.V - v) + self.p["feed_forward"] * p_b
        asked = min(max(asked, -self.p["p_charge_max"]), self.p["p_max"])
        step = self.p["ramp"] * self.T
        self.target += min(max(asked - self.target, -step), step)

    def current(self, v: float, s: float) -> tuple[float, float]:
        return s / v, (self.target - s) / self.p["tau"]


class Module:
    """The single diode of a module, solved at every voltage; it has no state."""

    def __init__(self, study: Study, _memory: Sequence[float]) -> None:
        assert study.dc is not None
        self.p, self.s = study.dc.values, 0.0
        p, kelvin = self.p, self.p["temperature"] + 273.15
        # De Soto, Klein, Beckman (2006): silicon, 1.121 eV, −0.0002677 1/K.
        gap = 1.121 * (1.0 - 0.0002677 * (kelvin - 298.15))
        hotter = (kelvin / 298.15) ** 3 * math.exp((1.121 / 298.15 - gap / kelvin) / 8.617333e-5)
        self.light = p["irradiance"] / 1000.0 * (p["I_L"] + p["alpha_sc"] * (kelvin - 298.15))
        self.dark, self.a = p["I_0"] * hotter, p["a"] * kelvin / 298.15
        self.shunt, self.clear_sky = p["R_sh"] * 1000.0 / p["irradiance"], self.light / p["irradiance"]

    def change(self, event: Event) -> None:
        if event.irradiance is not None:
            self.light = self.clear_sky * event.irradiance
            self.shunt = self.p["R_sh"] * 1000.0 / event.irradiance

    def decide(self, _v: float, _p_b: float) -> None:
        pass

    def current(self, v: float, _s: float) -> tuple[float, float]:
        one = v / self.p["modules"]

        def left(i: float) -> float:
            u = one + i * self.p["R_s"]
            return self.light - self.dark * math.expm1(u / self.a) - u / self.shunt - i

        return self.p["strings"] * float(brentq(left, -1.0, 2.0 * self.light, xtol=1e-14, rtol=1e-14)), 0.0


class Link:
    """A dc link with its source, and what is decided at a sample."""

    def __init__(self, study: Study, v: float, p_b: float, memory: Sequence[float]) -> None:
        assert study.dc is not None
        kinds: dict[str, Any] = {"battery": Battery, "converter": Stage, "photovoltaic": Module}
        self.source = kinds[study.dc.source](study, memory)
        self.v, self.p_b, self.C, self.T = v, p_b, study.dc.C, study.converter.T_s
        self.bleed = 0.0 if study.dc.R_bleed is None else 1.0 / study.dc.R_bleed
        self.share = 1.0 / math.sqrt(3.0) if study.converter.zero_sequence else 0.5
        self.nominal, self.measured = study.converter.V_dc, study.dc.compensation == "measured"
        self.trace: list[float] = []
        self.events = [event for event in study.events if event.of_dc]

    @property
    def limit(self) -> float:
        """The largest voltage of the bridge."""
        return self.share * (self.v if self.measured else self.nominal)

    def acting(self, asked: complex) -> complex:
        return asked if abs(asked) <= self.limit else asked * (self.limit / abs(asked))

    def sampled(self, t_s: float) -> None:
        """What the source decides at a sample, after the events up to it."""
        while self.events and self.events[0].t_s <= t_s + 1e-6 * self.T:
            self.source.change(self.events.pop(0))
        self.source.decide(self.v, self.p_b)
        self.trace.append(self.v)

    def slopes(self, v: float, s: float, p_b: float) -> list[float]:
        """Of its voltage, of its source's own state and of the energy that the bridge takes."""
        i, of_source = self.source.current(v, s)
        return [(i - self.bleed * v - p_b / v) / self.C, of_source, p_b]

    def at_end(self, v: float, s: float, energy: float) -> None:
        """The end of a period, in which the bridge took an energy."""
        self.v, self.source.s, self.p_b = v, s, energy / self.T


class WithLink(Link, Changing):
    """The circuit with a dc link that feeds its bridge, averaged or switched (``pwm``)."""

    def __init__(self, study: Study, v: float, p_b: float, memory: Sequence[float], pwm: bool = False) -> None:
        Changing.__init__(self, study, lambda grid: grid)
        Link.__init__(self, study, v, p_b, memory)
        self.follows = pwm or not self.measured
        """Whether the bridge's voltage follows that of the link within a period."""
        self.of_link = 1e-13 * np.array([study.converter.V_dc, 1.0, study.converter.S_rated])

    def bridge_limit(self, before: float) -> float:
        del before
        return self.limit

    def modulating(self, study: Study) -> Study:
        self.divides_by = self.v if self.measured else self.nominal
        return replace(study, converter=replace(study.converter, V_dc=self.divides_by))

    def moved(self, x: Array, pieces: Sequence[tuple], atol: NDArray[np.float64], _begin: float = 0.0) -> Any:
        """The circuit's state after a period, with that of the link, its source and the energy that the bridge took."""
        self.sampled(len(self.trace) * self.T)
        y = np.concatenate([x.real, x.imag, [self.v, self.source.s, 0.0]])
        tolerance: Any = np.concatenate([atol, atol, self.of_link])
        n = len(x)
        for piece in pieces:
            P = piece[-1][1]
            if P is not None and P is not self.now:  # the network changes
                jumped = P[0] @ (y[:n] + 1j * y[n : 2 * n]) + P[1] @ (y[:n] - 1j * y[n : 2 * n])
                y, self.now = np.concatenate([jumped.real, jumped.imag, y[2 * n :]]), P
            solver = DOP853(
                self._slopes(len(x), piece), 0.0, y, piece[0], rtol=1e-10, atol=tolerance, first_step=0.25 * piece[0]
            )
            while solver.status == "running":
                solver.step()
            if solver.status != "finished":
                raise RuntimeError("DOP853 failed on the dc link")
            y = solver.y
        self.at_end(*(float(value) for value in y[2 * n : 2 * n + 3]))
        return y[:n] + 1j * y[n : 2 * n]

    def _slopes(self, n: int, piece: tuple) -> Callable[[float, Any], Any]:
        _, asked, (peak, peak_slope, phase, omega, omega_slope, others, *_), (matrices, _) = piece
        A, b, e, A_unequal, b_unequal, e_unequal = matrices
        divides_by = self.divides_by

        def slopes(t: float, y: Any) -> Any:
            x, v = y[:n] + 1j * y[n : 2 * n], y[2 * n]
            turned = phase + t * (omega + 0.5 * omega_slope * t)
            v_g = (peak + peak_slope * t) * cmath.exp(1j * turned)
            v_g += sum(size * cmath.exp(1j * (order * turned + angle)) for order, size, angle in others)
            v_b = complex(asked * v / divides_by if self.follows else asked)
            of_circuit = A @ x + b * v_b + e * v_g
            # Real parts are the α axis, imaginary parts the β axis; the conjugate tells them apart.
            of_circuit += A_unequal @ x.conj() + b_unequal * v_b.conjugate() + e_unequal * v_g.conjugate()
            p_b = 1.5 * (v_b * x[0].conjugate()).real
            return np.concatenate([of_circuit.real, of_circuit.imag, self.slopes(v, y[2 * n + 1], p_b)])

        return slopes
