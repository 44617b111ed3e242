"""The inner loop: controller sample, log, plant step, for a stretch in which nothing else changes.

Plain Python; :mod:`vsgdesign.simulation.compiling` turns it into machine code. Where α and β are alike they share the
plant's real matrices, and real and imaginary parts are written out. Where they differ the matrices have one more
dimension: the compiler chooses by that, so the usual case pays nothing for it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_step
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.integration import within_a_turn
from vsgdesign.equations.limiters import GridEstimate, LimiterLaw
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.frames import clarke, clarke_inverse, rotate
from vsgdesign.simulation.observing import ObserverLaw, Watch
from vsgdesign.simulation.sensors import SensorRows, sensed

LOG_COLUMNS = (
    "i_s_alpha",
    "i_s_beta",
    "v_c_alpha",
    "v_c_beta",
    "i_g_alpha",
    "i_g_beta",
    "v_g_alpha",
    "v_g_beta",
    "P",
    "Q",
    "omega",
    "V_rms",
    "theta",
    "limited_samples",
)
"""What a run keeps of a sample, SI and peak. Voltages and currents are those of the circuit; P and Q are what the
controller measures with its sensors, before its filters. ``limited_samples`` counts the samples from the start of the
run up to and including this one in which the current limiter acted."""


class Bridge(NamedTuple):
    """The bridge: pwm (0: averaged, 1: switched), V_dc, zero-sequence injection, timing."""

    pwm: int
    V_dc: float
    zero_sequence: int
    samples_per_carrier: int
    delay_samples: int
    R_c: float


class Span(NamedTuple):
    """A stretch: its first sample in the run, the sample of the stretch to go on with, and its length in samples."""

    first: int
    begin: int
    length: int


class Moving(NamedTuple):
    """What a stretch moves: the circuit's states x (2n), the voltage that waits out the delay (2), and the state of the
    controller."""

    x: Any
    pending: Any
    state: ControllerState


class ControllerInputs(NamedTuple):
    """What the controller is given for a stretch, besides its measurements and its own state."""

    grid: GridEstimate
    refs: References
    power_gains: PowerLoopGains
    inner_gains: InnerLoopGains
    settings: ControllerSettings


class PlantPieces(NamedTuple):
    """The circuit over the interval after a sample, cut into pieces, arrays stacked over them.

    One piece, unless an event falls inside the interval. ``sources`` has, per piece, (cos φ, sin φ, V_g peak, its
    slope, ω, ω's slope, by how much ω has drifted so far) at the piece's first instant; the other arrays are those of
    :class:`vsgdesign.operating_point.plant.PlantStep`. ``background`` has no rows, or a row for every sample (for every
    piece, where there are several): what the source's other components add to the states, then their own voltage at
    the beginning (α, β).
    """

    lengths: Any
    transitions: Any
    bridges: Any
    edges: Any
    responses: Any
    sources: Any
    background: Any


class LogRows(NamedTuple):
    """Where a stretch writes: ``rows`` takes LOG_COLUMNS at every ``every``-th sample of the run, ``sensed`` (no rows
    where the sensors are ideal) what the sensors say of the capacitor node's voltage and of i_g there, ``states`` (0 or
    more rows) the controller's states at every sample of the stretch. ``limited`` (1) counts limited samples."""

    rows: Any
    sensed: Any
    every: int
    states: Any
    limited: Any


def modulation_indices(v_alpha: Any, v_beta: Any, V_dc: Any, zero_sequence: int) -> Any:
    """Phase modulation indices in [−1, 1] of a bridge voltage (:eq:`modulation`)."""
    a, b, c = clarke_inverse(v_alpha, v_beta)
    shift = 0.0
    if zero_sequence != 0:
        shift = -0.5 * (max(a, b, c) + min(a, b, c))
    scale = 2.0 / V_dc
    return (a + shift) * scale, (b + shift) * scale, (c + shift) * scale


def carrier(p: Any) -> Any:
    """Symmetric triangle in [−1, 1] over its period p ∈ [0, 1], valley at zero."""
    return 4.0 * p - 1.0 if p < 0.5 else 3.0 - 4.0 * p


def leg_voltage(m: Any, p: Any, half: Any) -> Any:
    """±V_dc/2 of a leg just after carrier position p; on a tie the carrier's slope decides."""
    level = carrier(p)
    return half if m > level or (m == level and p >= 0.5) else -half


def edge_response(edge: Any, x: Any) -> Any:
    """The three components of the edge polynomial at x (Horner)."""
    degree = edge.shape[0] - 1
    i_s, v_c, i_g = edge[degree, 0], edge[degree, 1], edge[degree, 2]
    for k in range(degree - 1, -1, -1):
        i_s = i_s * x + edge[k, 0]
        v_c = v_c * x + edge[k, 1]
        i_g = i_g * x + edge[k, 2]
    return i_s, v_c, i_g


def add_edge_response(x: Any, edge: Any, place: Any, step_alpha: Any, step_beta: Any) -> None:
    """Add the response to a step of the bridge voltage whose edge polynomial is taken at ``place``."""
    if edge.ndim == 2:  # both axes alike
        i_s, v_c, i_g = edge_response(edge, place)
        x[0] += step_alpha * i_s
        x[1] += step_beta * i_s
        x[2] += step_alpha * v_c
        x[3] += step_beta * v_c
        x[4] += step_alpha * i_g
        x[5] += step_beta * i_g
    else:
        for row in range(edge.shape[1]):
            of_alpha, of_beta = 0.0, 0.0
            for k in range(edge.shape[0] - 1, -1, -1):
                of_alpha = of_alpha * place + edge[k, row, 0]
                of_beta = of_beta * place + edge[k, row, 1]
            x[row] += step_alpha * of_alpha + step_beta * of_beta


def add_edges(x: Any, m: Any, unit_alpha: Any, unit_beta: Any, p_start: Any, p_end: Any, edge: Any) -> None:
    """Add what one phase's switching between carrier positions p_start and p_end does by the end.

    The phase falls where the rising carrier meets m and rises where the falling carrier does; each edge steps
    the bridge voltage by V_dc times the phase's unit vector. Order is irrelevant: responses superpose.
    """
    span = p_end - p_start
    for rising in range(2):
        p_edge = (m + 1.0) / 4.0 if rising == 1 else (3.0 - m) / 4.0
        on_its_slope = p_edge < 0.5 if rising == 1 else p_edge > 0.5
        if on_its_slope and p_start < p_edge <= p_end:
            step = -1.0 if rising == 1 else 1.0
            left = (p_end - p_edge) / span
            add_edge_response(x, edge, 2.0 * left - 1.0, step * unit_alpha, step * unit_beta)


def advance_plant(x: Any, v_alpha: Any, v_beta: Any, transition: Any, bridge: Any) -> None:
    """x ← Φ x + Γ v in place; x = (i_s, v_c, i_g, …), each as (α, β)."""
    if bridge.ndim == 1:  # both axes alike
        for axis in range(2):
            v = v_alpha if axis == 0 else v_beta
            i_s, v_c, i_g = x[axis], x[2 + axis], x[4 + axis]
            x[axis] = transition[0, 0] * i_s + transition[0, 1] * v_c + transition[0, 2] * i_g + bridge[0] * v
            x[2 + axis] = transition[1, 0] * i_s + transition[1, 1] * v_c + transition[1, 2] * i_g + bridge[1] * v
            x[4 + axis] = transition[2, 0] * i_s + transition[2, 1] * v_c + transition[2, 2] * i_g + bridge[2] * v
    else:
        before = x.copy()
        for row in range(x.shape[0]):
            total = bridge[row, 0] * v_alpha + bridge[row, 1] * v_beta
            for k in range(x.shape[0]):
                total += transition[row, k] * before[k]
            x[row] = total


def add_source(x: Any, response: Any, re: Any, im: Any) -> None:
    """Add a source coefficient re + j·im times its response."""
    if response.ndim == 1:  # both axes alike
        for row in range(3):
            x[2 * row] += response[row].real * re - response[row].imag * im
            x[2 * row + 1] += response[row].real * im + response[row].imag * re
    else:
        for row in range(x.shape[0]):
            x[row] += response[row, 0] * re + response[row, 1] * im


def add_background(values: Any, background: Any, row: Any, column: Any) -> None:
    """Add what a row of ``background`` holds from ``column`` on. A source without other components has no rows."""
    if background.shape[0] > 0:
        for k in range(values.shape[0]):
            values[k] += background[row, column + k]


def write_state(row: Any, state: ControllerState) -> None:
    """One row of a log of states."""
    values = flat_state(state)
    for k in range(len(values)):
        row[k] = values[k]


def write_sensed(rows: Any, row: Any, measured: Measurement, sensors: SensorRows | None) -> None:
    """One row of what the sensors say of the capacitor node's voltage and of i_g; nothing where they are ideal."""
    if sensors is not None:
        rows[row, 0], rows[row, 1] = measured.v_alpha, measured.v_beta
        rows[row, 2], rows[row, 3] = measured.i_g_alpha, measured.i_g_beta


def commanding(state: ControllerState, theta: Any, V: Any) -> ControllerState:
    """The state with another angle (rad) and voltage (rms V). (The compiler knows no ``_replace``.)"""
    return ControllerState(
        theta=theta,
        omega_i=state.omega_i,
        V=V,
        P_f=state.P_f,
        Q_f=state.Q_f,
        xi_vd=state.xi_vd,
        xi_vq=state.xi_vq,
        xi_id=state.xi_id,
        xi_iq=state.xi_iq,
        i_f_d=state.i_f_d,
        i_f_q=state.i_f_q,
        u_alpha=state.u_alpha,
        u_beta=state.u_beta,
        ripple_P=state.ripple_P,
        ripple_Q=state.ripple_Q,
        mean_P=state.mean_P,
        mean_Q=state.mean_Q,
        limiter=state.limiter,
    )


def run_stretch(
    span: Span,
    moving: Moving,
    given: ControllerInputs,
    bridge: Bridge,
    plant: PlantPieces,
    sensors: SensorRows | None,
    log: LogRows,
    watch: Watch,
    limiter: LimiterLaw,
    observer: ObserverLaw,
) -> Any:
    """Run the samples of a stretch from ``span.begin`` on. Returns the controller's state after the last one, and how
    many samples of the stretch have been run by then: all, unless the observer stopped the loop before.

    The arrays of ``moving``, ``plant.sources`` and ``watch`` are updated in place, so that the same stretch can go on.
    Where the interval is cut into several pieces, ``span.length`` is 1. Without ``sensors`` they are ideal; the
    compiler then leaves them out by the type.
    """
    first, begin, length = span
    x, pending, state = moving
    lengths, sources, background = plant.lengths, plant.sources, plant.background
    T_s = given.settings.T_s
    pieces = lengths.shape[0]
    n = bridge.samples_per_carrier
    ramped = sources[0, 3] != 0.0 or sources[0, 5] != 0.0 or pieces > 1
    source_cos, source_sin, V_g = sources[0, 0], sources[0, 1], sources[0, 2]
    turn_cos, turn_sin = np.cos(sources[0, 4] * lengths[0]), np.sin(sources[0, 4] * lengths[0])
    drift = sources[0, 6]
    until_log = (-first - begin) % log.every
    row = (first + begin + until_log) // log.every
    limited = log.limited[0]
    memory, constants = observer.begin(watch)
    done = begin
    for offset in range(begin, length):
        true = Measurement(
            v_alpha=x[2] + bridge.R_c * (x[0] - x[4]),
            v_beta=x[3] + bridge.R_c * (x[1] - x[5]),
            i_s_alpha=x[0],
            i_s_beta=x[1],
            i_g_alpha=x[4],
            i_g_beta=x[5],
        )
        measured = true if sensors is None else sensed(true, offset, sensors)
        sent = observer.probe(memory, state.V, constants)
        state = commanding(state, state.theta + sent.theta, state.V + sent.V)
        if offset < log.states.shape[0]:
            write_state(log.states[offset], state)
        following, output = controller_step(
            state,
            measured,
            given.grid,
            given.refs,
            given.power_gains,
            given.inner_gains,
            given.settings,
            limiter,
        )
        memory = observer.listen(memory, measured, state.theta, sent, output.limited, constants)
        limited += output.limited
        if until_log == 0:
            for j in range(6):
                log.rows[row, j] = x[j]
            log.rows[row, 6] = V_g * source_cos
            log.rows[row, 7] = V_g * source_sin
            log.rows[row, 8] = output.P
            log.rows[row, 9] = output.Q
            log.rows[row, 10] = output.omega
            log.rows[row, 11] = state.V
            log.rows[row, 12] = state.theta
            log.rows[row, 13] = limited
            add_background(log.rows[row, 6:8], background, offset, x.shape[0])
            write_sensed(log.sensed, row, measured, sensors)
            until_log = log.every
            row += 1
        until_log -= 1
        state = commanding(following, within_a_turn(following.theta - sent.theta), following.V - sent.V)
        if bridge.delay_samples == 0:
            applied_alpha, applied_beta = output.v_b_alpha, output.v_b_beta
        else:
            applied_alpha, applied_beta = pending[0], pending[1]
            pending[0] = output.v_b_alpha
            pending[1] = output.v_b_beta

        if bridge.pwm != 0:
            m_a, m_b, m_c = modulation_indices(applied_alpha, applied_beta, bridge.V_dc, bridge.zero_sequence)
            p_begin = ((first + offset) % n) / n
        else:
            m_a, m_b, m_c, p_begin = 0.0, 0.0, 0.0, 0.0
        elapsed = 0.0
        for piece in range(pieces):
            h = lengths[piece]
            if pieces > 1:
                source_cos, source_sin, V_g = sources[piece, 0], sources[piece, 1], sources[piece, 2]
                drift = 0.0
            if bridge.pwm == 0:
                advance_plant(x, applied_alpha, applied_beta, plant.transitions[piece], plant.bridges[piece])
            else:
                scale = 1.0 / (n * T_s)
                p_start = p_begin + elapsed * scale
                p_end = p_begin + (elapsed + h) * scale if piece < pieces - 1 else p_begin + 1.0 / n
                half = 0.5 * bridge.V_dc
                v_0_alpha, v_0_beta = clarke(
                    leg_voltage(m_a, p_start, half), leg_voltage(m_b, p_start, half), leg_voltage(m_c, p_start, half)
                )
                advance_plant(x, v_0_alpha, v_0_beta, plant.transitions[piece], plant.bridges[piece])
                a_alpha, a_beta = clarke(bridge.V_dc, 0.0, 0.0)
                b_alpha, b_beta = clarke(0.0, bridge.V_dc, 0.0)
                c_alpha, c_beta = clarke(0.0, 0.0, bridge.V_dc)
                add_edges(x, m_a, a_alpha, a_beta, p_start, p_end, plant.edges[piece])
                add_edges(x, m_b, b_alpha, b_beta, p_start, p_end, plant.edges[piece])
                add_edges(x, m_c, c_alpha, c_beta, p_start, p_end, plant.edges[piece])
            add_source(x, plant.responses[piece, 0], V_g * source_cos, V_g * source_sin)
            if ramped:
                # Over the piece the source is (V + aτ) e^{j(φ + ωτ + dτ + rτ²/2)}: to second order in dτ and rτ².
                a, r = sources[piece, 3], sources[piece, 5]
                re, im = a, drift * V_g
                add_source(
                    x, plant.responses[piece, 1], re * source_cos - im * source_sin, re * source_sin + im * source_cos
                )
                re, im = -0.5 * V_g * drift * drift, 0.5 * V_g * r + drift * a
                add_source(
                    x, plant.responses[piece, 2], re * source_cos - im * source_sin, re * source_sin + im * source_cos
                )
                extra = drift * h + 0.5 * r * h * h
                angle = sources[piece, 4] * h + extra
                turn_cos, turn_sin = np.cos(angle), np.sin(angle)
                drift += r * h
                V_g += a * h
            add_background(x, background, offset + piece, 0)
            source_cos, source_sin = rotate(source_cos, source_sin, turn_cos, turn_sin)
            elapsed += h
        done = offset + 1
        if observer.closed(memory) != 0:
            break
    log.limited[0] = limited
    sources[0, 0], sources[0, 1], sources[0, 2], sources[0, 6] = source_cos, source_sin, V_g, drift
    observer.keep(watch, memory)
    return state, done
