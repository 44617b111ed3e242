"""A second EMT, written from the mathematics alone, against which the library's fast one is held.

Nothing of ``vsgdesign.simulation`` or ``vsgdesign.equations`` is used: the controller is written in complex
numbers, the circuit is Kirchhoff's laws handed to SciPy's DOP853, the source integrates its own ramps and the
bridge places its own pulses. Only the study's data (ratings, filter, events) is read. The integrator is
restarted at every sample, switching edge and event, so that it never steps across a discontinuity.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tests.oracles.emt_circuit import ABSOLUTE_PU, Changing
from tests.oracles.emt_controller import NineSensors, SampledController, State, bridge_pieces
from tests.oracles.emt_source import COINCIDENT, StiffSource
from vsgdesign.study.parameters import Grid, Study


@dataclass
class Start:
    """Initial condition: circuit (i_s, v_c, i_g), controller, and the voltage waiting out the delay."""

    plant: NDArray[np.complex128]
    controller: State
    waiting: complex


@dataclass
class Trace:
    """What the reference saw at every sample."""

    plant: NDArray[np.complex128]
    source: NDArray[np.complex128]
    power: NDArray[np.complex128]
    theta: NDArray[np.float64]
    omega: NDArray[np.float64]
    V: NDArray[np.float64]
    S_f: NDArray[np.complex128]
    xi_v: NDArray[np.complex128]
    xi_i: NDArray[np.complex128]
    i_f: NDArray[np.complex128]
    edges: int = 0
    current_limited: int = 0
    voltage_limited: int = 0
    final_plant: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(3, complex))


class Prober(Protocol):
    """What adds a small voltage u to every sample, relative to the rated one, and hears what became of it."""

    def value(self) -> complex:
        """u in the frame of the converter's own angle."""
        ...

    def hear(self, v: complex, i: complex, u: complex, theta: float, limited: bool) -> None:
        """Node voltage and grid current of the sample (αβ), what was sent, the angle with it, and whether the current
        limit acted."""
        ...


def at_rest(study: Study) -> Start:
    """Cold start: dead circuit, controller at nominal voltage and frequency in phase with the source."""
    c = study.converter
    phase = StiffSource(study).held(0.0, 0.0)[2]
    return Start(np.zeros(3, complex), State(phase, c.omega_n, c.V_rated_rms, 0j, 0j, 0j), 0j)


def run_reference(
    study: Study,
    gain_changes: Sequence[Any],
    pwm: bool,
    start: Start,
    beta: Callable[[Grid], Grid] = lambda grid: grid,
    wander: Any = None,
    noise: Any = None,
    record: Any = None,
    prober: Prober | None = None,
    circuits: Changing | None = None,
) -> Trace:
    """Simulate the study from ``start``; ``gain_changes`` have ``t_s`` and ``gains``. ``beta``: what the grid is on the
    β axis. ``wander(count)``: the gains and angles that the background's random numbers give, sample by sample;
    ``noise(count)``: those of the nine sensors, V and A. ``record(count)``: the vectors of a recorded source at the
    samples, V. ``prober``: adds a voltage to every sample, and listens. ``circuits``: the circuit over time; None: what
    the events say at their instants."""
    controller, source, c = SampledController(study), StiffSource(study), study.converter
    T = controller.T
    samples = round(study.simulation.duration / T)
    if study.background is not None:
        gain, angle = wander(samples)
        source.follow(study.background, gain, angle, T)
    if record is not None:
        source.play(record(samples + 1), T)
    sensors = None if study.sensors is None else NineSensors(study, noise(samples))
    events = sorted(study.events, key=lambda event: event.t_s)
    circuits = Changing(study, beta) if circuits is None else circuits
    instants = sorted({*source.instants, *circuits.instants})
    V_pk = math.sqrt(2.0) * c.V_rated_rms
    I_pk = math.sqrt(2.0) * c.S_rated / (3.0 * c.V_rated_rms)
    atol = ABSOLUTE_PU * np.array([V_pk if name.startswith("v") else I_pk for name in circuits.names])
    x, state, waiting = circuits.begun(start.plant.astype(complex)), start.controller, start.waiting
    complexes, numbers = ([np.empty(samples, kind) for _ in range(6)] for kind in (complex, float))
    trace = Trace(
        plant=np.empty((samples, 3), complex),
        source=complexes[0],
        power=complexes[1],
        theta=numbers[0],
        omega=numbers[1],
        V=numbers[2],
        S_f=complexes[2],
        xi_v=complexes[3],
        xi_i=complexes[4],
        i_f=complexes[5],
    )
    for k in range(samples):
        now = (k + COINCIDENT) * T
        trace.plant[k] = x[:3]
        peak, _, phase, _, _ = source.held(now, k * T)
        others = (size * cmath.exp(1j * (order * phase + angle)) for order, size, angle in source.others(now))
        lines = (size * cmath.exp(1j * angle) for _, size, angle in source.lines(k * T))
        trace.source[k] = peak * cmath.exp(1j * phase) + sum(others) + sum(lines) + source.straight(now, k * T)[0]
        for name in ("omega", "S_f", "xi_v", "xi_i", "i_f"):
            getattr(trace, name)[k] = getattr(state, name)
        refs = _references(study, events, now)
        gains = [change.gains for change in gain_changes if change.t_s <= now][-1]
        i_s, v_c, i_g = (complex(entry) for entry in x[:3])
        v_node = v_c + study.filter.R_c * (i_s - i_g)
        if sensors is not None:
            v_node, i_s, i_g = sensors.read(k, v_node, i_s, i_g)
        hits = controller.hits["current"]
        u = 0j if prober is None else prober.value()
        turned, raised = 0.0, 0.0
        if prober is not None:
            whole = state.V + c.V_rated_rms * u
            turned, raised = cmath.phase(whole), abs(whole) - state.V
            state = replace(state, theta=state.theta + turned, V=state.V + raised)
        for name in ("theta", "V"):
            getattr(trace, name)[k] = getattr(state, name)
        theta = state.theta
        controller.v_max = circuits.bridge_limit(controller.v_max)
        state, asked, trace.power[k] = controller.step(state, v_node, i_s, i_g, refs, gains)
        if prober is not None:
            state = replace(state, theta=state.theta - turned, V=state.V - raised)
            prober.hear(v_node, i_g, u, theta, controller.hits["current"] > hits)
        if c.delay_samples == 0:
            applied = asked
        else:
            applied, waiting = waiting, asked
        applied = circuits.acting(applied)
        cuts = [t - k * T for t in instants if COINCIDENT * T < t - k * T < (1.0 - COINCIDENT) * T]
        pieces = bridge_pieces(applied, circuits.modulating(study), k, pwm, cuts)
        trace.edges += len(pieces) - 1 - len(cuts)
        asked_for = []
        for begin, end, v_b in pieces:
            if end - begin < 1e-18:  # shorter than the last bit of any instant here
                continue
            middle = k * T + 0.5 * (begin + end)
            at_begin = (
                *source.held(middle, k * T + begin),
                source.others(middle),
                source.lines(k * T + begin),
                source.straight(middle, k * T + begin),
            )
            asked_for.append((end - begin, v_b, at_begin, circuits.at(middle)))
        x = circuits.moved(x, asked_for, atol, k * T)
    trace.current_limited, trace.voltage_limited = controller.hits["current"], controller.hits["voltage"]
    trace.final_plant = x[:3]
    return trace


def _references(study: Study, events: Sequence[Any], now: float) -> tuple[float, float]:
    P_ref, Q_ref = study.simulation.P_ref, study.simulation.Q_ref
    for event in events:
        if event.t_s <= now:
            P_ref = P_ref if event.P_ref is None else event.P_ref
            Q_ref = Q_ref if event.Q_ref is None else event.Q_ref
    return P_ref, Q_ref
