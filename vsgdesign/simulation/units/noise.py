"""Sensors of a plant's units: each unit has errors of its own, and noise that is fed to the loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import numbers_of
from vsgdesign.linear.operating_point.clock_of_units import Clock
from vsgdesign.simulation.added_source import SensorsOfRun

Array = NDArray[np.float64]


def put_sensors(at: Callable[[str], Array], k: int, sensors: SensorsOfRun | None) -> None:
    """Puts the sensors of a unit into the rows of a run."""
    if sensors is not None:
        at(f"u{k}.sensors")[:] = numbers_of(sensors.constants)
        at(f"u{k}.before")[:] = sensors.before


def with_noise(
    more: Array | None, sensors: Sequence[SensorsOfRun | None], clock: Clock, begin: int, end: int
) -> Array | None:
    """What is fed over samples of the loop, (1, end − begin, n, 1), with the noise of all sensors behind it; None:
    nothing. Each unit draws for its own samples."""
    found, per = [] if more is None else [more], len(clock.instants)
    for k, own in enumerate(sensors):
        if own is None:
            continue
        at = [j for j, one in enumerate(clock.instants) if k in one.units]
        turn, place = divmod(begin, per)
        rows = np.flatnonzero(np.isin(np.arange(begin, end) % per, at))
        noise = own.noise(turn * len(at) + sum(one < place for one in at), len(rows))
        fed = np.zeros((1, end - begin, noise.shape[1], 1))
        fed[0, rows, :, 0] = noise
        found.append(fed)
    return np.concatenate(found, axis=2) if found else None
