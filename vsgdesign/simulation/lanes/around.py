"""What is around the cases of a batch besides their events: a distorted or recorded source, and sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.simulation.timeline import START_PHASE, Waves
from vsgdesign.simulation.twin import restless
from vsgdesign.study.parameters.background import BackgroundSpec
from vsgdesign.study.parameters.replay import ReplaySpec
from vsgdesign.study.parameters.sensors import SensorSpec
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
_Spec = TypeVar("_Spec")


@dataclass(frozen=True)
class Around:
    """Backgrounds and sensors of N cases, (N,); None where there are none. Voltages and frequencies of a case are those
    of its source: its background changes neither (:func:`neutral`)."""

    backgrounds: tuple[BackgroundSpec, ...] | None = None
    sensors: tuple[SensorSpec, ...] | None = None
    replay: ReplaySpec | None = None
    """The recorded voltage that is the source of all cases; None: there is none."""

    @classmethod
    def drawn(cls, study: Study, seeds: Sequence[int]) -> Around:
        """Out of the ranges of a study, one draw for each seed. The factor of the voltage and the offset of the
        frequency are still in the backgrounds."""
        background, sensors = study.background, study.sensors
        return cls(
            None if background is None else tuple(background.redrawn(seed) for seed in seeds),
            None if sensors is None else tuple(sensors.redrawn(seed) for seed in seeds),
        )

    @classmethod
    def of(cls, study: Study, count: int) -> Around:
        """Those of a study, the same for so many cases."""
        return cls(_repeated(study.background, count), _repeated(study.sensors, count), study.replay)

    @property
    def moves(self) -> bool:
        """Whether any source does more than turn with what is constant in it."""
        return self.replay is not None or any(one.restless for one in self.backgrounds or ())

    def distort(self, study: Study) -> bool:
        """Whether powers ripple at rest because a source has more than its fundamental."""
        return self.moves or bool(study.grid_source.components) or any(one.distorts for one in self.backgrounds or ())

    def restless(self, count: int) -> NDArray[np.bool_]:
        """Whether the powers of each of N = ``count`` cases never rest (:func:`vsgdesign.simulation.twin.restless`)."""
        sensors, backgrounds = self.sensors or (None,) * count, self.backgrounds or (None,) * count
        return np.array([restless(*one, self.replay) for one in zip(sensors, backgrounds, strict=True)], dtype=bool)

    @property
    def act(self) -> bool:
        """Whether any sensor changes anything."""
        return any(one.act for one in self.sensors or ())

    @property
    def phase(self) -> Array | float:
        """Of the sources at the start, rad."""
        if self.replay is not None:
            return self.replay.phase
        own = 0.0 if self.backgrounds is None else np.array([one.phase for one in self.backgrounds])
        return START_PHASE + own

    def sources(self, V_g_rms: Array, omega_g: Array) -> tuple[Array, Array]:
        """Voltages and frequencies of the sources as the backgrounds make them, or those with which a record begins."""
        if self.replay is not None:
            return np.full_like(V_g_rms, self.replay.V_g_rms), np.full_like(omega_g, self.replay.omega_g)
        if self.backgrounds is None:
            return V_g_rms, omega_g
        factor, offset = np.array([(one.voltage_factor, one.frequency_offset) for one in self.backgrounds]).T
        return factor * V_g_rms, omega_g + 2.0 * np.pi * offset

    @property
    def neutral(self) -> Around:
        """With backgrounds that change neither voltage nor frequency: those of the cases have what they changed."""
        backgrounds = (replace(one, voltage_factor=1.0, frequency_offset=0.0) for one in self.backgrounds or ())
        return replace(self, backgrounds=None if self.backgrounds is None else tuple(backgrounds))

    def waves(self, study: Study, count: int) -> Waves | None:
        """The components of the sources of ``count`` cases, those of the study's source among them; None: none."""
        V_base_pk = rms_to_peak(study.converter.V_rated_rms)
        own = [one.components for one in self.backgrounds] if self.backgrounds is not None else [()] * count
        listed = [(*study.grid_source.components, *components) for components in own]
        most = max((len(components) for components in listed), default=0)
        if most == 0:
            return None
        values = np.zeros((3, count, most))
        for k, components in enumerate(listed):
            for w, one in enumerate(components):
                values[:, k, w] = one.order, V_base_pk * one.amplitude_pu, one.phase
        return Waves(*values)

    def take(self, chosen: NDArray[Any]) -> Around:
        """Those of some cases, by index or by mask."""
        index = (np.flatnonzero(chosen) if chosen.dtype == bool else chosen).tolist()
        return Around(_chosen(self.backgrounds, index), _chosen(self.sensors, index), self.replay)


def _repeated(one: _Spec | None, count: int) -> tuple[_Spec, ...] | None:
    return None if one is None else (one,) * count


def _chosen(of: tuple[_Spec, ...] | None, index: list[int]) -> tuple[_Spec, ...] | None:
    return None if of is None else tuple(of[k] for k in index)


NOTHING = Around()
"""A clean source and ideal sensors."""
