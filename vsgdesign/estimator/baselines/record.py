"""What every method is given: the same runs, through the same sensors, cut into the same windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.estimator.bound import SensorNoise, sensor_noise
from vsgdesign.estimator.recipes import CHANNELS, WindowRecipe
from vsgdesign.estimator.scenarios import draw_scenario
from vsgdesign.estimator.sensing import measured_channels
from vsgdesign.estimator.windows import record_windows, synchronised_vectors
from vsgdesign.frames import instantaneous_power, rms_to_peak
from vsgdesign.parameters.study import Converter, Grid, Study
from vsgdesign.simulation import Probe

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Run:
    """One run before its sensors: W windows of n samples that follow each other, the first ``before`` at rest."""

    converter: Converter
    recipe: WindowRecipe
    vectors: Array
    """(W, 2, 2, n): v_pcc and i_pcc, α and β, peak."""
    synchronised: Array
    """The same turned so that a grid of nominal frequency begins every window at the same angle: what a network of
    synchronised windows is shown. Equal where windows are whole cycles."""
    theta: Array
    """(W, n): the converter's angle, rad."""
    omega: float
    """The converter's mean frequency in the windows at rest, rad/s: the grid's, as a converter knows it."""
    grids: tuple[Grid, ...]
    """The grid of each window."""
    noise: tuple[float, float]
    """Of voltage and current, relative to the rated peak."""
    seed: tuple[int, ...]

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


@dataclass(frozen=True, eq=False)
class Record:
    """B measured runs of W windows of n samples, SI, peak. All runs have the same sampling."""

    v: ComplexArray
    """(B, W·n): α + jβ at the PCC."""
    i: ComplexArray
    channels: dict[str, Array]
    """(B, W, 2·C·n) by name of recipes.CHANNELS: windows as a network takes them; ``phase_a``: v_a, then i_a."""
    omega: Array
    """(B,): the grid's frequency as the converter knows it, rad/s."""
    R_g: Array
    L_g: Array
    """(B, W): the truth, Ω and H."""
    noise: tuple[SensorNoise, ...]
    """(B,): what the sensors add."""
    sample_interval: float
    samples: int
    V_base: float
    Z_base: float
    """Rated peak voltage and base impedance, to scale with."""
    omega_n: float

    @property
    def windows(self) -> int:
        """Windows of a run, W."""
        return self.R_g.shape[1]

    def rotating(self) -> tuple[ComplexArray, ComplexArray]:
        """v and i in the frame that turns at ``omega`` from the first sample on: the grid's phasor stands still."""
        steps = np.arange(self.v.shape[1]) * self.sample_interval
        turn = np.exp(-1j * self.omega[:, None] * steps[None, :])
        return self.v * turn, self.i * turn


class Estimates(NamedTuple):
    """(B, W) each: R_g in Ω and L_g in H at the end of every window; NaN where there is none."""

    R_g: Array
    L_g: Array


class Method(Protocol):
    """A way to measure the grid."""

    @property
    def name(self) -> str:
        """As figures and tables call it."""
        ...

    @property
    def probe(self) -> Probe | None:
        """What it adds to the converter's voltage."""
        ...

    @property
    def signals(self) -> str:
        """Which signal set it lives on: a key of ``SIGNAL_SETS``."""
        ...

    def estimate(self, record: Record) -> Estimates:
        """One estimate per window, from what was measured up to its end."""
        ...


SIGNAL_SETS = {
    "none": "nothing measured",
    "steady": "one steady window, grid phase and X/R known",
    "two_windows": "two windows about a power step",
    "windows": "all windows about a power step",
    "injection": "one line beside the fundamental, over two windows",
    "pseudo_random": "one period of the binary sequence",
}


def run_case(study: Study, recipe: WindowRecipe, index: int, seed: int = 0, probe: Probe | None = None) -> Run:
    """Simulate one scenario of a recipe whose windows follow each other (``every`` 1, ``skip`` 0)."""
    scenario = draw_scenario(study, recipe, seed, index)
    windows, after, vectors = record_windows(study, recipe, scenario, probe)
    theta = np.array([window.theta for window in windows])
    at_rest = np.unwrap(theta[~after].ravel())
    slope = np.polynomial.polynomial.polyfit(np.arange(len(at_rest)) * recipe.sample_interval, at_rest, 1)[1]
    grids = tuple(scenario.grids[int(later)] for later in after)
    turned = synchronised_vectors(study, recipe, windows, vectors)
    return Run(study.converter, recipe, vectors, turned, theta, float(slope), grids, scenario.noise, scenario.seed)


def measure(runs: Sequence[Run], draws: int = 1) -> Record:
    """The runs through their sensors, ``draws`` times each with noise of its own: B = runs × draws, run by run."""
    first = runs[0]
    c, n = first.converter, first.recipe.samples
    v, i, seen = [], [], {channels: [] for channels in CHANNELS}
    for run in runs:
        for draw in range(draws):

            def taken(channels: str, vectors: Array, run: Run = run, draw: int = draw) -> Array:
                rng = np.random.default_rng((*run.seed, 2, draw))  # the same sensors, seen in several ways
                recipe = replace(run.recipe, channels=channels)
                return measured_channels(c, recipe, vectors, run.theta, run.noise, rng)

            both = taken("alpha_beta", run.vectors).reshape(-1, 2, 2, n)
            v.append((both[:, 0, 0] + 1j * both[:, 0, 1]).ravel())
            i.append((both[:, 1, 0] + 1j * both[:, 1, 1]).ravel())
            for channels, windows in seen.items():
                windows.append(taken(channels, run.vectors if channels == "dq" else run.synchronised))
    repeated = [run for run in runs for _ in range(draws)]
    return Record(
        np.array(v),
        np.array(i),
        {name: np.array(windows) for name, windows in seen.items()},
        np.array([run.omega for run in repeated]),
        np.array([[grid.R_g for grid in run.grids] for run in repeated]),
        np.array([[grid.L_g for grid in run.grids] for run in repeated]),
        tuple(sensor_noise(c, run.noise, run.recipe.adc_bits, run.recipe.adc_range_pu) for run in repeated),
        first.recipe.sample_interval,
        n,
        rms_to_peak(c.V_rated_rms),
        c.Z_base,
        c.omega_n,
    )


def held(values: Array, valid: NDArray[np.bool_]) -> Array:
    """(B, W) values with the last valid one kept where one is not; NaN before the first."""
    columns = np.where(valid, np.arange(values.shape[1])[None, :], -1)
    last = np.maximum.accumulate(columns, axis=1)
    taken = np.take_along_axis(values, np.maximum(last, 0), axis=1)
    return np.where(last >= 0, taken, np.nan)
