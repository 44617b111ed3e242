"""Gains from an estimated grid. The estimator gets the measured samples, and the schedule gets its estimate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.network_weights import NetworkWeights
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.field import FieldAnswer
from vsgdesign.equations.frames import rms_to_peak, rotate, rotate_back
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import ArtifactError, InfeasibleStudyError
from vsgdesign.identification import (
    GUESS_SCR,
    STATUSES,
    Estimate,
    Estimator,
    Installation,
    Needs,
    Probe,
    Samples,
    estimator_kind,
)
from vsgdesign.identification.feeding import WindowPlan, window_of_rate
from vsgdesign.identification.interface import FOLLOWED
from vsgdesign.simulation.following import ScheduledAnswers
from vsgdesign.simulation.online import MeasuredWindow
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

NO_DESIGN = "no design"
"""The schedule has no gains for this estimate, so the gains do not change. Other statuses are in
identification.STATUSES."""

_FIRST = ("ok", "not finite", "saturated", "outside", NO_DESIGN)
ALL_STATUSES = (*_FIRST, *(status for status in STATUSES if status not in _FIRST))
"""In the order in which files count them."""

TRAINED_PHASE = -0.5 * math.pi
"""Angle of the grid source's vector at the first sample of a synchronised window, rad: phase A's zero crossing."""


_COLUMNS_OF_CYCLES = (
    "cov_RL",
    "sigma",
    "valid",
    "changed",
    "event",
    "doubt",
    "mode",
    "amplitude",
    "foreign",
    "passive",
)
"""What a file has of the field estimator besides the columns of all estimators."""


@dataclass(frozen=True, kw_only=True)
class EstimateLog:
    """The answers of an estimator beside the true grid. Arrays have one row for each answer."""

    t_s: Array
    """Time at which the answer acts, s: the end of its window."""
    R_g: Array
    L_g: Array
    """True grid at the end of the window, with a load at the PCC, Ω and H; NaN in an island or a fault."""
    R_g_hat: Array
    L_g_hat: Array
    """The estimate, Ω and H; NaN where there is none."""
    status: tuple[str, ...]
    """The status of each answer, one of ``ALL_STATUSES``."""
    period: float
    """Length of a window, s."""
    R_g_deviation: Array
    L_g_deviation: Array
    """Standard deviation of the estimate, Ω and H; NaN where it is not known."""
    limited: NDArray[np.bool_]
    """Whether the rate limit of the scheduler delayed the gains. Without a gain table it never does."""
    rate: float | None = None
    """The limit of \\|d ln SCR/dt\\| and \\|d ln(R/X)/dt\\|, 1/s; None without a gain table."""
    cycles: FieldAnswer | None = None
    """Of the field estimator alone: every number of its answers, with an array for each."""

    def series(self) -> dict[str, Array]:
        """Columns for a file; ``status`` counts along ALL_STATUSES."""
        numbers = np.array([ALL_STATUSES.index(status) for status in self.status], dtype=float)
        columns = {
            "t_s": self.t_s,
            "R_g": self.R_g,
            "L_g": self.L_g,
            "R_g_hat": self.R_g_hat,
            "L_g_hat": self.L_g_hat,
            "status": numbers,
        }
        if np.isfinite(self.R_g_deviation).any():
            columns |= {"R_g_deviation": self.R_g_deviation, "L_g_deviation": self.L_g_deviation}
        if self.cycles is not None:
            columns |= {name: getattr(self.cycles, name) for name in _COLUMNS_OF_CYCLES}
        return columns


@dataclass(frozen=True)
class _Row:
    """One answer of an estimator, and what came of it."""

    t_s: float
    estimate: Estimate
    status: str
    limited: bool


class EstimatedScheduler:
    """An online scheduler (:class:`vsgdesign.simulation.online.OnlineScheduler`) that estimates the grid.

    Windows do not overlap, and the first begins at t = 0. An answer acts at the end of its window, so the samples
    behind it are up to one window old. An estimate is followed if its status is one of ``FOLLOWED``. Otherwise, or if
    the schedule has no gains for it, the gains do not change. Until the first answer the gains are those of the study's
    grid at the start, on which the converter was commissioned. A controller with a gain table uses the scheduler of the
    runtime with all its guards. The probe that the estimator asks for is injected. The object has a state, so it must
    not be shared by two runs at a time.
    """

    def __init__(self, study: Study, spec: ControllerSpec, ready: Ready) -> None:
        self.estimator = estimator_of(study, spec, ready)
        self._needs = self.estimator.needs
        self._memory = self.estimator.first()
        self._answers = ScheduledAnswers(study, spec, ready, self.estimator)
        self._rows: list[_Row] = []

    @property
    def update_period(self) -> float:
        """Length of the estimator's window, s."""
        return self._needs.samples * self._needs.sample_interval

    @property
    def sample_interval(self) -> float:
        """Sample interval of the estimator, s."""
        return self._needs.sample_interval

    @property
    def probe_hold(self) -> float | None:
        """Time for which each value of the estimator's probes is held, s."""
        return self._needs.probe_hold

    def wanted(self) -> Probe | None:
        """The probe that the estimator wants from now on."""
        return self.estimator.probe(self._memory)

    def first_gains(self) -> PowerLoopGains:
        """Gains of the grid at the start, as :meth:`vsgdesign.simulation.following.ScheduledAnswers.first`."""
        self._rows.clear()
        self._memory = self.estimator.first()
        return self._answers.first()

    @property
    def grid(self) -> Grid:
        """The grid that the present gains are for."""
        return self._answers.grid

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
        """Gains for the estimated grid. None means that the gains do not change."""
        found = None
        for samples in samples_of(window, self._needs):
            self._memory, found = self.estimator.update(self._memory, samples)
        if found is None:  # no answer is due
            return None
        if found.status not in STATUSES:
            raise ArtifactError(
                f"{self.estimator.title}: its estimate has the status {found.status!r}. The known ones are "
                f"{', '.join(STATUSES)}. Give anything more precise as the reason of the estimate."
            )
        followed = found.status in FOLLOWED
        R_g, L_g = found[:2] if followed else (math.nan, math.nan)
        gains, limited = self._answers.to(window, R_g, L_g)
        status = NO_DESIGN if followed and gains is None else found.status
        self._rows.append(_Row(window.t_s, found, status, limited))
        return gains

    def log(self, timeline: Timeline) -> EstimateLog:
        """All answers of the run, beside the true grid."""
        t_s = np.array([row.t_s for row in self._rows], dtype=float)
        said = np.array([row.estimate[:2] for row in self._rows], dtype=float).reshape(-1, 2)
        deviations = np.array([_deviations(row.estimate) for row in self._rows], dtype=float).reshape(-1, 2)
        # The grid that held up to the end: a change that coincides with it is seen by the next window.
        grids = [timeline.true_grid_at(t - 0.5 * self.sample_interval) for t in t_s]
        return EstimateLog(
            t_s=t_s,
            R_g=np.array([grid.R_g for grid in grids]),
            L_g=np.array([grid.L_g for grid in grids]),
            R_g_hat=said[:, 0],
            L_g_hat=said[:, 1],
            status=tuple(row.status for row in self._rows),
            period=float(np.diff(t_s).mean()) if len(t_s) > 1 else self.update_period,
            R_g_deviation=deviations[:, 0],
            L_g_deviation=deviations[:, 1],
            limited=np.array([row.limited for row in self._rows], dtype=bool),
            rate=self._answers.rate,
        )


def _deviations(found: Estimate) -> Array:
    """Standard deviations of R_g and L_g; NaN where they are not known."""
    if found.covariance is None:
        return np.full(2, np.nan)
    return np.sqrt(np.diag(found.covariance))


def same_period(period: float, length: float, study: Study) -> bool:
    """Whether an update period is the length of a window: the same number of control periods (s both)."""
    T_s = study.converter.T_s
    return round(period / T_s) == round(length / T_s)


def estimator_of(study: Study, spec: ControllerSpec, ready: Ready) -> Estimator:
    """The estimator of a controller, as it ships.

    Raises StudyError for an unknown one, InfeasibleStudyError for a network that is not ready, and ArtifactError with
    all that does not fit.
    """
    kind = estimator_kind(spec.estimate)
    if kind.trained:
        return installed_weights(study, spec, ready.network_of(spec))
    c = study.converter
    return kind.build(installation_of(study, window_of_rate(c.f_sw * c.samples_per_carrier, c.omega_n)))


def installation_of(study: Study, window: WindowPlan) -> Installation:
    """A study's converter with windows of a sampling. The sensors' noise is not known; the guess is a grid of
    ``GUESS_SCR``, not the study's own: an estimator is told nothing of the grid."""
    c, spec = study.converter, study.estimator
    guess = Place(GUESS_SCR, 1.0, "reactance").grid(c)
    return Installation(
        T_s=c.T_s,
        omega_n=c.omega_n,
        V_base=rms_to_peak(c.V_rated_rms),
        Z_base=c.Z_base,
        samples=window.samples,
        sample_interval=window.steps * c.T_s,
        cycles=window.cycles,
        guess=(guess.R_g, guess.L_g),
        v_limit=_limit(None if spec is None else spec.v_limit_pu, rms_to_peak(c.V_rated_rms)),
        i_limit=_limit(None if spec is None else spec.i_limit_pu, c.I_rated_pk),
    )


def _limit(limit_pu: float | None, rated: float) -> float:
    """Where sensors saturate, V or A; None: nowhere."""
    return math.inf if limit_pu is None else limit_pu * rated


def installed_weights(study: Study, spec: ControllerSpec, weights: NetworkWeights) -> Estimator:
    """The network as it ships, for the windows of a controller. Raises ArtifactError with all that does not fit."""
    spec_of, c, window = study.estimator, study.converter, weights.window
    if spec_of is None:
        raise InfeasibleStudyError(f"controller {spec.name}: the study has no [estimator] section.")
    length = window.period
    faults = []
    if spec.update_period and not same_period(spec.update_period, length, study):
        faults.append(
            f"update_period = {spec.update_period * 1e3:g} ms: the weights take windows of {window.samples} × "
            f"{window.sample_interval * 1e6:g} µs = {length * 1e3:g} ms. Leave update_period out: the network answers "
            "at the end of every window. Or train for another window"
        )
    faults += weights_faults(c, weights)
    if window.synchronised and not spec_of.grid_phase:
        faults.append(
            "grid_phase = false: the weights were trained on windows synchronised with the grid's own voltage, which "
            "no converter in the field can measure. Train without (a recipe with a range of phase), or set "
            "grid_phase = true to use the simulator's own phase"
        )
    if faults:
        where = f"controller {spec.name}, [estimator]: these weights do not fit:\n"
        raise ArtifactError(where + "\n".join(f"  - {fault}." for fault in faults))
    steps = round(window.sample_interval / c.T_s)
    cycles = max(round(length * c.omega_n / (2.0 * math.pi)), 1)
    at = installation_of(study, WindowPlan(steps, window.samples, cycles, 0.0))
    at = replace(at, sample_interval=window.sample_interval, weights=weights, grid_phase=spec_of.grid_phase)
    return estimator_kind(spec.estimate).build(at)


def weights_faults(c: Converter, weights: NetworkWeights) -> list[str]:
    """Why a network cannot serve a converter: its sampling, or another rating or nominal frequency. Empty: it can."""
    faults, window = [], weights.window
    steps = window.sample_interval / c.T_s
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        faults.append(
            f"sample_interval = {window.sample_interval * 1e6:g} µs: it is not a whole multiple of the controller's "
            f"sampling period, {c.T_s * 1e6:g} µs. Train with one that is (sample_interval in the recipe)"
        )
    f_n = c.omega_n / (2.0 * math.pi)
    for name, unit, value in (("S_rated", "VA", c.S_rated), ("V_rated_rms", "V", c.V_rated_rms), ("f_n", "Hz", f_n)):
        trained = weights.training.get("converter", {}).get(name, value)
        if abs(trained - value) > 1e-6 * value:
            faults.append(
                f"{name} = {value:g} {unit}: the weights' scaling is of a converter with {trained:g} {unit}. "
                "Train for this one"
            )
    return faults


def samples_of(window: MeasuredWindow, needs: Needs) -> Iterator[Samples]:
    """A window as an estimator takes it: at once, or in equal parts one after another. The grid's phase is lent to an
    estimator that needs it alone."""
    v, i = window_channels(window, needs.channels, needs.grid_phase)
    sent = window.sent_values
    for first in range(0, len(window.theta), needs.samples):
        part = slice(first, first + needs.samples)
        yield Samples(v[..., part], i[..., part], window.omega, window.theta[part], sent[part], window.limited)


def window_channels(window: MeasuredWindow, channels: str, synchronised: bool) -> tuple[Array, Array]:
    """v_pcc (V) and i_pcc (A) of a window as a network takes them: (n,) for phase A, (2, n) for αβ and dq.

    ``synchronised``: turned so that the grid source's vector begins at ``TRAINED_PHASE``, for which the source's
    own phase is used. On a grid of nominal frequency, in steps of whole cycles, there is nothing to turn.
    """
    pair = []
    for vector in (window.v_pcc, window.i_pcc):
        alpha, beta = vector.T
        if channels == "dq":
            alpha, beta = rotate_back(alpha, beta, np.cos(window.theta), np.sin(window.theta))
        elif synchronised:
            angle = TRAINED_PHASE - window.source_phase
            alpha, beta = rotate(alpha, beta, math.cos(angle), math.sin(angle))
        pair.append(alpha if channels == "phase_a" else np.stack([alpha, beta]))
    return pair[0], pair[1]
