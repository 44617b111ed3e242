"""Windows straight from EMT: each scenario is one run that begins at rest, and what its sensors read of it.

A window is what an online scheduler is given in the loop, cut by the same code, so a network is trained on
what it will see. The readings have background harmonics, noise, quantisation and channels.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import clarke, clarke_inverse, rms_to_peak, rotate, rotate_back
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.estimator.data_set import Array, Arrays
from vsgdesign.estimator.recipes import WindowRecipe, turn_per_window
from vsgdesign.estimator.scenarios import Scenario
from vsgdesign.identification import Estimator, Probe
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.stability.loops import grid_impedance, output_admittance
from vsgdesign.simulation import MeasuredWindow, Recorder, simulate
from vsgdesign.simulation.estimated import samples_of
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Event, Study


@dataclass(frozen=True)
class _TwoGains:
    """Gains of the first grid, then of the second from the first update that has seen it."""

    gains: tuple[PowerLoopGains, PowerLoopGains]
    change_s: float
    update_period: float
    sample_interval: float

    def first_gains(self) -> PowerLoopGains:
        return self.gains[0]

    def update(self, window: MeasuredWindow) -> PowerLoopGains:
        return self.gains[int(window.t_s > self.change_s + 0.5 * window.sample_interval)]


class _Probing:
    """A scheduler whose windows go to an estimator as well, which says what probe is sent."""

    def __init__(self, scheduler: _TwoGains, prober: Estimator) -> None:
        self._scheduler, self._prober = scheduler, prober
        self.update_period, self.sample_interval = scheduler.update_period, scheduler.sample_interval
        self.probe_hold = prober.needs.probe_hold
        self._state = prober.first()

    def first_gains(self) -> PowerLoopGains:
        return self._scheduler.first_gains()

    def wanted(self) -> Probe | None:
        return self._prober.probe(self._state)

    def update(self, window: MeasuredWindow) -> PowerLoopGains:
        for samples in samples_of(window, self._prober.needs):
            self._state, _ = self._prober.update(self._state, samples)
        return self._scheduler.update(window)


def windows_header(studies: Sequence[Study], recipe: WindowRecipe, seed: int) -> dict[str, Any]:
    """The header of a :class:`vsgdesign.estimator.data_set.DataSet`."""
    (study,) = studies
    c = study.converter
    loops = (
        study.inner_gains,
        study.omega_t,
        study.target,
        study.tau_P,
        study.tau_Q,
        *([study.notch] if study.has_notch else []),
    )
    used = (c, study.filter, *loops, study.grid_source.V_g_rms)
    return {
        "recipe": recipe.document(),
        "seed": seed,
        "synchronised": recipe.synchronised,
        "study": study.name,
        "converter_hash": hashlib.sha256(repr(used).encode()).hexdigest(),
        "S_rated": c.S_rated,
        "V_rated_rms": c.V_rated_rms,
        "omega_n": c.omega_n,
        "T_s": c.T_s,
    }


class Kept(NamedTuple):
    """Which windows of a run are kept: their numbers, the first after the change, and the instant of the change, s."""

    windows: tuple[int, ...]
    begins: int
    change_s: float


def kept_windows(recipe: WindowRecipe) -> Kept:
    """The windows of a recipe whose sampling is filled in."""
    begins = recipe.settle + recipe.before
    kept = list(range(recipe.settle, begins))
    kept += range(begins + recipe.skip, begins + recipe.skip + recipe.after * recipe.every, recipe.every)
    return Kept(tuple(kept), begins, begins * recipe.update_period)


def scenario_study(study: Study, recipe: WindowRecipe, scenario: Scenario) -> Study:
    """The study of one scenario: its grids, its source, its set points and its bridge."""
    kept = kept_windows(recipe)
    (P_ref, Q_ref), (P_new, Q_new) = scenario.references
    events = [Event(0.0, "phase", phase_jump=scenario.phase)] if scenario.phase else []
    if recipe.after:
        events.append(Event(kept.change_s, "change", grid=scenario.grids[1], P_ref=P_new, Q_ref=Q_new))
    spec = replace(
        study.simulation,
        duration=(kept.windows[-1] + 1) * recipe.update_period,
        bridge=recipe.bridge,
        start="steady_state",
        log_interval=recipe.sample_interval,
        P_ref=P_ref,
        Q_ref=Q_ref,
    )
    return replace(study, grid=scenario.grids[0], grid_source=scenario.source, simulation=spec, events=tuple(events))


def record_windows(
    study: Study, recipe: WindowRecipe, scenario: Scenario, prober: Estimator | None = None
) -> tuple[list[MeasuredWindow], NDArray[np.bool_], Array]:
    """Simulate one scenario: its windows, which come after the change, and v_pcc and i_pcc before the sensors.

    The recipe's sampling is filled in. The last is (N, 2, 2, n): voltage and current, α and β, with the background's
    harmonics. ``prober`` is an estimator whose probe is sent, as it wants it from what it sees without sensors' noise.
    """
    kept = kept_windows(recipe)
    case = scenario_study(study, recipe, scenario)
    scheduler = _TwoGains(scenario.gains, kept.change_s, recipe.update_period, recipe.sample_interval)
    recorder = Recorder(scheduler if prober is None else _Probing(scheduler, prober))
    simulate(case, recorder).to_its_end()
    windows = [recorder.windows[k] for k in kept.windows]
    after = np.array([k >= kept.begins for k in kept.windows])
    vectors = np.array([(w.v_pcc.T, w.i_pcc.T) for w in windows])
    if scenario.harmonics:
        vectors = vectors + background(case, recipe, scenario, windows, after)
    return windows, after, vectors


def synchronised_vectors(
    study: Study, recipe: WindowRecipe, windows: Sequence[MeasuredWindow], vectors: Array
) -> Array:
    """(N, 2, 2, n) turned so that a grid of nominal frequency begins every window at the same angle.

    The same array where windows are whole cycles, or are not synchronised anyway.
    """
    step = turn_per_window(recipe, study.converter)
    if step == 0.0 or not recipe.synchronised:
        return vectors
    back = -step * np.array([window.index for window in windows])[:, None, None]
    return np.stack(rotate(vectors[:, :, 0], vectors[:, :, 1], np.cos(back), np.sin(back)), axis=2)


def run_windows(studies: Sequence[Study], recipe: WindowRecipe, scenario: Scenario) -> Arrays:
    """Simulate one scenario and take its windows: the arrays of a :class:`vsgdesign.estimator.data_set.DataSet`."""
    (study,) = studies
    # A recipe has its own harmonics and noise.
    windows, after, vectors = record_windows(study.undisturbed, recipe, scenario)
    grids = [scenario.grids[int(later)] for later in after]
    rng = np.random.default_rng((*scenario.seed, 1))
    vectors = synchronised_vectors(study, recipe, windows, vectors)
    x = measured_channels(study.converter, recipe, vectors, np.array([w.theta for w in windows]), scenario.noise, rng)
    count = len(windows)
    return {
        "windows": x,
        "scenario": np.full(count, scenario.index, dtype=np.int64),
        "after_change": after,
        "R_g": np.array([grid.R_g for grid in grids]),
        "L_g": np.array([grid.L_g for grid in grids]),
        "P": np.array([w.P for w in windows]),
        "Q": np.array([w.Q for w in windows]),
        "V_rms": np.array([w.V_rms for w in windows]),
        "V_g_rms": np.full(count, scenario.source.V_g_rms),
        "omega_g": np.full(count, scenario.source.omega_g),
        "source_phase": np.array([w.source_phase for w in windows]),
        "t_s": np.array([w.t_s for w in windows]),
        "redrawn": np.tile(np.array(scenario.redrawn, dtype=np.int64), (count, 1)),
    }


def measured_channels(
    converter: Converter,
    recipe: WindowRecipe,
    vectors: Array,
    theta: Array,
    noise: tuple[float, float],
    rng: np.random.Generator,
) -> Array:
    """Windows (N, 2·C·n) as the sensors measure them, in V and A peak.

    ``vectors`` (N, 2, 2, n) are voltage and current, α and β, samples. Noise (relative to the rated peak) and
    quantisation act on the sensor of each phase, before any transformation. ``theta`` (N, n) is the converter's own
    angle in rad, for the dq channels.
    """
    ratings = np.array([rms_to_peak(converter.V_rated_rms), converter.I_rated_pk]).reshape(1, 2, 1, 1)
    phases = np.stack(clarke_inverse(vectors[:, :, 0], vectors[:, :, 1]), axis=2)
    if max(noise) > 0.0:
        phases = phases + rng.normal(size=phases.shape) * ratings * np.reshape(noise, (1, 2, 1, 1))
    if recipe.adc_bits:
        full = recipe.adc_range_pu * ratings
        step = 2.0 * full / 2.0**recipe.adc_bits
        phases = np.clip(np.round(phases / step) * step, -full, full - step)
    if recipe.channels == "phase_a":
        return phases[:, :, 0].reshape(len(phases), -1)
    alpha, beta = clarke(phases[:, :, 0], phases[:, :, 1], phases[:, :, 2])
    if recipe.channels == "dq":
        alpha, beta = rotate_back(alpha, beta, np.cos(theta)[:, None], np.sin(theta)[:, None])
    return np.stack([alpha, beta], axis=2).reshape(len(phases), -1)


def harmonic_phasors(
    study: Study, grid: Grid, gains: PowerLoopGains, references: tuple[float, float], orders: Sequence[int]
) -> dict[int, tuple[Array, Array]]:
    """The responses of v_pcc and i_pcc to a unit harmonic of the grid's voltage, for each order.

    They are dq phasors (2,) in the frame of the source, at |order − 1|·ω_g; an order is negative for the negative
    sequence. The converter responds with the admittance of its sampled full-order model
    (:eq:`background-harmonics`), which is exact for small harmonics. Raises InfeasibleStudyError if there is no steady
    state.
    """
    omega_g = study.grid_source.omega_g
    model = linearise_full_order(study, [Cell(grid, gains, *references)])
    if model.faults[0] is not None:
        raise InfeasibleStudyError(model.faults[0])
    found = {}
    for order in orders:
        omega = np.array([abs(order - 1) * omega_g])
        Y = output_admittance(model, 0, omega)[0]
        Z = grid_impedance(grid.R_g, grid.L_g, omega_g, omega)[0]
        # e^{±jx} on d + jq is d = cos x, q = ±sin x: phasors 1 and ∓j.
        source = np.array([1.0, -1j if order > 0 else 1j])
        v = np.linalg.solve(np.eye(2) + Z @ Y, source)
        found[order] = (v, -Y @ v)
    return found


def background_vectors(
    phasors: Mapping[int, tuple[Array, Array]], amplitudes: Mapping[int, complex], source_phase: Array
) -> Array:
    """Voltage and current of background harmonics (2, 2, n), α and β, at angles of the source (n), rad.

    With the ``amplitudes`` (V peak, complex), the grid's vector is a·e^{jhθ_g} for an order h > 0 and a*·e^{−j|h|θ_g}
    for h < 0, where θ_g is the angle of its fundamental.
    """
    turn = np.exp(1j * source_phase)
    total: NDArray[np.complex128] = np.zeros((2, len(source_phase)), dtype=complex)
    for order, amplitude in amplitudes.items():
        wave = amplitude * np.exp(1j * abs(order - 1) * source_phase)
        for row, (d, q) in enumerate(phasors[order]):
            total[row] += ((d * wave).real + 1j * (q * wave).real) * turn
    return np.stack([total.real, total.imag], axis=1)


def background(
    study: Study, recipe: WindowRecipe, scenario: Scenario, windows: Sequence[MeasuredWindow], after: NDArray[np.bool_]
) -> Array:
    """The voltages and currents (N, 2, 2, n) that the background harmonics of a scenario add to its windows."""
    source = scenario.source
    phasors = [
        harmonic_phasors(study, *held, list(scenario.harmonics))
        for held in zip(scenario.grids, scenario.gains, scenario.references, strict=True)
    ]
    amplitudes = {order: value * rms_to_peak(source.V_g_rms) for order, value in scenario.harmonics.items()}
    turned = np.asarray(source.omega_g * recipe.sample_interval * np.arange(recipe.samples), dtype=np.float64)
    return np.array(
        [
            background_vectors(phasors[int(later)], amplitudes, window.source_phase + turned)
            for window, later in zip(windows, after, strict=True)
        ]
    )
