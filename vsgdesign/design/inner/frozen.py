"""The inner loops with the power loops frozen: one complex matrix a grid, whatever the operating point.

With a constant reference V∠ωt and no limit in reach, filter, grid and inner loops are linear and treat d and q alike,
so one complex number carries both axes. Nothing is written here that equations/ says: the law's coefficients are what
``controller_step`` answers to unit inputs, the circuit's are those of the EMT's own exact step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_step
from vsgdesign.equations.grid import FilterGrid, capacitor_node_voltage
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import CIRCULAR, GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.linear.operating_point.plant import averaged_steps
from vsgdesign.metrics.modes import to_continuous

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


FIGURES = ("disk", "sensors", "noise")

_WIDTHS = (-1.0, 0.0, 1.0)
"""Where a mode's peak is looked at, in half-widths (−Re s) from its frequency."""

_LOWEST = 2.0
"""rad/s: below it the loop's integrators leave nothing of S."""
_LINEAR_FROM = 0.2
"""Share of the Nyquist frequency from which the points are evenly spaced: filter resonances lie there."""


def frequencies(T_s: float, points: int) -> Array:
    """``points`` frequencies a sign, rad/s, ascending: a third of them logarithmic to a fifth of Nyquist, then linear.

    Both signs: a complex loop answers differently to them.
    """
    nyquist = np.pi / T_s
    few = points // 3
    low = np.geomspace(_LOWEST, _LINEAR_FROM * nyquist, few)
    high = np.linspace(_LINEAR_FROM * nyquist, nyquist, points - few + 1)[1:]
    positive = np.concatenate([low, high])
    return np.concatenate([-positive[::-1], positive])


class Rational(NamedTuple):
    """From the law's output to v, i_s, i_g of each circuit, as a quotient of polynomials in z."""

    numerator: Complex
    """(G, 3 sensors, 3), highest power first."""
    denominator: Complex
    """(G, 4)."""
    late: complex
    """What the computed voltage has become when it acts, times z where that is a sample later; 0 without delay."""


def rational(circuits: Plants) -> Rational:
    """C adj(zI − A) b over det(zI − A), by Faddeev and LeVerrier."""
    A, b = circuits.A, circuits.b
    eye = np.eye(3)
    trace = np.trace(A, axis1=1, axis2=2)
    first = A - trace[:, None, None] * eye
    c_1 = -0.5 * np.trace(A @ first, axis1=1, axis2=2)
    second = A @ first + c_1[:, None, None] * eye
    c_0 = -np.trace(A @ second, axis1=1, axis2=2) / 3.0
    adjugate_b = np.stack([b, (first @ b[..., None])[..., 0], (second @ b[..., None])[..., 0]], axis=-1)
    numerator = circuits.sensors @ adjugate_b
    denominator = np.stack([np.ones(len(A)), -trace, c_1, c_0], axis=-1).astype(complex)
    return Rational(numerator, denominator, circuits.turn if circuits.delay else 0j)


def margins(law: Complex, circuits: Plants, modes: Complex, omega: Array, scales: Array) -> Array:
    """FIGURES (M, G, 3) of M stable loops: disk margin, all-sensor margin, noise gain.

    Peaks are looked for at ``omega`` (rad/s, both signs) and about every mode (M, G, n). ``scales`` (3): what one per
    cent is of each sensor, over one per cent of the base voltage. (:eq:`inner-disk-margin`, :eq:`all-sensor-margin`,
    :eq:`inner-noise`)
    """
    plant = rational(circuits)
    half = 0.5 * (omega[1:] - omega[:-1])
    weights = np.concatenate([[half[0]], half[1:] + half[:-1], [half[-1]]]) / (omega[-1] - omega[0])
    z = np.exp(1j * omega * circuits.T_s)
    return _margins(
        np.ascontiguousarray(law),
        plant.numerator,
        plant.denominator,
        plant.late,
        np.ascontiguousarray(modes),
        z,
        weights,
        scales,
        circuits.T_s,
    )


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _controller(law: Any, late: complex, z: complex, K: Any) -> None:
    """K (3): the law's output per v, i_s and i_g at z, its memory eliminated in the order i_f, ξ_v, ξ_i, u."""
    xi_v, xi_i, i_f, u = 3, 4, 5, 6
    per_i_f = 1.0 / (z - law[3, i_f])
    per_xi_v = 1.0 / (z - law[1, xi_v])
    per_xi_i = law[0, xi_i] / (z - law[2, xi_i])
    closed = 1.0 / (1.0 - (law[0, u] + per_xi_i * law[2, u]) * late / z)
    for k in range(MEASURED):
        f = law[3, k] * per_i_f
        x = (law[1, k] + law[1, i_f] * f) * per_xi_v
        direct = law[0, k] + law[0, xi_v] * x + law[0, i_f] * f
        K[k] = closed * (direct + per_xi_i * (law[2, k] + law[2, xi_v] * x + law[2, i_f] * f))


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _plant(numerator: Any, denominator: Any, late: complex, z: complex, G: Any) -> None:
    """G (3): v, i_s and i_g per output of the law."""
    scale = 1.0 / (((z + denominator[1]) * z + denominator[2]) * z + denominator[3])
    if late != 0.0:
        scale = scale * late / z
    for k in range(MEASURED):
        G[k] = ((numerator[k, 0] * z + numerator[k, 1]) * z + numerator[k, 2]) * scale


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _at(K: Any, G: Any) -> Any:
    """|S − ½|², (Σ|G_i K_i||S|)² and |S|² of one frequency."""
    L, each = 0.0j, 0.0
    for k in range(MEASURED):
        part = G[k] * K[k]
        L -= part
        each += np.sqrt(part.real * part.real + part.imag * part.imag)
    S = 1.0 / (1.0 + L)
    size = S.real * S.real + S.imag * S.imag
    return size - S.real + 0.25, each * each * size, size


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _margins(
    laws: Any,
    numerators: Any,
    denominators: Any,
    late: complex,
    modes: Any,
    z: Any,
    weights: Any,
    scales: Any,
    T_s: float,
) -> Any:
    count_laws, count_plants, points = len(laws), len(numerators), len(z)
    G = np.empty((count_plants, points, MEASURED), dtype=np.complex128)
    for g in range(count_plants):
        for f in range(points):
            _plant(numerators[g], denominators[g], late, z[f], G[g, f])
    K = np.empty((points, MEASURED), dtype=np.complex128)
    noise_of_K = np.empty(points)
    K_at, G_at = np.empty(MEASURED, dtype=np.complex128), np.empty(MEASURED, dtype=np.complex128)
    found = np.empty((count_laws, count_plants, 3))
    for m in range(count_laws):
        for f in range(points):
            _controller(laws[m], late, z[f], K[f])
            power = 0.0
            for k in range(MEASURED):
                part = K[f, k] * scales[k]
                power += part.real * part.real + part.imag * part.imag
            noise_of_K[f] = power * weights[f]
        for g in range(count_plants):
            disk, sensors, noise = 0.0, 0.0, 0.0
            for f in range(points):
                near, each, size = _at(K[f], G[g, f])
                disk, sensors = max(disk, near), max(sensors, each)
                noise += noise_of_K[f] * size
            for mode in range(modes.shape[2]):
                s = modes[m, g, mode]
                for width in _WIDTHS:
                    angle = (s.imag - width * s.real) * T_s
                    if abs(angle) <= np.pi:  # false for the mode at −∞, too
                        point = np.cos(angle) + 1j * np.sin(angle)
                        _controller(laws[m], late, point, K_at)
                        _plant(numerators[g], denominators[g], late, point, G_at)
                        near, each, size = _at(K_at, G_at)
                        disk, sensors = max(disk, near), max(sensors, each)
            found[m, g, 0] = 1.0 / np.sqrt(disk)
            found[m, g, 1] = 1.0 / np.sqrt(sensors)
            found[m, g, 2] = np.sqrt(noise)
    return found
