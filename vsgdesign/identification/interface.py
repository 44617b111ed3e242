"""The interface of all estimators of the grid's impedance: their inputs, their answers and their descriptions; and the
estimators by the names that a study or a comparison can select."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import Fault, StudyError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

STATUSES = {
    "ok": "an estimate",
    "not finite": "a sample is not a number: no estimate; keep the one before",
    "saturated": "a sample is at or beyond the sensor's limit: no estimate; keep the one before",
    "outside": "the estimate is beyond the range of the network's training: clipped to this range",
    "limited": "the converter limited its current within the window: no estimate; keep the one before",
    "waiting": "too few samples so far: no estimate yet",
    "uncertain": "the standard deviation of the estimate is too large to follow it; keep the one before",
    "implausible": "R_g or L_g is negative, so this is not a grid: the estimate is counted but not followed",
    "held": "the samples contain nothing new: the estimate before is repeated",
}
"""The meaning of each status of an estimate."""

FOLLOWED = ("ok", "outside")
"""Statuses of an estimate that a schedule may follow. With any other status the gains do not change."""

CHANNELS = {"phase_a": 1, "alpha_beta": 2, "dq": 2}
"""Ways to sample voltage and current, with their number of components: phase A alone, α and β, or d and q with the
converter's own angle."""


class Estimate(NamedTuple):
    """R_g in Ω and L_g in H, or NaN if there is no estimate, with a status (a key of ``STATUSES``)."""

    R_g: float
    L_g: float
    status: str
    covariance: Array | None = None
    """Covariance (2, 2) of (R_g, L_g) in Ω², Ω·H and H². None if it is not known."""
    reason: str = ""
    """A more precise reason than that of the status, in words, if there is one."""
    changed: bool = False
    """Whether the estimator decided, with this answer, that the impedance of the grid has changed."""
    surprised: bool = False
    """Whether something happened that the estimator cannot explain yet: its answers are held until it can."""

    @property
    def why(self) -> str:
        """The reason if there is one, otherwise the meaning of the status."""
        return self.reason or STATUSES.get(self.status, self.status)


_NOTHING = float("nan")


def no_estimate(status: str, reason: str = "") -> Estimate:
    """An answer without an estimate."""
    return Estimate(_NOTHING, _NOTHING, status, None, reason)


class Samples(NamedTuple):
    """The n samples that a converter has measured since the last update, in SI units and peak values."""

    v: Array
    """Voltage at the PCC, V: (n,) for phase A, (2, n) for αβ and dq."""
    i: Array
    """Current into the grid, A, in the same shape."""
    omega: float
    """The converter's own frequency at the last sample, rad/s."""
    theta: Array
    """Angle (n,) of the converter's own d axis against α, rad. It includes the part that a voltage probe adds."""
    sent: ComplexArray
    """The probe (n,) as it was injected, which may differ from the one asked for. It is zero without a probe.

    The unit is that of :class:`Probe`.
    """
    limited: int = 0
    """Number of these samples in which the converter limited its current."""


@dataclass(frozen=True, eq=False)
class Probe:
    """A small disturbance from whose response the impedance of the grid is measured (:eq:`probe`).

    The complex ``values`` (K,) are injected one after another and then repeated. Each is held for ``hold`` s, a whole
    multiple of the controller's sampling period. The sequence begins when the estimator first asks for the probe. If it
    asks for the same object again, the sequence continues; another object begins from its first value.

    With ``quantity`` ``voltage``, a value is d + jq in the converter's frame, relative to the rated voltage. It is
    added to the reference of the inner voltage loop. The power loops see the response in P and Q, and the droop of the
    Q loop sees the added magnitude. With ``quantity`` ``power``, a value is P + jQ relative to the rating. It is added
    to the references of the power loops.
    """

    values: ComplexArray
    hold: float
    quantity: str = "voltage"


@dataclass(frozen=True)
class Needs:
    """The data that an estimator needs."""

    samples: int
    """Number of samples of an update: those of a window, or 1 for an estimator that takes single samples."""
    sample_interval: float
    """Time between two samples, s: a whole multiple of the controller's sampling period."""
    channels: str = "alpha_beta"
    """One of ``CHANNELS``."""
    grid_phase: bool = False
    """Whether windows must begin at the phase of the grid's own voltage that was used in its training. No converter in
    the field has this signal. The simulator provides it, and the report says so."""
    probe_hold: float | None = None
    """Time for which each value of its probes is held, s. None if it never asks for a probe."""


@dataclass(frozen=True, kw_only=True)
class Installation:
    """The converter and the sensors for which an estimator is built, in SI units."""

    T_s: float
    """Sampling period of the controller, s."""
    omega_n: float
    """Nominal angular frequency, rad/s."""
    V_base: float
    """Rated phase voltage, V peak."""
    Z_base: float
    """Base impedance, Ω."""
    samples: int
    """Samples of a window, which is ``cycles`` nominal cycles long, or as close to it as the control period allows."""
    sample_interval: float
    """s."""
    cycles: int = 1
    guess: tuple[float, float] = (0.0, 0.0)
    """First guess of R_g (Ω) and L_g (H)."""
    noise: tuple[float, float] = (0.0, 0.0)
    """Standard deviation of one sample of the sensor of one phase, V and A. Zeros mean that it is not known."""
    v_limit: float = float("inf")
    """Voltage at which the voltage sensors saturate, V."""
    i_limit: float = float("inf")
    """Current at which the current sensors saturate, A."""
    weights: Any = None
    """Trained weights (artifacts.network_weights.NetworkWeights) for an estimator that needs them."""
    grid_phase: bool = False
    """Whether windows will begin at the grid phase with which the estimator was trained."""

    @property
    def window(self) -> float:
        """Length of a window, s."""
        return self.samples * self.sample_interval

    @property
    def nominal_hz(self) -> float:
        """The frequency of which a window holds whole cycles, Hz.

        It is the nominal one if a window is exactly that long.
        """
        return self.cycles / self.window


class Estimator(Protocol):
    """A method that measures the grid, built for an installation.

    The object is frozen. Its state is a separate NamedTuple that is passed in and returned, so that it can be copied,
    saved and compared.
    """

    @property
    def title(self) -> str:
        """The name of the method in figures and tables."""
        ...

    @property
    def signals(self) -> str:
        """The signals from which it works: a key of ``SIGNAL_SETS``."""
        ...

    @property
    def needs(self) -> Needs:
        """The data that it needs."""
        ...

    def first(self) -> Any:
        """The state before anything has been measured."""
        ...

    def update(self, state: Any, samples: Samples) -> tuple[Any, Estimate | None]:
        """The state after some samples, and the estimate, which is None if no answer is due at these samples.

        The values of the samples never raise an exception.
        """
        ...

    def probe(self, state: Any) -> Probe | None:
        """The probe that the converter is to inject from now on; None for no probe."""
        ...


@runtime_checkable
class ProbeLines(Protocol):
    """An estimator that measures spectral lines beside the fundamental. The bound of its error can be computed."""

    def lines(self, i: ComplexArray, interval: float) -> tuple[ComplexArray, Array, int]:
        """The spectral lines of a current (n,) in the rotating frame (A), which is sampled every ``interval`` s.

        Returns phasors (M,), their angular frequencies in that frame (M,) in rad/s, and the number of last samples over
        which they are taken.
        """
        ...


@runtime_checkable
class KnowsItsError(Protocol):
    """An estimator whose covariance is calibrated: 95 % of the errors lie in its 95 % set. A scheduler follows such an
    estimate according to its covariance; that of any other estimator it leaves aside."""

    @property
    def calibrated(self) -> bool:
        """Whether it is."""
        ...

    @property
    def finds_within(self) -> float:
        """Time after an event within which it has an estimate again, s. So long a schedule waits for it."""
        ...


SIGNAL_SETS = {
    "none": "nothing measured",
    "steady": "one steady window, grid phase and X/R known",
    "two_windows": "two windows about a power step",
    "windows": "all windows about a power step",
    "injection": "one line beside the fundamental, over two windows",
    "pseudo_random": "one period of the binary sequence",
    "field": "two coded lines at half-integer multiples of the frequency",
    "other": "signals of its own: no bound is known",
}
"""Signals from which an estimator can work, in words. Each but the first and the last has a bound of the error."""


@dataclass(frozen=True)
class EstimatorKind:
    """An estimator that a study can select by name."""

    title: str
    """Its name in words that can follow "the estimate of": ``"the extended Kalman filter"``."""
    build: Callable[[Installation], Estimator]
    """Builds the estimator for an installation. Raises ArtifactError with everything that does not fit."""
    trained: bool = False
    """Whether it needs trained weights."""
    in_c: bool = False
    """Whether the C export contains it."""
    by_sample: bool = False
    """Whether it takes every sample of the controller and places its probe in time itself, instead of windows."""
    field_network: bool = False
    """Whether it is the field estimator with a network behind it, whose weights come with the package."""


class NoMemory(NamedTuple):
    """State of an estimator without memory."""


@dataclass(frozen=True)
class SpoiltBy:
    """The limits of the sensors in V and A. Samples at or beyond a limit are useless."""

    v_limit: float = field(default=float("inf"))
    i_limit: float = field(default=float("inf"))

    def status(self, samples: Samples) -> str | None:
        """The status of samples that cannot be used; None if they can be used.

        While the current is limited, it responds to a disturbance of the grid, and a passive method would take this
        response for the grid's impedance. A probe also does not reach the grid as it was asked for.
        """
        if samples.limited > 0:
            return "limited"
        v_peak, i_peak = (float(np.max(np.abs(x), initial=0.0)) for x in (samples.v, samples.i))
        if not (np.isfinite(v_peak + i_peak) and np.isfinite(samples.omega)):
            return "not finite"
        return None if v_peak < self.v_limit and i_peak < self.i_limit else "saturated"


def with_belief(R_g: float, L_g: float, covariance: Array | None, omega: float, believed: float) -> Estimate:
    """An estimate with its status. It is followed if it is precise enough and if it describes a possible grid.

    It is precise enough if the standard deviation of Z at ω (rad/s) is less than ``believed`` times |Z|, or if its
    covariance is not known. It is a possible grid if L_g is positive and R_g is at least −10 % of |Z|: an error of the
    estimate may make a small resistance negative.
    """
    if not np.isfinite(R_g + L_g):
        return no_estimate("not finite", "the method's equations have no solution here: keep the estimate before")
    size = float(np.hypot(R_g, omega * L_g))
    status = "ok" if L_g > 0.0 and R_g > -0.1 * size else "implausible"
    if covariance is not None and status == "ok":
        spread = float(covariance[0, 0] + omega**2 * covariance[1, 1])
        status = "ok" if spread < (believed * size) ** 2 else "uncertain"
    return Estimate(float(R_g), float(L_g), status, covariance)


GUESS_SCR = 6.3
"""Short-circuit ratio (on the reactance, X/R 1) with which estimators begin if nothing better is known. It is the
geometric mean of 2 and 20."""


def _later(module: str, name: str) -> Callable[[Installation], Estimator]:
    """Builds an estimator of a module here that is imported for the first one: a controller has one of them, and all
    imports together take longer than those of the scheduler."""

    def build(at: Installation) -> Estimator:
        return getattr(import_module(f"vsgdesign.identification.{module}"), name)(at)

    return build


ESTIMATORS: dict[str, EstimatorKind] = {
    "constant": EstimatorKind("a constant guess", _later("classical", "ConstantGuess")),
    "two_windows": EstimatorKind("two windows about a step", _later("classical", "TwoWindows")),
    "rls": EstimatorKind("recursive least squares", _later("recursive", "RecursiveLeastSquares")),
    "kalman": EstimatorKind("the extended Kalman filter", _later("recursive", "ExtendedKalmanFilter")),
    "injection": EstimatorKind("the injected line", _later("classical", "Injection")),
    "prbs": EstimatorKind("the pseudo-random sequence", _later("pseudo_random", "PseudoRandomSequence")),
    "field": EstimatorKind("the field estimator", _later("field", "field_estimator"), by_sample=True, in_c=True),
    "field_network": EstimatorKind(
        "the field estimator with its network",
        _later("field", "field_network_estimator"),
        by_sample=True,
        field_network=True,
        in_c=True,
    ),
    "neural": EstimatorKind("the network", _later("neural", "installed_network"), trained=True, in_c=True),
}
"""Every estimator by its name in a study. A new estimator is one more entry: the study reader, the simulation and the
comparison use this table alone."""


def estimator_kind(name: str) -> EstimatorKind:
    """The estimator of this name. Raises StudyError with the known names for an unknown one."""
    kind = ESTIMATORS.get(name)
    if kind is None:
        raise StudyError("estimator", [Fault("estimate", name, "unknown", f"Known: {', '.join(ESTIMATORS)}.")])
    return kind


def needs_network(name: str) -> bool:
    """Whether the value of ``estimate`` in a study needs trained weights. ``truth`` and unknown names do not."""
    kind = ESTIMATORS.get(name)
    return kind is not None and kind.trained


def samples_itself(name: str) -> bool:
    """Whether the value of ``estimate`` in a study is an estimator that takes every sample of the controller."""
    kind = ESTIMATORS.get(name)
    return kind is not None and kind.by_sample


def why_no_c(controller: str, estimate: str) -> str:
    """A sentence for a controller whose estimator has no C. It is empty if there is C or no estimator is used."""
    kind = ESTIMATORS.get(estimate)
    if kind is None or kind.in_c:
        return ""
    return (
        f"{controller}: there is no C for {kind.title} yet. The exported C has the scheduler without an estimator; it "
        "takes estimates from yours (vsg_update_estimate)."
    )


def build_estimator(name: str, at: Installation) -> Estimator:
    """Builds the estimator of this name for an installation.

    Raises StudyError for an unknown name, and ArtifactError if the estimator cannot be built for the installation.
    """
    return estimator_kind(name).build(at)
