"""The field estimator as an observer of the compiled loop: its probe and its lock-in in every sample
(:eq:`probe-in-the-loop`).

Its numbers lie in arrays between two calls, because a Python object for each of some hundred numbers would cost more
than the estimator itself.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.field import (
    FieldAnswer,
    FieldFeatures,
    FieldSettings,
    FieldTrack,
    LockIn,
    conclude,
    features,
    first_lock_in,
    first_track,
    listen,
    probe_value,
)
from vsgdesign.equations.probe import probe_offset
from vsgdesign.frames import rotate
from vsgdesign.simulation.compiling import compile_function, source_stamp
from vsgdesign.simulation.observing import ObserverLaw, Sent, Watch, flat, pack, unpack, zero_record

Array = NDArray[np.float64]


class FieldConstants(NamedTuple):
    """Constants of the observer."""

    settings: FieldSettings
    V_rated_rms: Any
    """Rated phase voltage, rms V."""
    allowed: Any
    """1 to send the probe, 0 to send none."""


_LOCK_IN, _TRACK, _CONSTANTS = (zero_record(kind) for kind in (LockIn, FieldTrack, FieldConstants))

_PLACE_OF_CLOSED = int(unpack(np.arange(len(flat(_LOCK_IN)), dtype=float), _LOCK_IN).closed)


def _begin(watch: Watch) -> Any:
    return unpack(watch.memory, _LOCK_IN), unpack(watch.constants, _CONSTANTS)


def _probe(lock: LockIn, V: Any, constants: FieldConstants) -> Sent:
    u_d, u_q = probe_value(lock, constants.allowed, constants.settings)
    added_V, added_theta = probe_offset(u_d, u_q, V, constants.V_rated_rms)
    return Sent(V=added_V, theta=added_theta, d=u_d, q=u_q)


def _listen(lock: LockIn, measured: Any, theta: Any, sent: Sent, limited: Any, constants: FieldConstants) -> LockIn:
    # The controller's own sine and cosine: the compiler finds that they are the same.
    sent_alpha, sent_beta = rotate(sent.d, sent.q, np.cos(theta), np.sin(theta))
    return listen(
        lock,
        measured.v_alpha,
        measured.v_beta,
        measured.i_g_alpha,
        measured.i_g_beta,
        sent_alpha,
        sent_beta,
        limited,
        constants.settings,
    )


def _closed(lock: LockIn) -> Any:
    return lock.closed


def _keep(watch: Watch, lock: LockIn) -> None:
    pack(watch.memory, lock)


FIELD_OBSERVER = ObserverLaw(_begin, _probe, _listen, _closed, _keep)
"""The law of a run with a field estimator."""


class FieldMemory(NamedTuple):
    """The numbers of one estimator."""

    watch: Watch
    """Of the loop: the lock-in and the constants."""
    track: Array
    """What changes once per cycle."""
    answer: Array
    """The answer of the last cycle."""
    features: Array
    """What a network behind the estimator is given in this cycle."""

    @property
    def closed(self) -> bool:
        """Whether a cycle has ended that is not concluded yet."""
        return self.watch.memory[_PLACE_OF_CLOSED] != 0.0

    @property
    def lock_in(self) -> LockIn:
        """The lock-in as a record."""
        return unpack(self.watch.memory, _LOCK_IN)

    @property
    def seen(self) -> FieldFeatures:
        """The features of the cycle that was concluded last."""
        return FieldFeatures(*self.features.tolist())

    def conclude(self) -> FieldAnswer:
        """Ends a cycle and begins the next one."""
        _conclusion()(self.watch.memory, self.track, self.watch.constants, self.answer, self.features)
        return FieldAnswer(*self.answer.tolist())


def first_memory(settings: FieldSettings, omega: float, V_rated_rms: float, *, allowed: bool) -> FieldMemory:
    """The numbers of an estimator that knows nothing yet. ``omega`` is the converter's frequency, rad/s."""
    constants = FieldConstants(settings, V_rated_rms, float(allowed))
    lock, track = first_lock_in(settings, omega), first_track(settings)
    memory, kept, given = (np.array(flat(record)) for record in (lock, track, constants))
    answer, seen = np.zeros(len(FieldAnswer._fields)), np.zeros(len(FieldFeatures._fields))
    return FieldMemory(Watch(memory, given), kept, answer, seen)


@functools.cache
def _conclusion() -> Callable[..., None]:
    stamp = source_stamp()

    def concluding(memory: Array, track: Array, constants: Array, answer: Array, seen: Array) -> None:
        if stamp >= 0:  # always: it only makes the stamp part of the cache key
            settings = unpack(constants, _CONSTANTS).settings
            lock, moved, said = conclude(unpack(memory, _LOCK_IN), unpack(track, _TRACK), settings)
            pack(memory, lock)
            pack(track, moved)
            pack(answer, said)
            pack(seen, features(lock, moved, said, settings))

    return compile_function(concluding, outermost=True, cache=True)
