"""The numbers of a field estimator in a run: its lock-in moves with every sample of the compiled loop, the rest once a
cycle (:eq:`probe-in-the-loop`); and the probe of any estimator, which a run injects between the stretches of the loop.

The numbers lie in arrays, because a Python object for each of some hundred would cost more than the estimator itself.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

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
from vsgdesign.equations.field.lock_in import probe_offset
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.identification import Probe

if TYPE_CHECKING:
    from vsgdesign.equations.controller import ControllerState
    from vsgdesign.equations.power_loops import References
    from vsgdesign.study.parameters.study import Study


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


class HeldProbe:
    """The probes of a run of so many samples, each value held for ``hold`` s. It remembers what it sent."""

    def __init__(self, hold: float, study: Study, samples: int) -> None:
        T_s = study.converter.T_s
        self._every = round(hold / T_s)
        if self._every < 1 or abs(hold / T_s - self._every) > 1e-6:
            raise InfeasibleStudyError(
                f"probe: hold = {hold:.6g} s is not a whole multiple of the controller's sampling period, "
                f"{T_s:.6g} s. Choose one that is, or another carrier frequency."
            )
        self._V_rated_rms, self._S_rated = study.converter.V_rated_rms, study.converter.S_rated
        self._sent = np.zeros(samples // self._every + 1, dtype=complex)
        self._asked: Probe | None = None
        self._probe, self._begin = Probe(np.zeros(1, dtype=complex), hold), 0

    def cuts(self, samples: int) -> set[int]:
        """Samples at which what is added may change."""
        return set(range(0, samples + 1, self._every))

    def ask(self, sample: int, probe: Probe | None) -> None:
        """What is to be sent from the next change on; None: nothing. The probe that is sent already goes on."""
        if probe is not self._asked:
            if probe is not None and (abs(probe.hold - self._probe.hold) > 1e-9 or len(probe.values) == 0):
                raise InfeasibleStudyError(
                    f"probe: {len(probe.values)} values of {probe.hold:.6g} s are asked for in a run that holds each "
                    f"for {self._probe.hold:.6g} s. Give at least one value, held as long as probe_hold says."
                )
            self._asked = probe
            self._probe = Probe(np.zeros(1, dtype=complex), self._probe.hold) if probe is None else probe
            self._begin = -(-sample // self._every)

    def value(self, sample: int) -> complex:
        """What is sent at a sample."""
        at, values = sample // self._every, self._probe.values
        if at >= self._begin:  # else what was sent before is held to the end
            self._sent[at] = values[(at - self._begin) % len(values)]
        return complex(self._sent[at])

    def sent_over(self, begin: int, end: int, step: int) -> NDArray[np.complex128]:
        """What was sent at every ``step``-th sample from ``begin`` up to before ``end``."""
        return self._sent[np.arange(begin, end, step) // self._every]

    def offset(self, sample: int, V_rms: float) -> tuple[float, float]:
        """What is added from a sample on to V (rms) and to θ (rad) (:eq:`probe`)."""
        value = self.value(sample)
        if self._probe.quantity != "voltage":
            return 0.0, 0.0
        added_V, added_theta = probe_offset(value.real, value.imag, V_rms, self._V_rated_rms)
        return float(added_V), float(added_theta)

    def references(self, sample: int, refs: References) -> References:
        """The references with what a probe of power adds from a sample on."""
        if self._probe.quantity != "power":
            return refs
        power = self.value(sample) * self._S_rated
        return refs._replace(P_ref=refs.P_ref + power.real, Q_ref=refs.Q_ref + power.imag)


def add_offset(state: ControllerState, V_rms: float, theta: float) -> ControllerState:
    """The state with V and θ moved."""
    return state._replace(V=state.V + V_rms, theta=state.theta + theta)
