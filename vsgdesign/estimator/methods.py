"""What a comparison compares: its grids and sensors, and the estimators, fed as a controller would feed them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vsgdesign.artifacts.field_weights import read_field_weights
from vsgdesign.artifacts.network_weights import NetworkWeights, WindowFormat
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import ArtifactError, InfeasibleStudyError
from vsgdesign.estimator.comparison_runs import Record
from vsgdesign.estimator.recipe_fields import check_recipe
from vsgdesign.estimator.recipes import PUBLISHED, WindowRecipe, with_sampling
from vsgdesign.estimator.scenarios import why_not
from vsgdesign.identification import ESTIMATORS, GUESS_SCR, Estimator, EstimatorKind, Installation, Samples
from vsgdesign.identification.interface import Array
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.ranges import one_of
from vsgdesign.study.parameters.study import Study

BEFORE, AFTER = 10, 40
"""Windows before and after the change; the last JUDGED of them are what a method is judged by."""
JUDGED = 20
SETTLE = 60
"""Windows before these. During them a switched bridge makes the power drift, and the converter's frequency with it."""


@dataclass(frozen=True, kw_only=True)
class ComparisonSettings:
    """Grids and sensors of a comparison. Powers are per unit of the rating."""

    scr: tuple[float, ...] = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0)
    x_over_r: float = 1.0
    grid_steps: tuple[tuple[float, float], ...] = ((2.0, 8.0), (8.0, 20.0))
    guess_scr: float = GUESS_SCR
    P_pu: float = 0.5
    Q_pu: float = 0.2
    P_step_pu: float = 0.1
    noise: float = 1e-3
    """White noise of every sample, relative to the rated peak."""
    adc_bits: int = 12
    draws: int = 4
    """Of the sensors' noise, on every run."""
    seed: int = 0

    def recipe(self, window: WindowFormat | None = None) -> WindowRecipe:
        """The recipe of runs that begin at rest and have a power step, from which a passive method can learn.

        Windows are sampled as in ``window``; with None the sampling follows from the converter. Raises StudyError for
        values that make no recipe.
        """
        made = replace(
            PUBLISHED,
            name="comparison",
            scr=one_of(*self.scr),
            x_over_r=one_of(self.x_over_r),
            P_pu=one_of(self.P_pu),
            Q_pu=one_of(self.Q_pu),
            P_step_pu=one_of(self.P_step_pu),
            Q_step_pu=one_of(0.0),
            settle=SETTLE,
            before=BEFORE,
            after=AFTER,
            every=1,
            skip=0,
            noise_v=one_of(self.noise),
            noise_i=one_of(self.noise),
            adc_bits=self.adc_bits,
            scenarios=len(self.scr),
            samples=0 if window is None else window.samples,
            sample_interval=0.0 if window is None else window.sample_interval,
        )
        return check_recipe(made, "comparison")


def runnable_settings(study: Study, settings: ComparisonSettings) -> tuple[ComparisonSettings, tuple[str, ...]]:
    """The settings with the grids alone that the converter can be run on, and a sentence on each that is left out.

    A step from or to a grid that is left out begins or ends at the nearest SCR that is not. Raises
    InfeasibleStudyError where no grid is left.
    """
    asked = sorted({*settings.scr, *(scr for pair in settings.grid_steps for scr in pair)})
    recipes = {scr: replace(settings, scr=(scr,)).recipe() for scr in asked}
    kept, left_out = runnable_values(study, recipes, "SCR", settings.seed)
    if not any(scr in kept for scr in settings.scr):
        raise InfeasibleStudyError(
            f"none of the comparison's grids can be run with P = {settings.P_pu:g} pu, Q = {settings.Q_pu:g} pu and "
            f"X/R {settings.x_over_r:g}: {' '.join(left_out)}"
        )
    pairs = (tuple(min(kept, key=lambda one: abs(one - scr)) for scr in pair) for pair in settings.grid_steps)
    steps = tuple(dict.fromkeys((first, then) for first, then in pairs if first != then))
    return replace(settings, scr=tuple(scr for scr in settings.scr if scr in kept), grid_steps=steps), left_out


def runnable_values(
    study: Study, recipes: dict[float, WindowRecipe], what: str, seed: int
) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Of recipes by the value that each stands for, the values that can be run, and a sentence on each other."""
    reasons = {value: why_not(study, recipe, seed) for value, recipe in recipes.items()}
    left_out = (f"{what} {value:g} is left out: {reason}." for value, reason in reasons.items() if reason)
    return tuple(value for value, reason in reasons.items() if not reason), tuple(left_out)


def nominal_settings(settings: ComparisonSettings) -> ComparisonSettings:
    """Those of the one grid that a stress is about."""
    return replace(settings, scr=(8.0,), grid_steps=())


def window_of(recipe: WindowRecipe, converter: Converter) -> WindowFormat:
    """The format of the windows of a recipe on a converter."""
    sampled = with_sampling(recipe, converter)
    return WindowFormat(sampled.samples, sampled.sample_interval, sampled.channels, sampled.synchronised)


def comparison_recipe(study: Study, settings: ComparisonSettings, windows: dict[str, WindowFormat]) -> WindowRecipe:
    """The recipe of the runs, with the windows that the networks take. Raises ArtifactError if their windows differ."""
    kinds = {(one.samples, one.sample_interval) for one in windows.values()}
    if len(kinds) > 1:
        taken = "; ".join(
            f"{name}: {one.samples} samples every {one.sample_interval * 1e6:g} µs" for name, one in windows.items()
        )
        raise ArtifactError(
            f"networks of different windows cannot be compared on the same ones ({taken}). Compare them in two calls, "
            "or train them with the same samples and sample_interval."
        )
    return with_sampling(settings.recipe(next(iter(windows.values()), None)), study.converter)


def with_sensors(recipe: WindowRecipe, settings: ComparisonSettings) -> WindowRecipe:
    """A recipe with the sensors of a comparison, so that a network is trained with their noise."""
    return replace(
        recipe,
        name=f"{recipe.name}_sensors",
        noise_v=one_of(settings.noise),
        noise_i=one_of(settings.noise),
        adc_bits=settings.adc_bits,
    )


class Estimates(NamedTuple):
    """(B, W) each: R_g in Ω and L_g in H at the end of every window; NaN where there is none."""

    R_g: Array
    L_g: Array


@dataclass(frozen=True, eq=False)
class Method:
    """An estimator in a comparison.

    A network receives the grid's phase, as published, which the other methods do not have. Estimates count whatever
    their status is. An estimate of a network outside its trained range is clipped, as on the controller.
    """

    kind: EstimatorKind
    at: Installation
    """Without the noise of the sensors, which belongs to a run."""
    title: str | None = None
    """None: the estimator's own."""

    @cached_property
    def estimator(self) -> Estimator:
        """The estimator as it is built if the noise of the sensors is not known."""
        return self.kind.build(self.at)

    @property
    def name(self) -> str:
        """The name in figures and tables."""
        return self.title or self.estimator.title

    @property
    def probes(self) -> bool:
        """Whether it moves the converter's voltage or power."""
        return self.estimator.needs.probe_hold is not None

    def estimate(self, record: Record) -> Estimates:
        """One estimate for each window, from the samples up to its end. Raises ArtifactError if the windows do not
        fit."""
        if record.answers is not None and self.kind.by_sample:  # it was in the loop
            return Estimates(record.answers[:, :, 0], record.answers[:, :, 1])
        B, W = record.R_g.shape
        found = np.full((B, W, 2), np.nan)
        for run, noise in enumerate(record.noise):
            estimator = self.kind.build(replace(self.at, noise=(noise.v, noise.i)))
            state = estimator.first()
            for window in range(W):
                answer = None
                for samples in _fed(estimator, record, run, window):
                    state, new = estimator.update(state, samples)
                    answer = answer if new is None else new
                if answer is not None:
                    found[run, window] = answer[:2]
        return Estimates(found[:, :, 0], found[:, :, 1])


def _fed(estimator: Estimator, record: Record, run: int, window: int) -> Iterator[Samples]:
    """The samples of a window as an estimator takes them: at once, or in equal parts."""
    needs = estimator.needs
    if abs(needs.sample_interval - record.sample_interval) > 1e-9 * record.sample_interval or (
        record.samples % needs.samples
    ):
        raise ArtifactError(
            f"{estimator.title} takes {needs.samples} samples every {needs.sample_interval * 1e6:g} µs, the windows "
            f"have {record.samples} every {record.sample_interval * 1e6:g} µs. Compare on windows that it can take."
        )
    channels = (record.synchronised if needs.grid_phase else record.channels)[needs.channels][run, window]
    v, i = (np.reshape(half, (-1, record.samples)) for half in np.split(channels, 2))
    if needs.channels == "phase_a":
        v, i = v[0], i[0]
    for first in range(0, record.samples, needs.samples):
        part = slice(first, first + needs.samples)
        yield Samples(
            v[..., part],
            i[..., part],
            float(record.omega[run]),
            record.theta[run, window, part],
            record.sent[run, window, part],
            int(record.limited[run, window]),
        )


def installation(converter: Converter, recipe: WindowRecipe, guess: Grid) -> Installation:
    """The installation of an estimator on a converter, with the windows of a sampled recipe and a first guess."""
    return Installation(
        T_s=converter.T_s,
        omega_n=converter.omega_n,
        V_base=rms_to_peak(converter.V_rated_rms),
        Z_base=converter.Z_base,
        samples=recipe.samples,
        sample_interval=recipe.sample_interval,
        cycles=recipe.cycles,
        guess=(guess.R_g, guess.L_g),
        grid_phase=True,
    )


_SHORT = {"field": "Field estimator", "field_network": "Field, with network"}
"""What the panels of a comparison have room for."""


def all_methods(
    converter: Converter, networks: dict[str, NetworkWeights], recipe: WindowRecipe, guess: Grid
) -> tuple[Method, ...]:
    """Every estimator that needs no training, then each network by name.

    Raises ArtifactError for weights with another number of samples in a window.
    """
    at = installation(converter, recipe, guess)
    packaged = replace(at, weights=read_field_weights())
    untrained = [
        Method(kind, packaged if kind.field_network else at, _SHORT.get(name))
        for name, kind in ESTIMATORS.items()
        if not kind.trained
    ]
    for weights in networks.values():
        if weights.window.samples != recipe.samples:
            raise ArtifactError(
                f"the weights take {weights.window.samples} samples, the windows have {recipe.samples}."
            )
    network = ESTIMATORS["neural"]
    return *untrained, *(Method(network, replace(at, weights=one), name) for name, one in networks.items())


def methods_of(
    study: Study, networks: dict[str, NetworkWeights], recipe: WindowRecipe, settings: ComparisonSettings
) -> tuple[Method, ...]:
    """The methods of a comparison on the windows of a sampled recipe, with the guess of its settings."""
    guess = Place(settings.guess_scr, 1.0, "reactance").grid(study.converter)
    return all_methods(study.converter, networks, recipe, guess)


def probe_name(method: Method) -> str:
    """The name of the runs with a method's probe; empty for a method without a probe."""
    return method.name if method.probes else ""
