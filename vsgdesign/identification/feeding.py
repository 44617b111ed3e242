"""An estimator together with its state, and the sampling of what it is fed with.

It takes windows or single samples, as on a controller, in whole control periods and whole cycles of the grid. Its state
is saved as a JSON document with every number the same to the last bit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import ArtifactError
from vsgdesign.identification.interface import CHANNELS, Array, Estimate, Estimator, Probe, Samples

_NAN = float("nan")


class FeedState(NamedTuple):
    """The state between two samples."""

    memory: Any
    """The estimator's own state."""
    filled: int
    """Number of samples of the present window so far."""
    limited: int
    """Number of these samples in which the converter limited its current."""
    omega: float
    """Frequency of the converter at the last of these samples, rad/s."""
    window: Array
    """Samples (2, C, filled): voltage and current, C components, filled samples."""
    theta: Array
    """Angle of the converter at these samples (filled,), rad."""
    sent: NDArray[np.complex128]
    """(filled,)."""


class FedEstimator:
    """An estimator with its state, for one converter. Two threads must not share it."""

    def __init__(self, estimator: Estimator) -> None:
        self.estimator = estimator
        self._memory = estimator.first()
        needs = estimator.needs
        self.samples, self._components = needs.samples, CHANNELS[needs.channels]
        self._window = np.zeros((2, self._components * self.samples))
        self._theta = np.full(self.samples, _NAN)
        self._sent: NDArray[np.complex128] = np.zeros(self.samples, dtype=complex)
        self._omega, self._limited, self._filled = _NAN, 0, 0
        self._due: Estimate | None = None
        self._no_theta = np.full(self.samples, _NAN)
        self._no_probe: NDArray[np.complex128] = np.zeros(self.samples, dtype=complex)

    @property
    def probe(self) -> Probe | None:
        """The probe that the converter is to inject from now on."""
        return self.estimator.probe(self._memory)

    def window(
        self,
        v: Array,
        i: Array,
        omega: float = _NAN,
        theta: Array | None = None,
        sent: NDArray[np.complex128] | None = None,
        limited: int = 0,
    ) -> Estimate | None:
        """The estimate after one window with as many samples as the estimator takes; None if no answer is due.

        The arguments are those of :class:`vsgdesign.identification.interface.Samples`. Signals that are not measured
        are left out. Raises ArtifactError for another number of samples.
        """
        half = self._components * self.samples
        if v.size != half or i.size != half or v.shape != i.shape:
            raise ArtifactError(
                f"window: v has shape {v.shape}, i {i.shape}; {self.estimator.title} takes {self._components} × "
                f"{self.samples} samples of each."
            )
        samples = Samples(
            v,
            i,
            omega,
            self._no_theta if theta is None else theta,
            self._no_probe if sent is None else sent,
            limited,
        )
        self._memory, found = self.estimator.update(self._memory, samples)
        return found

    def push(
        self, v: Any, i: Any, omega: float = _NAN, theta: float = _NAN, sent: complex = 0j, limited: bool = False
    ) -> bool:
        """Takes one sample of v and i, or its components. Returns whether an answer is due.

        When a window is complete, further samples are ignored until :meth:`answer` is called. An estimator that takes
        single samples ignores none.
        """
        k, n = self._filled, self.samples
        if k < n:
            self._window[0, k::n] = v
            self._window[1, k::n] = i
            self._theta[k], self._sent[k] = theta, sent
            self._omega = omega
            self._limited += bool(limited)
            self._filled = k + 1
        if n == 1:
            self._due = self._taken() or self._due
            return self._due is not None
        return self._filled == n

    def answer(self) -> Estimate | None:
        """The estimate that is due; None if there is none."""
        if self.samples == 1:
            found, self._due = self._due, None
            return found
        return self._taken() if self._filled == self.samples else None

    def _taken(self) -> Estimate | None:
        found = self.window(self._window[0], self._window[1], self._omega, self._theta, self._sent, self._limited)
        self._filled = self._limited = 0
        return found

    def state(self) -> FeedState:
        """The whole state, except an answer that is due and was not yet taken."""
        kept = self._filled
        window = self._window.reshape(2, self._components, -1)[:, :, :kept].copy()
        theta, sent = self._theta[:kept].copy(), self._sent[:kept].copy()
        return FeedState(self._memory, kept, self._limited, self._omega, window, theta, sent)

    def document(self) -> dict[str, Any]:
        """The :meth:`state` in JSON's types."""
        return memory_document(self.state())

    def restore(self, document: Any) -> None:
        """Continues from a :meth:`document` with the same bits. Raises ArtifactError if it is not of this estimator."""
        state: FeedState = memory_of(document, FedEstimator(self.estimator).state(), "state.estimator")
        kept = state.filled
        whole = 0 <= kept <= self.samples and state.window.shape == (2, self._components, kept)
        if not whole or not state.theta.shape == state.sent.shape == (kept,):
            raise ArtifactError("state.estimator.window: it is not a window of this estimator; start afresh.")
        self._memory, self._filled = state.memory, kept
        self._limited, self._omega = state.limited, state.omega
        self._window.reshape(2, self._components, -1)[:, :, :kept] = state.window
        self._theta[:kept], self._sent[:kept] = state.theta, state.sent
        self._due = None


def memory_document(state: Any) -> Any:
    """A state (a NamedTuple of numbers, arrays and other states) in JSON's types; NaN is None."""
    if hasattr(state, "_asdict"):
        return {name: memory_document(value) for name, value in state._asdict().items()}
    if isinstance(state, np.ndarray):
        parts = state.view(float) if np.iscomplexobj(state) else state
        return {"shape": list(state.shape), "values": [memory_document(float(value)) for value in parts.ravel()]}
    if isinstance(state, complex):
        return [memory_document(state.real), memory_document(state.imag)]
    if isinstance(state, int) and not isinstance(state, bool):
        return state
    return float(state) if math.isfinite(state) else None


def memory_of(document: Any, like: Any, where: str = "state.memory") -> Any:
    """The state of a document. ``like`` is any state of the same estimator, of which it takes the types.

    Raises ArtifactError if the document is not such a state.
    """
    try:
        return _read(document, like, where)
    except (TypeError, ValueError, KeyError) as error:
        raise ArtifactError(f"{where}: it is not a state of this estimator; start afresh.") from error


def _read(document: Any, like: Any, where: str) -> Any:
    if hasattr(like, "_asdict"):
        if not isinstance(document, dict) or document.keys() != set(like._fields):
            raise ArtifactError(f"{where}: must have the fields {', '.join(like._fields)}; start afresh.")
        return type(like)(*(_read(document[name], getattr(like, name), f"{where}.{name}") for name in like._fields))
    if isinstance(like, np.ndarray):
        shape, values = document["shape"], np.array([_number(value) for value in document["values"]], dtype=float)
        if len(shape) != like.ndim:
            raise ArtifactError(f"{where}: must have {like.ndim} dimensions; start afresh.")
        return (values.view(complex) if np.iscomplexobj(like) else values).reshape(shape)
    if isinstance(like, complex):
        real, imag = document
        return complex(_number(real), _number(imag))
    if isinstance(like, int):
        if isinstance(document, bool) or not isinstance(document, int):
            raise ArtifactError(f"{where}: must be a whole number; start afresh.")
        return document
    return _number(document)


def _number(value: Any) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is not a number")
    return float(value)


INTERVAL = 200e-6
"""The published sample interval, s. An interval that is not given is as close to it as the converter allows."""

MOST_CYCLES = 6
"""Nominal cycles of the longest window that is chosen. A schedule that waits longer than 0.1 s is no longer online."""

LEAST_PER_CYCLE = 8
"""Least number of control periods in a cycle with which a window can be taken."""

PER_CYCLE = (40, 200)
"""Number of samples of a cycle in a chosen window, if the control period allows it."""

EXACT = 1e-6
"""Largest deviation, in cycles, of a window that counts as whole cycles. It allows for rounding of f_n and T_s."""

NEAR = 5e-3
"""Largest deviation from whole cycles, in cycles, of a chosen window where no window of whole cycles exists.

The angle of a synchronised window is corrected by this deviation."""


class WindowPlan(NamedTuple):
    """The sampling of a window."""

    steps: int
    """Number of control periods between two samples."""
    samples: int
    cycles: int
    missed: float
    """Deviation from a whole number of cycles, in cycles."""


def choose_window(
    rate: float, per_cycle: float, *, steps: int = 0, samples: int = 0, cycles: int = 0
) -> WindowPlan | None:
    """The window of a converter that samples ``rate`` times a second, ``per_cycle`` times in a nominal cycle.

    Values that are left open (0) are chosen here. The window is the least number of nominal cycles, up to
    ``MOST_CYCLES``, that is a whole number of sample intervals. Among these the interval is the one closest to
    ``INTERVAL``. If the control period divides no such number of cycles, the window is the shortest that differs from
    whole cycles by at most ``NEAR``. The result is None if no window has four samples.
    """
    found = []
    for whole in _cycles(per_cycle, steps, samples, cycles):
        for step in [steps] if steps else _steps(per_cycle, samples, whole):
            count = samples or round(whole * per_cycle / step)
            missed = abs(count * step - whole * per_cycle) / per_cycle
            off = abs(math.log(step / rate / INTERVAL))
            rank = (0, whole, off) if missed < EXACT else (1, whole, off) if missed < NEAR else (2, missed, whole)
            if count >= 4:
                found.append((rank, step, count, whole, missed))
    return WindowPlan(*min(found)[1:]) if found else None


def window_of_rate(rate: float, omega_n: float) -> WindowPlan:
    """The window that is chosen for a converter that samples ``rate`` times a second at the nominal frequency (rad/s).

    Raises ArtifactError if a cycle has too few control periods.
    """
    per_cycle = rate * 2.0 * math.pi / omega_n
    found = choose_window(rate, per_cycle) if per_cycle >= LEAST_PER_CYCLE else None
    if found is None:
        raise ArtifactError(
            f"{per_cycle:.3g} control periods in a cycle of the grid are too few to estimate it (least: "
            f"{LEAST_PER_CYCLE}). Raise f_sw or samples_per_carrier."
        )
    return found


def _cycles(per_cycle: float, steps: int, samples: int, cycles: int) -> list[int]:
    if cycles:
        return [cycles]
    if samples and steps:
        return [max(round(samples * steps / per_cycle), 1)]
    return list(range(1, MOST_CYCLES + 1))


def _steps(per_cycle: float, samples: int, cycles: int) -> list[int]:
    """The numbers of control periods that a sample interval may have."""
    if samples:
        return [max(round(cycles * per_cycle / samples), 1)]
    least, most = (per_cycle / count for count in reversed(PER_CYCLE))
    return list(range(max(math.ceil(least), 1), max(math.floor(most), 1) + 1))


def near_a_millisecond(periods: int, T_s: float) -> float:
    """The time in s closest to 1 ms that is a whole number of control periods and divides ``periods`` of them
    evenly."""
    divisors = [k for k in range(1, periods + 1) if periods % k == 0]
    return min(divisors, key=lambda k: abs(math.log(k * T_s / 1e-3))) * T_s
