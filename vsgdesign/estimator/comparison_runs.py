"""The data of a comparison, which are the same for every method: runs, sensors and windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.field import FieldAnswer
from vsgdesign.equations.frames import instantaneous_power
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.estimator.bound import SensorNoise, sensor_noise
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.estimator.scenarios import Scenario, draw_scenario
from vsgdesign.estimator.windows import (
    kept_windows,
    measured_channels,
    record_windows,
    scenario_study,
    synchronised_vectors,
)
from vsgdesign.identification import Estimator
from vsgdesign.identification.field import FieldEstimator
from vsgdesign.identification.interface import CHANNELS, Array, ComplexArray
from vsgdesign.simulation import simulate
from vsgdesign.simulation.every_sample import pcc_vectors
from vsgdesign.simulation.field_feed import FieldScheduler, MeasuredCycle
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.grid import Grid, SourceComponent
from vsgdesign.study.parameters.ranges import Spread
from vsgdesign.study.parameters.sensors import draw_sensors
from vsgdesign.study.parameters.study import ControllerSpec, Study

LINE_ORDERS = (1.5, 2.5)
"""Frequencies of the field estimator's lines over the grid's."""


def has_surroundings(study: Study) -> bool:
    """Whether runs of a study have a background or sensors of their own."""
    return study.background is not None or study.sensors is not None


def surroundings_in_words(study: Study) -> str:
    """Background and sensors of a study's runs in words; empty if it has neither."""
    if not has_surroundings(study):
        return ""
    background = "a pure sine" if study.background is None else f"the background {study.background.level}"
    sensors = "ideal sensors" if study.sensors is None else f"the sensors {study.sensors.level} in the loop"
    return f"{background} and {sensors}, drawn anew for every run"


def in_surroundings(study: Study, recipe: WindowRecipe, key: tuple[int, ...]) -> tuple[Study, WindowRecipe]:
    """Another draw of a study's background and sensors.

    The constant parts of the background, its frequency offset and its voltage factor, become part of the recipe, so
    that the references hold P and Q where the recipe wants them.
    """
    seed = int(np.random.SeedSequence(key).generate_state(1)[0])
    if study.background is not None:
        drawn = study.background.redrawn(seed)
        f_n = study.converter.omega_n / (2.0 * np.pi)
        recipe = replace(
            recipe,
            f_g_pu=_mapped(recipe.f_g_pu, 1.0, drawn.frequency_offset / f_n),
            V_g_pu=_mapped(recipe.V_g_pu, drawn.voltage_factor, 0.0),
        )
        study = replace(study, background=replace(drawn, frequency_offset=0.0, voltage_factor=1.0))
    if study.sensors is not None:
        study = replace(study, sensors=study.sensors.redrawn(seed))
    return study, recipe


def _mapped(spread: Spread, factor: float, offset: float) -> Spread:
    return replace(spread, values=tuple(factor * value + offset for value in spread.values))


@dataclass(frozen=True, eq=False)
class FieldRun:
    """One run with the field estimator: v_pcc and i_pcc (W, 2, 2, n), the converter's angle (W, n), and its answers
    (W, 2) in Ω and H at the end of every window, NaN where there is none."""

    vectors: Array
    theta: Array
    answers: Array
    lines: Array
    """(2,): rms current of the probe's two lines over the whole run, A peak."""
    samples: int
    """Samples of the controller in the whole run. The estimator takes every one; the log may have fewer rows."""


def field_run(study: Study, recipe: WindowRecipe, scenario: Scenario, estimator: FieldEstimator) -> FieldRun:
    """Simulates a scenario with the field estimator, which the gains do not follow, so that all methods see the same
    converter. Where the study has no sensors, those of the recipe are put into the loop."""
    kept = kept_windows(recipe)
    case = scenario_study(study, recipe, scenario)
    if case.sensors is None:
        noise = max(scenario.noise)
        seed = int(np.random.SeedSequence((*scenario.seed, 3)).generate_state(1)[0])
        case = replace(case, sensors=draw_sensors({"noise": (noise, noise)}, seed, "ideal", bits=recipe.adc_bits))
    components = tuple(
        SourceComponent(float(order), abs(value), float(np.sign(order) * np.angle(value)))
        for order, value in scenario.harmonics.items()
    )
    source = replace(case.grid_source, components=(*case.grid_source.components, *components))
    case = replace(case, grid_source=source)
    name = "field" if estimator.network is None else "field_network"
    listener = _Listener(case, name, scenario.gains, kept.change_s)
    simulation = simulate(case, listener).to_its_end()
    n, windows = recipe.samples, np.array(kept.windows)
    rows = (windows[:, None] * n + np.arange(n)).ravel()
    grids = (scenario.grids[0], scenario.grids[1])
    after = windows >= kept.begins
    v_pcc, i_pcc = pcc_vectors(
        simulation.log[rows],
        case.circuit()._replace(
            **{name: np.repeat([getattr(grids[int(k)], name) for k in after], n)[:, None] for name in ("R_g", "L_g")}
        ),
    )
    vectors = np.stack([x.T.reshape(2, len(windows), n) for x in (v_pcc, i_pcc)]).transpose(2, 0, 1, 3)
    log = listener.log(simulation.timeline)
    ends = (windows + 1) * recipe.update_period
    found = np.searchsorted(log.t_s, ends + 1e-9, side="right") - 1
    said = np.column_stack([log.R_g_hat, log.L_g_hat])
    answers = np.where(found[:, None] >= 0, said[np.maximum(found, 0)], np.nan)
    i = simulation.column("i_g_alpha") + 1j * simulation.column("i_g_beta")
    lines = _line_currents(i, recipe.sample_interval, n, case.grid_source.omega_g)
    theta = simulation.column("theta")[rows].reshape(len(windows), n)
    samples = round(case.simulation.duration / case.converter.T_s)
    return FieldRun(vectors, theta, answers, lines, samples)


def _line_currents(i: NDArray[Any], h: float, n: int, omega: float) -> Array:
    """Rms amplitudes (2,) of the probe's lines in stretches of two cycles of n samples, in which lines, fundamental and
    harmonics are orthogonal. A stretch in which the code changes a line's sign shows less of it, up to a tenth of the
    whole."""
    length = 2 * n
    t = np.arange(len(i) // length * length) * h
    found = [i[: len(t)] * np.exp(-1j * order * omega * t) for order in LINE_ORDERS]
    return np.array([np.sqrt(np.mean(np.abs(x.reshape(-1, length).mean(axis=1)) ** 2)) for x in found])


class _Listener(FieldScheduler):
    """The field estimator beside gains that are known: those of the first grid, then those of the second."""

    def __init__(
        self, case: Study, estimate: str, gains: tuple[PowerLoopGains, PowerLoopGains], change_s: float
    ) -> None:
        self._known, self._change_s = gains, change_s
        spec = ControllerSpec(name="listener", kind="scheduled", target=case.target, estimate=estimate)
        super().__init__(case, spec)

    def begin(self) -> FieldScheduler:
        super().begin()
        self._first = self._known[0]
        return self

    def _followed(self, answer: FieldAnswer, measured: MeasuredCycle) -> tuple[PowerLoopGains | None, bool]:  # noqa: ARG002
        return self._known[int(measured.t_s > self._change_s + 1e-9)], False


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """One run before its sensors: W windows of n samples that follow each other, the first ``before`` at rest."""

    converter: Converter
    recipe: WindowRecipe
    vectors: Array
    """(W, 2, 2, n): v_pcc and i_pcc, α and β, peak."""
    synchronised: Array
    """The same, turned so that the vector of a grid of nominal frequency begins every window at the same angle. A
    network of synchronised windows receives these. They are equal to ``vectors`` if windows are whole cycles."""
    theta: Array
    """(W, n): the converter's angle, rad."""
    sent: ComplexArray
    """(W, n): the probe as it was sent."""
    limited: NDArray[np.int64]
    """(W,): samples in which the current was limited."""
    omega: float
    """Mean frequency of the converter in the windows at rest, rad/s. It is the grid's frequency as a converter knows
    it."""
    grids: tuple[Grid, ...]
    """The grid of each window."""
    noise: tuple[float, float]
    """Of voltage and current, relative to the rated peak."""
    seed: tuple[int, ...]
    sensed: bool = False
    """Whether the sensors were in the loop. No noise is added afterwards then."""
    adc: tuple[int, float] = (0, 3.0)
    """Bits and range (pu) of these sensors."""
    field: FieldRun | None = None
    """The run of the field estimator if it was in the loop, else None."""

    @property
    def space_vectors(self) -> tuple[ComplexArray, ComplexArray]:
        """(W·n,) v_pcc and i_pcc as α + jβ, before the sensors."""
        v, i = (self.vectors[:, k, 0] + 1j * self.vectors[:, k, 1] for k in range(2))
        return v.ravel(), i.ravel()

    @property
    def powers(self) -> tuple[Array, Array]:
        """(W·n,) instantaneous P (W) and Q (var)."""
        v, i = self.space_vectors
        P, Q = instantaneous_power(v.real, v.imag, i.real, i.imag)
        return np.asarray(P), np.asarray(Q)


@dataclass(frozen=True, eq=False, kw_only=True)
class Record:
    """B measured runs of W windows of n samples, SI, peak. All runs have the same sampling."""

    channels: dict[str, Array]
    """(B, W, 2·C·n) by name of identification.interface.CHANNELS, SI, peak: v, then i, of C components of n samples."""
    synchronised: dict[str, Array]
    """The same from synchronised windows (:attr:`Run.synchronised`)."""
    theta: Array
    """(B, W, n): the converter's angle, rad."""
    sent: ComplexArray
    """(B, W, n): the probe as it was sent."""
    limited: NDArray[np.int64]
    """(B, W): samples in which the current was limited."""
    omega: Array
    """(B,): the grid's frequency as the converter knows it, rad/s."""
    R_g: Array
    L_g: Array
    """(B, W): the truth, Ω and H."""
    noise: tuple[SensorNoise, ...]
    """(B,): noise of the sensors."""
    sample_interval: float
    samples: int
    answers: Array | None = None
    """(B, W, 2): R_g (Ω) and L_g (H) from an estimator in the loop; None if there was none."""

    @property
    def windows(self) -> int:
        """Windows of a run, W."""
        return self.R_g.shape[1]


def run_case(
    study: Study,
    recipe: WindowRecipe,
    index: int,
    seed: int = 0,
    prober: Estimator | None = None,
    draw: int = 0,
) -> Run:
    """Simulates one scenario of a recipe whose windows follow each other (``every`` 1, ``skip`` 0).

    ``prober`` is an estimator whose probe is sent. ``draw`` is the number of the draw of the study's background and of
    the sensors in the loop.
    """
    drawn_study, recipe = in_surroundings(study, recipe, (seed, index, 4, draw))
    scenario = draw_scenario(drawn_study, recipe, seed, index)
    scenario = replace(scenario, seed=(*scenario.seed, draw)) if draw else scenario
    found = None
    if isinstance(prober, FieldEstimator):
        found = field_run(drawn_study, recipe, scenario, prober)
        kept = kept_windows(recipe)
        after = np.array([k >= kept.begins for k in kept.windows])
        theta, vectors = found.theta, found.vectors
        sent, limited = np.zeros(theta.shape, dtype=complex), np.zeros(len(theta), dtype=np.int64)
        turned = vectors
    else:
        windows, after, vectors = record_windows(drawn_study, recipe, scenario, prober)
        theta = np.array([window.theta for window in windows])
        sent = np.array([window.sent_values for window in windows])
        limited = np.array([window.limited for window in windows], dtype=np.int64)
        turned = synchronised_vectors(drawn_study, recipe, windows, vectors)
    at_rest = np.unwrap(theta[~after].ravel())
    slope = np.polynomial.polynomial.polyfit(np.arange(len(at_rest)) * recipe.sample_interval, at_rest, 1)[1]
    sensors = drawn_study.sensors
    adc = (recipe.adc_bits, recipe.adc_range_pu) if sensors is None else (sensors.bits, sensors.range_pu or 3.0)
    return Run(
        converter=study.converter,
        recipe=recipe,
        vectors=vectors,
        synchronised=turned,
        theta=theta,
        sent=sent,
        limited=limited,
        omega=float(slope),
        grids=tuple(scenario.grids[int(later)] for later in after),
        noise=scenario.noise if sensors is None else (sensors.noise, sensors.noise),
        seed=scenario.seed,
        sensed=sensors is not None or found is not None,
        adc=adc,
        field=found,
    )


def measure(runs: Sequence[Run], draws: int = 1) -> Record:
    """The measured runs: every run ``draws`` times, each time with noise of its own. B = runs × draws, run by run."""
    first = runs[0]
    c = first.converter
    plain, synchronised = ({channels: [] for channels in CHANNELS} for _ in range(2))
    for run in runs:
        noise = (0.0, 0.0) if run.sensed else run.noise
        for draw in range(draws):
            for channels in CHANNELS:
                bits = 0 if run.sensed else run.recipe.adc_bits
                recipe = replace(run.recipe, channels=channels, adc_bits=bits)

                def seen(
                    vectors: Array,
                    run: Run = run,
                    draw: int = draw,
                    recipe: WindowRecipe = recipe,
                    noise: tuple[float, float] = noise,
                ) -> Array:
                    rng = np.random.default_rng((*run.seed, 2, draw))  # the same sensors, seen in several ways
                    return measured_channels(c, recipe, vectors, run.theta, noise, rng)

                windows = seen(run.vectors)
                plain[channels].append(windows)
                same = run.synchronised is run.vectors
                synchronised[channels].append(windows if same else seen(run.synchronised))
    repeated = [run for run in runs for _ in range(draws)]
    return Record(
        channels={name: np.array(windows) for name, windows in plain.items()},
        synchronised={name: np.array(windows) for name, windows in synchronised.items()},
        theta=np.array([run.theta for run in repeated]),
        sent=np.array([run.sent for run in repeated]),
        limited=np.array([run.limited for run in repeated]),
        omega=np.array([run.omega for run in repeated]),
        R_g=np.array([[grid.R_g for grid in run.grids] for run in repeated]),
        L_g=np.array([[grid.L_g for grid in run.grids] for run in repeated]),
        noise=tuple(sensor_noise(c, run.noise, *run.adc) for run in repeated),
        sample_interval=first.recipe.sample_interval,
        samples=first.recipe.samples,
        answers=np.array([run.field.answers for run in repeated if run.field is not None]) if first.field else None,
    )
