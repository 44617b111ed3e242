"""The inner loops with the power loops frozen: one complex matrix a grid, whatever the operating point.

With a constant reference V∠ωt and no limit in reach, filter, grid and inner loops are linear and treat d and q alike,
so one complex number carries both axes. Nothing is written here that equations/ says: the law's coefficients are what
``controller_step`` answers to unit inputs, the circuit's are those of the EMT's own exact step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_step
from vsgdesign.equations.filters import FilterGrid, capacitor_node_voltage
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import CIRCULAR, GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.operating_point.plant import averaged_steps

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

INPUTS = ("v", "i_s", "i_g", "xi_v", "xi_i", "i_f", "u")
"""What the law answers to: three measurements, then what it remembers. u is its last output."""

OUTPUTS = ("v_b", "xi_v", "xi_i", "i_f")
"""Its answers: the bridge voltage, then what it will remember besides that."""

MEASURED = 3
"""The first inputs are measured."""

_UNREACHED = 2.0**200
"""A limit that no unit input reaches. A power of two, so that its square and root are exact."""


def law_matrix(gains: InnerLoopGains, omega_t: Any, settings: ControllerSettings) -> Complex:
    """Coefficients (M, OUTPUTS, INPUTS) of the inner loops of M gain sets in SI; ω_t (M,) in rad/s.

    The d-axis unit answers are the complex coefficients: the law treats d and q alike (:eq:`frozen-inner-loops`).
    """
    columns = InnerLoopGains(*(np.reshape(np.asarray(value, dtype=float), (-1, 1)) for value in gains))
    corner = np.reshape(np.asarray(omega_t, dtype=float), (-1, 1))
    unlimited = settings._replace(
        i_max_pk=_UNREACHED, v_max_pk=_UNREACHED, smoothing_t=-np.expm1(-corner * settings.T_s)
    )
    answers = law_answers(np.eye(len(INPUTS)), np.zeros((len(INPUTS), len(INPUTS))), columns, unlimited)
    count = max(len(corner), *(len(column) for column in columns))
    d_q = [np.broadcast_to(answer, (count, len(INPUTS))) for answer in answers]
    return np.stack([d_q[2 * k] + 1j * d_q[2 * k + 1] for k in range(len(OUTPUTS))], axis=1)


def law_answers(d: Any, q: Any, gains: InnerLoopGains, settings: ControllerSettings) -> tuple[Any, ...]:
    """OUTPUTS, each as d and q, of the inner loops for INPUTS on the d and on the q axis.

    The power loops stand still: at angle and voltage zero, without gains.
    """
    on_d, on_q = dict(zip(INPUTS, d, strict=True)), dict(zip(INPUTS, q, strict=True))
    measured = Measurement(
        v_alpha=on_d["v"],
        v_beta=on_q["v"],
        i_s_alpha=on_d["i_s"],
        i_s_beta=on_q["i_s"],
        i_g_alpha=on_d["i_g"],
        i_g_beta=on_q["i_g"],
    )
    remembered = ControllerState(
        theta=0.0,
        omega_i=0.0,
        V=0.0,
        P_f=0.0,
        Q_f=0.0,
        xi_vd=on_d["xi_v"],
        xi_vq=on_q["xi_v"],
        xi_id=on_d["xi_i"],
        xi_iq=on_q["xi_i"],
        i_f_d=on_d["i_f"],
        i_f_q=on_q["i_f"],
        u_alpha=on_d["u"],
        u_beta=on_q["u"],
    )
    still = PowerLoopGains(K_ip=0.0, D_p=0.0, K_iq=0.0, D_q=0.0)
    refs = References(P_ref=0.0, Q_ref=0.0, omega_0=0.0, V_n=0.0)
    grid = GridEstimate(R_g=0.0, L_g=0.0)
    after, output = controller_step(remembered, measured, grid, refs, still, gains, settings, CIRCULAR.law)
    return (
        output.v_b_alpha,
        output.v_b_beta,
        after.xi_vd,
        after.xi_vq,
        after.xi_id,
        after.xi_iq,
        after.i_f_d,
        after.i_f_q,
    )


@dataclass(frozen=True)
class Plants:
    """G circuits over one sampling period, in the frame that turns at ω: x' = A x + b v_b with x = (i_s, v_c, i_g)."""

    T_s: float
    delay: int
    """Samples between measuring and applying: 0 or 1."""
    turn: complex
    """e^{−jωT_s}: how the frame sees one period."""
    A: Complex
    """(G, 3, 3)."""
    b: Complex
    """(G, 3)."""
    sensors: Array
    """(G, 3, 3): rows v, i_s, i_g from x."""


def plants(circuits: Sequence[FilterGrid], settings: ControllerSettings, delay: int, omega: float) -> Plants:
    """The circuits' exact steps over one sampling period (:eq:`exact-step`), seen from the frame that turns at ω."""
    turn = complex(np.exp(-1j * omega * settings.T_s))
    transitions, bridges = averaged_steps(circuits, settings.T_s)
    state = np.eye(3)
    sensors = [
        [capacitor_node_voltage(state[0], state[1], state[2], circuit), state[0], state[2]] for circuit in circuits
    ]
    return Plants(
        settings.T_s,
        delay,
        turn,
        turn * transitions,
        turn * bridges,
        np.array(sensors),
    )


def joined(parts: Sequence[Plants]) -> Plants:
    """Several sets of circuits of one controller as one set."""
    first = parts[0]
    A, b, sensors = (np.concatenate([getattr(part, name) for part in parts]) for name in ("A", "b", "sensors"))
    return Plants(first.T_s, first.delay, first.turn, A, b, sensors)


def matrices(law: Complex, circuits: Plants) -> Complex:
    """One period of M laws on G circuits, (M, G, n, n) (:eq:`frozen-inner-loops`).

    States: i_s, v_c, i_g, ξ_v, ξ_i, i_f and, with a sample of delay, u: what is computed now acts a period later, and
    the frame has turned by then. Without delay u is not used.
    """
    M, G, n = len(law), len(circuits.A), 6 + circuits.delay
    A = np.zeros((M, G, n, n), dtype=complex)
    answers = np.zeros((M, G, len(OUTPUTS), n), dtype=complex)
    answers[..., :3] = law[:, None, :, :MEASURED] @ circuits.sensors
    answers[..., 3:] = law[:, None, :, MEASURED:n]
    A[:, :, :3, :3] = circuits.A
    A[:, :, 3:6, :] = answers[:, :, 1:, :]
    if circuits.delay:
        A[:, :, :3, 6] = circuits.b
        A[:, :, 6, :] = circuits.turn * answers[:, :, 0, :]
    else:
        A[:, :, :3, :] += circuits.b[..., None] * answers[:, :, :1, :]
    return A


def modes(law: Complex, circuits: Plants) -> Complex:
    """Continuous-time eigenvalues s = ln(z)/T_s, (M, G, n), of :func:`matrices`.

    Where no set uses the low-pass of the transient impedance (R_t = X_t = 0), its decay is nobody's mode and left out.
    """
    A = matrices(law, circuits)
    if _low_pass_unused(law):
        keep = np.arange(A.shape[-1]) != _I_F
        A = A[..., keep, :][..., keep]
    return to_continuous(np.linalg.eigvals(A), circuits.T_s)


_I_F = 5
"""Where i_f is among the states."""


def _low_pass_unused(law: Complex) -> bool:
    users = [k for k, name in enumerate(OUTPUTS) if name != "i_f"]
    return not np.any(law[:, users, INPUTS.index("i_f")])
