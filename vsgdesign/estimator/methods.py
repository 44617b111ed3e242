"""The estimators of a comparison. Each gets the windows of a record as a controller would give them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vsgdesign.artifacts.field_weights import read_field_weights
from vsgdesign.artifacts.network_weights import NetworkWeights
from vsgdesign.errors import ArtifactError
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.estimator.record import Record
from vsgdesign.frames import rms_to_peak
from vsgdesign.identification import ESTIMATORS, Estimator, EstimatorKind, Installation, Samples
from vsgdesign.identification.interface import Array
from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.grid import Grid


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
