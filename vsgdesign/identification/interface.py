"""What every estimator of the grid's impedance is given, what it answers, and what it says of itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

STATUSES = {
    "ok": "an estimate",
    "not finite": "a sample is not a number: no estimate; keep the one before",
    "saturated": "a sample is at or beyond the sensor's limit: no estimate; keep the one before",
    "outside": "an estimate, but beyond what the network was trained on: clipped to the trained range",
    "limited": "the converter limited its current within the window: no estimate; keep the one before",
    "waiting": "too few samples so far: no estimate yet",
    "uncertain": "an estimate whose standard deviation is too large to follow; keep the one before",
    "implausible": "R_g or L_g is negative, as no grid's is: an estimate to count, not to follow",
    "held": "nothing new was seen: the estimate before, again",
}
"""What an estimate's status says."""

FOLLOWED = ("ok", "outside")
"""Statuses of an estimate that a schedule may follow. With any other status the gains go on as they are."""

CHANNELS = {"phase_a": 1, "alpha_beta": 2, "dq": 2}
"""How voltage and current can be sampled, and in how many components: phase A alone, α and β, or d and q of the
converter's own angle."""


class Estimate(NamedTuple):
    """R_g in Ω and L_g in H, NaN where there is no estimate, and whether to believe them (a key of ``STATUSES``)."""

    R_g: float
    L_g: float
    status: str
    covariance: Array | None = None
    """(2, 2) of (R_g, L_g): Ω², Ω·H, H². None: not known."""
    reason: str = ""
    """More than the status says, in words, where there is more."""

    @property
    def why(self) -> str:
        """The reason, or what the status says."""
        return self.reason or STATUSES.get(self.status, self.status)


_NOTHING = float("nan")


def no_estimate(status: str, reason: str = "") -> Estimate:
    """An answer without an estimate."""
    return Estimate(_NOTHING, _NOTHING, status, None, reason)


class Samples(NamedTuple):
    """What a converter has measured since the last update: n samples, SI, peak."""

    v: Array
    """Voltage at the PCC, V: (n,) for phase A, (2, n) for αβ and dq."""
    i: Array
    """Current into the grid, A; same shape."""
    omega: float
    """The converter's own frequency at the last sample, rad/s."""
    theta: Array
    """(n,): the converter's own angle, rad: its d axis against α. With what a voltage probe adds to it."""
    sent: ComplexArray
    """(n,): the probe as it was sent, not as it was wanted; zeros where there was none. Unit as in :class:`Probe`."""
    limited: int = 0
    """Of these samples, in how many the converter limited its current."""


@dataclass(frozen=True, eq=False)
class Probe:
    """A disturbance that makes the grid visible (:eq:`probe`).

    ``values`` (K,), complex, are sent one after another, each held for ``hold`` s, a whole multiple of the controller's
    sampling period, and over again. They begin when the probe is first asked for; the same object asked for again goes
    on where it is, another one begins anew.

    ``quantity`` ``voltage``: d and q in the converter's frame, relative to the rated voltage, added to the reference of
    the inner voltage loop. The power loops see its answer in P and Q, and the Q loop's droop sees the added magnitude.
    ``quantity`` ``power``: P + jQ relative to the rating, added to the references of the power loops.
    """

    values: ComplexArray
    hold: float
    quantity: str = "voltage"


@dataclass(frozen=True)
class Needs:
    """What an estimator asks for."""

    samples: int
    """Samples of an update: those of a window, or 1 to be fed sample by sample."""
    sample_interval: float
    """s, a whole multiple of the controller's sampling period."""
    channels: str = "alpha_beta"
    """One of ``CHANNELS``."""
    grid_phase: bool = False
    """Whether windows must begin at the phase of the grid's own voltage that it was trained with. No converter in the
    field has that signal: the simulator lends it, and says so."""
    probe_hold: float | None = None
    """For how long each value of its probes is held, s. None: it asks for no probe."""


@dataclass(frozen=True, kw_only=True)
class Installation:
    """The converter and the sensors that an estimator is built for, SI."""

    T_s: float
    """Sampling period of the controller, s."""
    omega_n: float
    """Nominal angular frequency, rad/s."""
    V_base: float
    """Rated phase voltage, V peak."""
    Z_base: float
    """Base impedance, Ω."""
    samples: int
    """Samples of a window, which is ``cycles`` nominal cycles long or as near to it as the control period allows."""
    sample_interval: float
    """s."""
    cycles: int = 1
    guess: tuple[float, float] = (0.0, 0.0)
    """R_g (Ω) and L_g (H) to begin with."""
    noise: tuple[float, float] = (0.0, 0.0)
    """Standard deviation of one sample of one phase's sensor, V and A; zeros: not known."""
    v_limit: float = float("inf")
    """Where the voltage sensors saturate, V."""
    i_limit: float = float("inf")
    """Where the current sensors saturate, A."""
    weights: Any = None
    """Trained weights (artifacts.network_weights.NetworkWeights) for an estimator that needs them."""
    grid_phase: bool = False
    """Whether windows will begin at the grid phase that an estimator was trained with."""

    @property
    def window(self) -> float:
        """Length of a window, s."""
        return self.samples * self.sample_interval

    @property
    def nominal_hz(self) -> float:
        """The frequency whose whole cycles a window holds, Hz: the grid's own where a window is exactly that."""
        return self.cycles / self.window


class Estimator(Protocol):
    """One way to measure the grid, built for an installation.

    It is frozen: what it remembers is its state, a NamedTuple that goes in and out, to copy, save and compare.
    """

    @property
    def title(self) -> str:
        """As figures and tables call it."""
        ...

    @property
    def signals(self) -> str:
        """What it lives on: a key of ``SIGNAL_SETS``."""
        ...

    @property
    def needs(self) -> Needs:
        """What it asks for."""
        ...

    def first(self) -> Any:
        """The state before anything has been measured."""
        ...

    def update(self, state: Any, samples: Samples) -> tuple[Any, Estimate | None]:
        """The state after some samples and the estimate; None where no answer is due at these samples.

        No exception is ever raised for what the samples are.
        """
        ...

    def probe(self, state: Any) -> Probe | None:
        """The probe that it wants to be sent from now on; None: none."""
        ...


@runtime_checkable
class ProbeLines(Protocol):
    """An estimator that reads lines beside the fundamental, of which the bound of its error can be computed."""

    def lines(self, i: ComplexArray, interval: float) -> tuple[ComplexArray, Array, int]:
        """Of the current (n,) in the rotating frame (A), sampled every ``interval`` s: phasors (M,), their angular
        frequencies in that frame (M,), rad/s, and over how many of the last samples they are taken."""
        ...


SIGNAL_SETS = {
    "none": "nothing measured",
    "steady": "one steady window, grid phase and X/R known",
    "two_windows": "two windows about a power step",
    "windows": "all windows about a power step",
    "injection": "one line beside the fundamental, over two windows",
    "pseudo_random": "one period of the binary sequence",
    "other": "signals of its own: no bound is known",
}
"""Signals that an estimator can live on, in words. A bound of its error belongs to each but the first and the last."""


@dataclass(frozen=True)
class EstimatorKind:
    """An estimator that can be asked for by name."""

    title: str
    """What it is, in words that go on after "the estimate of": ``"the extended Kalman filter"``."""
    build: Callable[[Installation], Estimator]
    """Raises ArtifactError where it cannot be built for an installation, with all that does not fit."""
    trained: bool = False
    """Whether it needs trained weights."""
    in_c: bool = False
    """Whether there is C for it."""


class NoMemory(NamedTuple):
    """State of an estimator that remembers nothing."""


@dataclass(frozen=True)
class SpoiltBy:
    """What makes samples useless: the sensors' limits in V and A."""

    v_limit: float = field(default=float("inf"))
    i_limit: float = field(default=float("inf"))

    def status(self, samples: Samples) -> str | None:
        """The status of samples that cannot be used; None where they can.

        A limited current is the answer to a disturbance of the grid, which a passive method would take for the grid's
        impedance, and a probe does not get through as it was wanted.
        """
        if samples.limited > 0:
            return "limited"
        v_peak, i_peak = (float(np.max(np.abs(x), initial=0.0)) for x in (samples.v, samples.i))
        if not (np.isfinite(v_peak + i_peak) and np.isfinite(samples.omega)):
            return "not finite"
        return None if v_peak < self.v_limit and i_peak < self.i_limit else "saturated"


def with_belief(R_g: float, L_g: float, covariance: Array | None, omega: float, believed: float) -> Estimate:
    """An estimate that is followed where the standard deviation of Z at ω (rad/s) is less than ``believed`` of |Z|, or
    where its covariance is not known; and where it is a grid: R_g at least −10 % of |Z|, for what error does to a grid
    without resistance, and L_g positive."""
    if not np.isfinite(R_g + L_g):
        return no_estimate("not finite", "the method's equations have no solution here: keep the estimate before")
    size = float(np.hypot(R_g, omega * L_g))
    status = "ok" if L_g > 0.0 and R_g > -0.1 * size else "implausible"
    if covariance is not None and status == "ok":
        spread = float(covariance[0, 0] + omega**2 * covariance[1, 1])
        status = "ok" if spread < (believed * size) ** 2 else "uncertain"
    return Estimate(float(R_g), float(L_g), status, covariance)
