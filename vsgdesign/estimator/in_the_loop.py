"""Runs of a comparison in a real grid: with a background, with sensors in the loop, and with an estimator in it.

A study's [background] and [sensors] are drawn anew for every run. The field estimator always needs its sensors in the
loop, because it works in every sample of the controller.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.field import FieldAnswer
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.estimator.recipe_fields import Spread
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.estimator.scenarios import Scenario
from vsgdesign.estimator.windows import kept_windows, scenario_study
from vsgdesign.identification.field import FieldEstimator
from vsgdesign.identification.interface import Array
from vsgdesign.parameters.sensors import draw_sensors
from vsgdesign.parameters.source import SourceComponent
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.simulation import simulate
from vsgdesign.simulation.at_pcc import pcc_vectors
from vsgdesign.simulation.field_feed import FieldScheduler, MeasuredCycle

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
