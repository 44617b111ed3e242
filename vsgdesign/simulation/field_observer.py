"""The numbers of a field estimator in a run: its lock-in moves with every sample of the compiled loop, the rest once a
cycle (:eq:`probe-in-the-loop`).

They lie in arrays, because a Python object for each of some hundred numbers would cost more than the estimator itself.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.flat import flat_block
from vsgdesign.codegen.llvm import Loop, LoopSpec, StandingLoop, compiled_loop
from vsgdesign.codegen.records import numbers_of, record_like, zero_record
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
)

Array = NDArray[np.float64]

_LOCK_IN = zero_record(LockIn)
_SIZE = len(numbers_of(_LOCK_IN))
_PLACES = record_like(_LOCK_IN, iter(np.arange(_SIZE, dtype=float).tolist()))
PLACE_OF_CLOSED, PLACE_OF_MUTED = int(_PLACES.closed), int(_PLACES.muted)
"""Where a lock-in's array says that a cycle has ended, and that the next sample sends nothing."""


def goes_on(lock: Array, as_in: Array) -> None:
    """A lock-in goes on with the numbers of another one. Whether nothing is sent after a limited sample stays its
    own."""
    muted = lock[PLACE_OF_MUTED]
    lock[:] = as_in
    lock[PLACE_OF_MUTED] = muted


def concluded(lock: LockIn, track: FieldTrack, settings: FieldSettings) -> Any:
    """A cycle ends and the next one begins. Returns (next_lock, next_track, answer, seen): the last are the features
    that a network behind the estimator is given."""
    locked, moved, said = conclude(lock, track, settings)
    return locked, moved, said, features(locked, moved, said, settings)


class FieldMemory:
    """The numbers of one estimator. ``omega`` is the converter's frequency, rad/s; without ``allowed`` it sends no
    probe."""

    def __init__(self, settings: FieldSettings, omega: float, V_rated_rms: float, *, allowed: bool) -> None:
        self.settings, self.V_rated_rms, self.allowed = settings, V_rated_rms, float(allowed)
        self.lock = np.array(numbers_of(first_lock_in(settings, omega)))
        """The lock-in. The loop of a run moves it in place."""
        track = np.array(numbers_of(first_track(settings)))
        self._rows = np.concatenate([self.lock, track])[None, :, None]
        self._constants = np.array(numbers_of(settings))
        self._log = np.empty((1, 1, len(FieldAnswer._fields) + len(FieldFeatures._fields), 1))
        self._conclude: StandingLoop | None = None

    def moves_in(self, place: Array) -> None:
        """The lock-in goes on in another array, that of a run."""
        place[:] = self.lock
        self.lock = place

    @property
    def closed(self) -> bool:
        """Whether a cycle has ended that is not concluded yet."""
        return bool(self.lock[PLACE_OF_CLOSED] != 0.0)

    @property
    def lock_in(self) -> LockIn:
        """The lock-in as a record."""
        return record_like(_LOCK_IN, iter(self.lock.tolist()))

    @property
    def seen(self) -> FieldFeatures:
        """The features of the cycle that was concluded last."""
        return FieldFeatures(*self._log[0, 0, len(FieldAnswer._fields) :, 0].tolist())

    def conclude(self) -> FieldAnswer:
        """Ends a cycle and begins the next one."""
        self._rows[0, :_SIZE, 0] = self.lock
        if self._conclude is None:
            self._conclude = _conclusion().standing(self._rows, self._constants, log=self._log, every=1)
        self._conclude(0, 1)
        self.lock[:] = self._rows[0, :_SIZE, 0]
        return FieldAnswer(*self._log[0, 0, : len(FieldAnswer._fields), 0].tolist())


@functools.cache
def conclusion_spec(lanes: int = 1, vectors: int = 1) -> LoopSpec:
    """A loop of one sample: the end of a cycle of so many estimators. Its rows are the numbers of the lock-in and of
    the track, and it logs those of the answer and of the features."""
    block = flat_block(concluded)
    state = [name for name in block.inputs if name.startswith(("lock.", "track."))]
    said = [name for name, _ in block.outputs if name.startswith(("answer.", "seen."))]
    return LoopSpec(
        bodies=(block,),
        state=tuple((name, f"next_{name}") for name in state),
        uniform=tuple(name for name in block.inputs if name.startswith("settings.")),
        logged=tuple(said),
        lanes=lanes,
        vectors=vectors,
        strict=True,
    )


@functools.cache
def conclusion_loop(lanes: int, vectors: int) -> Loop:
    """That loop, for estimators side by side."""
    return compiled_loop(conclusion_spec(lanes, vectors))


def _conclusion() -> Loop:
    # It runs once a cycle: what compiling quickly saves is worth the calls of twenty minutes.
    return compiled_loop(conclusion_spec(), quickly=True)
