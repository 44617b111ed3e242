"""Gains from an estimated grid: each measured window goes through the network, its answer through the schedule."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.network_weights import NetworkWeights
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import ArtifactError, InfeasibleStudyError
from vsgdesign.frames import rms_to_peak, rotate, rotate_back
from vsgdesign.identification import STATUSES, Needs, Samples
from vsgdesign.identification.neural import NeuralEstimator, neural_estimator
from vsgdesign.parameters.study import ControllerSpec, Grid, Study
from vsgdesign.simulation.following import ScheduledAnswers
from vsgdesign.simulation.online import MeasuredWindow
from vsgdesign.simulation.timeline import Timeline

Array = NDArray[np.float64]

NO_DESIGN = "no design"
"""The schedule has no gains for this estimate, so the gains before go on. Other statuses: identification.STATUSES."""

ALL_STATUSES = (*STATUSES, NO_DESIGN)

TRAINED_PHASE = -0.5 * math.pi
"""Angle of the grid source's vector at the first sample of a synchronised window, rad: phase A's zero crossing."""


@dataclass(frozen=True)
class EstimateLog:
    """What the network said of every window, beside the truth. Arrays have a row per window."""

    t_s: Array
    """End of the window: when the answer acts."""
    R_g: Array
    L_g: Array
    """True grid at the end of the window, Ω and H."""
    R_g_hat: Array
    L_g_hat: Array
    """Its estimate; NaN where there is none."""
    status: tuple[str, ...]
    """One of ``ALL_STATUSES`` each."""
    period: float
    """Length of a window, s."""
    limited: NDArray[np.bool_]
    """Whether the scheduler's rate limit held the gains back; never without a gain table."""
    rate: float | None = None
    """That limit: of \\|d ln SCR/dt\\| and \\|d ln(R/X)/dt\\|, 1/s; None without a gain table."""

    def series(self) -> dict[str, Array]:
        """Columns for a file; ``status`` counts along ALL_STATUSES."""
        numbers = np.array([ALL_STATUSES.index(status) for status in self.status], dtype=float)
        return {
            "t_s": self.t_s,
            "R_g": self.R_g,
            "L_g": self.L_g,
            "R_g_hat": self.R_g_hat,
            "L_g_hat": self.L_g_hat,
            "status": numbers,
        }


class EstimatedScheduler:
    """An online scheduler (:class:`vsgdesign.simulation.online.OnlineScheduler`) that knows the grid by estimate.

    With the published timing: windows do not overlap, the first begins at t = 0, and an answer acts where its
    window ends, so that it is one cycle old. Without an estimate, or where the schedule has no gains for it, the
    gains go on as they were. Until the first answer they are those of the study's grid at the start: what the
    converter was commissioned on. A controller with a gain table is run by the scheduler that ships, guards and all.
    For one run at a time: it remembers.
    """

    def __init__(self, study: Study, spec: ControllerSpec, ready: Ready) -> None:
        weights = ready.network_of(spec)
        self._estimator = estimator_of(study, spec, weights)
        self._window = weights.window
        self._study, self._spec = study, spec
        self._answers = ScheduledAnswers(study, spec, ready, self._estimator)
        self._rows: list[tuple[float, float, float, str, bool]] = []

    @property
    def update_period(self) -> float:
        """Length of the network's window, s: that of the controller, or as near as whole control periods allow."""
        return self._window.period

    @property
    def sample_interval(self) -> float:
        """That of the network's windows, s."""
        return self._window.sample_interval

    def first_gains(self) -> PowerLoopGains:
        """Gains of the grid at the start, as :meth:`vsgdesign.simulation.following.ScheduledAnswers.first`."""
        self._rows.clear()
        return self._answers.first()

    @property
    def grid(self) -> Grid:
        """The grid that the present gains are for."""
        return self._answers.grid

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
        """Gains for the estimated grid, None to go on as before."""
        (samples,) = samples_of(window, self._estimator.needs)
        R_g, L_g, status = self._estimator.update(self._estimator.first(), samples)[1][:3]
        gains, limited = self._answers.to(window, R_g, L_g)
        if gains is None and math.isfinite(R_g):
            status = NO_DESIGN
        self._rows.append((window.t_s, R_g, L_g, status, limited))
        return gains

    def log(self, timeline: Timeline) -> EstimateLog:
        """What was said during the run, beside the truth."""
        t_s, R_g_hat, L_g_hat = (np.array([row[k] for row in self._rows], dtype=float) for k in range(3))
        # The grid that held up to the end: a change that coincides with it is seen by the next window.
        grids = [timeline.grid_at(t - 0.5 * self.sample_interval) for t in t_s]
        limited = np.array([row[4] for row in self._rows], dtype=bool)
        return EstimateLog(
            t_s,
            np.array([grid.R_g for grid in grids]),
            np.array([grid.L_g for grid in grids]),
            R_g_hat,
            L_g_hat,
            tuple(row[3] for row in self._rows),
            self.update_period,
            limited,
            self._answers.rate,
        )


def same_period(period: float, length: float, study: Study) -> bool:
    """Whether an update period is the length of a window: the same number of control periods (s both)."""
    T_s = study.converter.T_s
    return round(period / T_s) == round(length / T_s)


def estimator_of(study: Study, spec: ControllerSpec, weights: NetworkWeights) -> NeuralEstimator:
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
    steps = window.sample_interval / c.T_s
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        faults.append(
            f"sample_interval = {window.sample_interval * 1e6:g} µs: no whole multiple of the controller's sampling "
            f"period, {c.T_s * 1e6:g} µs. Train with one that is (sample_interval in the recipe)"
        )
    f_n = c.omega_n / (2.0 * math.pi)
    for name, unit, value in (("S_rated", "VA", c.S_rated), ("V_rated_rms", "V", c.V_rated_rms), ("f_n", "Hz", f_n)):
        trained = weights.training.get("converter", {}).get(name, value)
        if abs(trained - value) > 1e-6 * value:
            faults.append(
                f"{name} = {value:g} {unit}: the weights' scaling is of a converter with {trained:g} {unit}. "
                "Train for this one"
            )
    if window.synchronised and not spec_of.grid_phase:
        faults.append(
            "grid_phase = false: the weights were trained on windows synchronised with the grid's own voltage, which "
            "no converter in the field can measure. Train without (a recipe with a range of phase), or set "
            "grid_phase = true to be lent the simulator's own phase"
        )
    if faults:
        where = f"controller {spec.name}, [estimator]: these weights do not fit:\n"
        raise ArtifactError(where + "\n".join(f"  - {fault}." for fault in faults))
    v_limit, i_limit = (
        math.inf if limit is None else limit * rated
        for limit, rated in (
            (spec_of.v_limit_pu, rms_to_peak(c.V_rated_rms)),
            (spec_of.i_limit_pu, c.I_rated_pk),
        )
    )
    return neural_estimator(
        weights,
        sample_interval=window.sample_interval,
        channels=window.channels,
        grid_phase=spec_of.grid_phase,
        v_limit=v_limit,
        i_limit=i_limit,
    )


def samples_of(window: MeasuredWindow, needs: Needs) -> Iterator[Samples]:
    """A window as an estimator takes it: at once, or in equal parts one after another. The grid's phase is lent to an
    estimator that needs it alone."""
    v, i = window_channels(window, needs.channels, needs.grid_phase)
    sent = window.sent_values
    for first in range(0, len(window.theta), needs.samples):
        part = slice(first, first + needs.samples)
        limited = window.limited if first == 0 else 0
        yield Samples(v[..., part], i[..., part], window.omega, window.theta[part], sent[part], limited)


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
