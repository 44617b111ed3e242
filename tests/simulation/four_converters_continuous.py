"""The continuous equations of the four converters in complex numbers, with coils and capacitors or with phasors."""

from __future__ import annotations

import cmath

import numpy as np

from tests.simulation.four_converters import (
    CONVERTERS,
    K_I,
    K_IP,
    LOAD_P,
    LOAD_Q,
    OMEGA,
    R_PR,
    REACTORS,
    T_LPF,
    T_PLL,
    VOLTAGES,
    FollowingState,
    Published,
    branches,
    held,
    susceptances,
    voltage_at,
)


def slopes(c: Published, state: FollowingState, v: complex, i: complex, K_pp: float) -> tuple[FollowingState, complex]:
    """dx/dt of its controller, and the voltage of the bridge, pu. ``v``, ``i``: in its frame, pu."""
    P, Q = (v * i.conjugate()).real, (v * i.conjugate()).imag
    kept = abs(v + (R_PR + 1j * c.L) * i) if c.keeps_voltage else Q
    more = state.y - (held(c) if c.keeps_voltage else c.Q / c.S)
    v_q = c.ratio * v.imag
    omega = 1.0 + 10.0 / (T_PLL * OMEGA) * v_q + state.w
    e_p = c.P / c.S - state.P
    e_d = K_pp * e_p + state.i_p - i.real
    e_q = c.K_v * T_LPF * more + state.i_y - i.imag
    u_d = c.K_p * e_d + state.xi_d + v.real - omega * c.L * i.imag
    u_q = c.K_p * e_q + state.xi_q + omega * c.L * i.real
    rates = FollowingState(
        theta=OMEGA * (omega - 1.0),
        w=25.0 / (T_PLL**2 * OMEGA) * v_q,
        xi_d=K_I * e_d,
        xi_q=K_I * e_q,
        P=(P - state.P) / T_LPF,
        i_p=K_IP * e_p,
        y=(kept - state.y) / T_LPF,
        i_y=c.K_v * more,
    )
    return rates, u_d + 1j * u_q


def admittance(circuits: int, S_sc: float) -> np.ndarray:
    """Of all buses at 50 Hz, load and source included, S."""
    at = {bus: k for k, bus in enumerate(VOLTAGES)}
    Y = np.diag([1j * susceptances(circuits)[bus] for bus in VOLTAGES])
    for _, a, b, R, X in branches(circuits):
        ends, y = np.zeros(len(at)), 1.0 / (R + 1j * X)
        ends[at[a]], ends[at[b]] = 1.0, -1.0
        Y += y * np.outer(ends, ends)
    for bus, X in REACTORS.items():
        Y[at[bus], at[bus]] += 1.0 / (1j * X)
    Y[at["C"], at["C"]] += (LOAD_P - 1j * LOAD_Q + S_sc / 1j) / 400.0**2
    return Y


class Continuous:
    """The same system in complex numbers in the frame of the source, with continuous controllers."""

    def __init__(self, S_sc: float, circuits: int, K_pp: float, phasors: bool) -> None:
        self.S_sc, self.K_pp, self.phasors = S_sc, K_pp, phasors
        self.at = {bus: k for k, bus in enumerate(VOLTAGES)}
        self.C = np.array([susceptances(circuits)[bus] for bus in VOLTAGES])
        load = (LOAD_P / 400.0**2, 400.0**2 / LOAD_Q)
        self.G = np.array([load[0] * (bus == "C") for bus in VOLTAGES])
        self.coils = [(a, b, R, X) for _, a, b, R, X in branches(circuits)]
        self.coils += [(bus, None, 0.0, X) for bus, X in (*REACTORS.items(), ("C", load[1]))]
        self.coils.append(("C", "source", 0.0, 400.0**2 / S_sc))
        self.Z = np.linalg.inv(admittance(circuits, S_sc))

    def slope(self, x: np.ndarray) -> np.ndarray:
        """dx/dt: of voltages and coils (unless these are phasors), then of the converters' currents and controllers."""
        count = 0 if self.phasors else len(self.at) + len(self.coils)
        fast, own = x[: 2 * count].view(complex), x[2 * count :].reshape(len(CONVERTERS), -1)
        into = np.zeros(len(self.at), dtype=complex)
        for c, row in zip(CONVERTERS, own, strict=True):
            into[self.at[c.bus]] += c.S / c.level * complex(*row[:2]) * cmath.exp(1j * row[2])
        source = 400.0
        if self.phasors:
            into[self.at["C"]] += self.S_sc / 1j / 400.0**2 * source
            v, rates = self.Z @ into, np.array([])
        else:
            v, i = fast[: len(self.at)], fast[len(self.at) :]
            of = {None: 0.0, "source": source, **dict(zip(self.at, v, strict=True))}
            over = np.array([of[a] - of[b] for a, b, _, _ in self.coils])
            R, X = (np.array([one[k] for one in self.coils]) for k in (2, 3))
            for (a, b, _, _), current in zip(self.coils, i, strict=True):
                into[self.at[a]] -= current
                if b in self.at:
                    into[self.at[b]] += current
            slopes_v = OMEGA * (into / self.C - (self.G / self.C + 1j) * v)
            rates = np.concatenate((slopes_v, OMEGA / X * (over - (R + 1j * X) * i))).view(float)
        found = [rates]
        for c, row in zip(CONVERTERS, own, strict=True):
            current, state = complex(*row[:2]), FollowingState(*row[2:])
            u = v[self.at[c.bus]] / c.level * cmath.exp(-1j * state.theta)
            follows, bridge = slopes(c, state, u, current, self.K_pp)
            turned = 1.0 + follows.theta / OMEGA
            moved = OMEGA / c.L * (bridge - u - (R_PR + 1j * c.L * turned) * current)
            found.append(np.array([moved.real, moved.imag, *follows]))
        return np.concatenate(found)

    def at_rest(self) -> np.ndarray:
        """Near the published load flow; Newton's method finds the rest."""
        v = np.array([voltage_at(bus) for bus in VOLTAGES])
        of = {None: 0.0, "source": 400.0, **dict(zip(self.at, v, strict=True))}
        i = np.array([(of[a] - of[b]) / (R + 1j * X) for a, b, R, X in self.coils])
        x = [] if self.phasors else [np.concatenate((v, i)).view(float)]
        for c in CONVERTERS:
            u, theta = abs(voltage_at(c.bus)) / c.level, cmath.phase(voltage_at(c.bus))
            current = (c.P - 1j * c.Q) / c.S / u
            y = held(c) if c.keeps_voltage else c.Q / c.S
            integrators = (R_PR * current.real, R_PR * current.imag, c.P / c.S, current.real, y, current.imag)
            x.append(np.array([current.real, current.imag, theta, 0.0, *integrators]))
        found = np.concatenate(x)
        for _ in range(20):
            found = found - np.linalg.solve(self.matrix(found), self.slope(found))
        assert np.abs(self.slope(found)).max() < 1e-6
        return found

    def matrix(self, x: np.ndarray) -> np.ndarray:
        """d(dx/dt)/dx by central differences."""
        steps = np.eye(len(x)) * 1e-6 * np.maximum(np.abs(x), 1.0)
        return np.array([(self.slope(x + d) - self.slope(x - d)) / (2.0 * d.max()) for d in steps]).T

    def modes(self) -> np.ndarray:
        """1/s."""
        return np.linalg.eigvals(self.matrix(self.at_rest()))
