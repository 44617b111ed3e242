"""The public system of four grid-following converters, whose controller exists in the tests alone, as a plant.

Network, load flow and gains are those of the four-VSC benchmark of CRESYM (colib0.github.io,
``pages/testCases/converterDrivenStability/4VSCSystem``, by T. Van Cutsem): ``STEPPS/lf_2.dat``,
``dyn_det_2.dat`` and the block diagrams of ``4-VSC_benchmark.pdf``. At its second operating point one of the two
circuits between A and B opens, and its authors look for the least short-circuit power at bus C. With phasors for the
network they find 5.5 GVA and 8 Hz, with EMT 16 GVA (growing) to 17.7 GVA (decaying with about 1 1/s) and 16 Hz.

All voltages are referred to 400 kV, which are 400 V here, so that the impedances keep their ohms and 1 MVA is 1 VA. The
ratios of the transformers, 1.05 at B2 and those of the converters, are on radial branches and go into these values.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import Measurement
from vsgdesign.equations.frames import instantaneous_power, ll_to_phase, rotate, rotate_back
from vsgdesign.equations.grid_following import ConverterOutput, SetPoints
from vsgdesign.equations.integration import advanced, within_a_turn
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.fields import number
from vsgdesign.study.parameters.inverter_kinds import Droop, InverterKind, InverterRatings, Phasors

OMEGA = 2.0 * math.pi * 50.0
R_PR, T_LPF, K_I, K_IP, T_PLL = 0.005, 1.0 / 300.0, 6.0, 10.0, 0.1
K_PP = K_IP * T_LPF
"""As the benchmark's presentation defines it. Its data file has 1,000 times as much."""

VOLTAGES = {
    "A": (1.0075727, 0.041624702),
    "A2": (1.0318733, 0.15892537),
    "B": (1.0054174, 0.036073673),
    "B2": (0.9824509, 0.16556362),
    "C": (1.0, 0.0),
    "E": (1.0475620, 0.18895444),
    "F": (0.9997311, 0.19815885),
}
"""Of the published load flow: pu and rad."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """A converter of ``dyn_det_2.dat`` at its bus."""

    name: str
    bus: str
    S: float
    L: float
    K_p: float
    ratio: float
    keeps_voltage: bool
    K_v: float
    P: float
    Q: float
    """Of the load flow, W and var with 1 MVA as 1 VA."""

    @property
    def level(self) -> float:
        """Voltage of its side of the transformers, V at rated, referred to 400 V: of the bus and its own ratio."""
        return 400.0 * (1.05 if self.bus == "F" else 1.0) * self.ratio


CONVERTERS = (
    Published(
        name="WP1", bus="E", S=2400, L=0.12, K_p=0.4584, ratio=1.04, keeps_voltage=False, K_v=10, P=1991.830, Q=-146.541
    ),
    Published(
        name="WP2", bus="F", S=2400, L=0.12, K_p=0.4584, ratio=1.00, keeps_voltage=True, K_v=50, P=1991.667, Q=-177.793
    ),
    Published(
        name="HVDC1",
        bus="A",
        S=1200,
        L=0.15,
        K_p=0.5730,
        ratio=1.00,
        keeps_voltage=True,
        K_v=50,
        P=-1125.253,
        Q=-101.976,
    ),
    Published(
        name="HVDC2",
        bus="B",
        S=1700,
        L=0.15,
        K_p=0.5730,
        ratio=0.99,
        keeps_voltage=True,
        K_v=50,
        P=-1607.528,
        Q=-237.355,
    ),
)

Z_E, Z_F = (400.0 / 225.0) ** 2, (1.05 * 400.0 / 225.0) ** 2
"""What refers an impedance of the 225 kV buses E, A2 and F, B2 to 400 kV."""

BRANCHES = (
    *(("AB", "A", "B", 0.51, 10.24),) * 2,
    *(("AC", "A", "C", 1.04, 20.80),) * 2,
    *(("BC", "B", "C", 1.12, 22.40),) * 2,
    ("A2E", "A2", "E", 0.42 * Z_E, 0.83 * Z_E),
    ("B2F", "B2", "F", 0.42 * Z_F, 0.83 * Z_F),
    ("A2A", "A2", "A", 0.005 * 400.0**2 / 2400.0, 0.15 * 400.0**2 / 2400.0),
    ("B2B", "B2", "B", 0.005 * 420.0**2 / 2400.0, 0.15 * 420.0**2 / 2400.0),
)
"""Name, ends, R and X in ohm."""

REACTORS = {"E": 400.0**2 / 300.0, "F": 420.0**2 / 200.0}
"""Shunt reactors, ohm."""

LOAD_P, LOAD_Q = 1168.7, 177.6


def susceptances(circuits: int) -> dict[str, float]:
    """Of the capacitance of all lines and cables at each bus, S. ``circuits``: between A and B."""
    a, b, c = 2 * 98e-6, 2 * 105e-6, 2 * (98e-6 + 105e-6)
    line = circuits * 48e-6
    e, f = 9000e-6 / Z_E, 9000e-6 / Z_F
    return {"A": a + line, "B": b + line, "C": c, "A2": e, "E": e, "B2": f, "F": f}


def branches(circuits: int) -> tuple[tuple[str, str, str, float, float], ...]:
    """With one circuit or two between A and B."""
    return BRANCHES[2 - circuits :]


def voltage_at(bus: str) -> complex:
    """Of the published load flow, V at the 400 V level, rms between two lines."""
    size, phase = VOLTAGES[bus]
    return 400.0 * (1.05 if bus in ("F", "B2") else 1.0) * size * cmath.exp(1j * phase)


def held(c: Published) -> float:
    """The voltage behind its inductance, pu, which it keeps."""
    v = voltage_at(c.bus) / c.level
    i = ((c.P + 1j * c.Q) / c.S / v).conjugate()
    return abs(v + (R_PR + 1j * c.L) * i)


class FollowingState(NamedTuple):
    theta: Any
    w: Any
    xi_d: Any
    xi_q: Any
    P: Any
    i_p: Any
    y: Any
    """Behind its low-pass, the voltage or the reactive power that it keeps, pu."""
    i_y: Any


class FollowingSettings(NamedTuple):
    T_s: Any
    S: Any
    V: Any
    """Base: phase peak."""
    I: Any  # noqa: E741
    ratio: Any
    L: Any
    K_p: Any
    K_v: Any
    keeps_voltage: Any
    V_ref: Any
    V_bus: Any
    """At its bus by the published load flow, phase rms."""


def following_sample(
    state: FollowingState, measured: Measurement, asked: SetPoints, settings: FollowingSettings
) -> tuple[FollowingState, ConverterOutput]:
    """One sample. Returns (following, said)."""
    T, L = settings.T_s, settings.L
    cosine, sine = np.cos(state.theta), np.sin(state.theta)
    v_d, v_q = rotate_back(measured.v_alpha / settings.V, measured.v_beta / settings.V, cosine, sine)
    i_d, i_q = rotate_back(measured.i_s_alpha / settings.I, measured.i_s_beta / settings.I, cosine, sine)
    P, Q = v_d * i_d + v_q * i_q, v_q * i_d - v_d * i_q
    V_m = np.hypot(v_d + R_PR * i_d - L * i_q, v_q + R_PR * i_q + L * i_d)
    omega = 1.0 + 10.0 / (T_PLL * OMEGA) * settings.ratio * v_q + state.w
    e_p = asked.P_ref / settings.S - state.P
    kept = settings.keeps_voltage
    e_y = kept * (state.y - settings.V_ref) + (1.0 - kept) * (state.y - asked.Q_ref / settings.S)
    e_d = K_PP * e_p + state.i_p - i_d
    e_q = settings.K_v * T_LPF * e_y + state.i_y - i_q
    u_d = settings.K_p * e_d + state.xi_d + v_d - omega * L * i_q
    u_q = settings.K_p * e_q + state.xi_q + omega * L * i_d
    ahead = state.theta + 0.5 * T * OMEGA * omega
    v_b_alpha, v_b_beta = rotate(settings.V * u_d, settings.V * u_q, np.cos(ahead), np.sin(ahead))
    following = FollowingState(
        theta=within_a_turn(advanced(state.theta, T * OMEGA * omega)),
        w=advanced(state.w, T * 25.0 / (T_PLL * T_PLL * OMEGA) * settings.ratio * v_q),
        xi_d=advanced(state.xi_d, T * K_I * e_d),
        xi_q=advanced(state.xi_q, T * K_I * e_q),
        P=state.P + T / T_LPF * (P - state.P),
        i_p=advanced(state.i_p, T * K_IP * e_p),
        y=state.y + T / T_LPF * (kept * V_m + (1.0 - kept) * Q - state.y),
        i_y=advanced(state.i_y, T * settings.K_v * e_y),
    )
    p, q = instantaneous_power(measured.v_alpha, measured.v_beta, measured.i_g_alpha, measured.i_g_beta)
    V = settings.V * np.hypot(v_d, v_q)
    return following, ConverterOutput(v_b_alpha, v_b_beta, p, q, OMEGA * omega, V, state.theta, 0.0, 0.0)


class FollowingFields:
    """What a study gives it."""

    level: float = number("V", 100.0, 1000.0, default=400.0)
    """Rated voltage of its own side."""
    ratio: float = number("1", 0.5, 2.0, default=1.0)
    """Of its transformer."""
    reactance_pu: float = number("1", 0.01, 1.0, default=0.12)
    """Of its transformer, on its own side."""
    gain_pu: float = number("1", 0.01, 10.0, default=0.4584)
    """K_p of the current loop."""
    voltage_gain: float = number("1", 0.0, 1e3, default=50.0)
    """K_iv, pu/s."""
    keeps_voltage: float = number("1", 0.0, 1.0, default=1.0)
    """1: it keeps the voltage behind its reactance; 0: Q."""
    voltage_pu: float = number("1", 0.5, 1.5, default=1.0)
    """Which voltage it keeps."""
    bus_voltage: float = number("V", 100.0, 1000.0, default=230.0)
    """At its bus by the published load flow, phase rms."""


def following_settings(ratings: InverterRatings, given: Mapping[str, Any]) -> FollowingSettings:
    """From the study's fields."""
    up = given["level"] / 400.0
    return FollowingSettings(
        T_s=ratings.T_s,
        S=ratings.S_rated,
        V=ratings.V_rated_pk * up,
        I=ratings.I_rated_pk / up,
        ratio=given["ratio"],
        L=given["reactance_pu"],
        K_p=given["gain_pu"],
        K_v=given["voltage_gain"],
        keeps_voltage=given["keeps_voltage"],
        V_ref=given["voltage_pu"],
        V_bus=given["bus_voltage"],
    )


def following_flow(asked: SetPoints, _: float, settings: FollowingSettings) -> Droop:
    """Its powers. To keep the voltage behind its reactance is nearly a droop of Q with the voltage of its bus."""
    per_volt = settings.keeps_voltage * settings.S / settings.L / settings.V_bus
    return Droop(asked.P_ref, asked.Q_ref, per_volt, settings.V_bus)


def following_at_rest(at: Phasors, settings: FollowingSettings) -> FollowingState:
    """Its frame is that of the voltage."""
    theta = cmath.phase(at.v)
    v, i = abs(at.v) / settings.V, at.i_s / settings.I * cmath.exp(-1j * theta)
    S, V_m = v * i.conjugate(), abs(v + (R_PR + 1j * settings.L) * i)
    y = V_m if settings.keeps_voltage else S.imag
    return FollowingState(theta, 0.0, R_PR * i.real, R_PR * i.imag, S.real, i.real, y, i.imag)


KIND = InverterKind(
    name="public_following",
    sample=following_sample,
    state=FollowingState,
    settings=FollowingSettings,
    at_rest=following_at_rest,
    flow=following_flow,
    fields=FollowingFields,
    build=following_settings,
)


def table(which: str, **fields: Any) -> str:
    """One entry of a study's list."""
    said = (f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}" for key, value in fields.items())
    return "\n".join((f"[[network.{which}]]", *said, ""))


def study_of(S_sc: float, f_s: str, circuits: int, delay: int = 0, opens: bool = False) -> Study:
    """The plant with a short-circuit power (VA for MVA), without a unit of ours. ``circuits``: between A and B;
    ``opens``: the first one opens at 0.1 s (its capacitance stays)."""
    C = susceptances(circuits)
    parts = [table("nodes", name=bus) for bus in VOLTAGES]
    parts += [
        table("branches", name=f"{name}{k}", **{"from": a, "to": b}, R=R, L=X / OMEGA)
        for k, (name, a, b, R, X) in enumerate(branches(circuits))
    ]
    parts += [table("shunts", name=f"reactor{bus}", node=bus, L=X / OMEGA) for bus, X in REACTORS.items()]
    parts += [table("shunts", name=f"C{bus}", node=bus, C=C[bus] / OMEGA) for bus in ("A2", "B2", "C")]
    parts.append(table("loads", name="load", node="C", P=LOAD_P, Q=LOAD_Q))
    parts.append(table("units", name="waits", node="C"))
    for c in CONVERTERS:
        up = c.level / 400.0
        fields = {
            "level": c.level,
            "ratio": c.ratio,
            "reactance_pu": c.L,
            "gain_pu": c.K_p,
            "voltage_gain": float(c.K_v),
        }
        circuit = {"L_1_pu": c.L * up**2, "R_1_pu": R_PR * up**2, "C_pu": C[c.bus] * 400.0**2 / c.S, "R_c_pu": 0.0}
        asked = {"P_ref": c.P, "Q_ref": c.Q, "keeps_voltage": float(c.keeps_voltage), "voltage_pu": held(c)}
        asked["bus_voltage"] = float(ll_to_phase(abs(voltage_at(c.bus))))
        sampled = {"f_s": f_s, "delay_samples": delay, "L_2_pu": 0.0, "R_2_pu": 0.0}
        parts.append(
            table(
                "inverters",
                name=c.name,
                node=c.bus,
                kind=KIND.name,
                S_rated=float(c.S),
                **asked,
                **fields,
                **circuit,
                **sampled,
            )
        )
    head = f"""
base = "case:lab_12kva_lcl"
[converter]
V_dc = "1500 V"
[inner_loops]
design = false
current_response_time = "1 ms"
voltage_response_time = "10 ms"
[grid]
R_g = 0.0
L_g = {400.0**2 / S_sc / OMEGA!r}
[simulation]
duration = "1 s"
log_interval = "5 ms"
P_ref = 0.0
Q_ref = 0.0
[network]
pcc = "C"
[[controllers]]
name = "one"
kind = "fixed"
"""
    if opens:
        parts.append('[[events]]\ntime = "0.1 s"\nelement = "AB0"\nbreaker = "open"\n')
    study = study_from_text(head + "\n".join(parts))
    assert study.plant is not None
    return replace(study, plant=replace(study.plant, units=()))
