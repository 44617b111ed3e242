"""A run of a controller with the field estimator, which gets nothing that a real converter does not have.

The estimator sends its probe and listens in every sample of the compiled loop. The loop stops where a cycle of the
estimator ends, which may be at any sample. The answer of this cycle then goes to the schedule, and new gains act from
the next sample on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.field_weights import read_field_weights
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.field import FieldAnswer, FieldFeatures, FieldSettings
from vsgdesign.equations.field.fusion import FIRST_GATE
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.identification.field import (
    PAIRS,
    FieldEstimator,
    FieldNetwork,
    estimate_of,
    field_network,
    field_settings,
)
from vsgdesign.identification.interface import estimator_kind
from vsgdesign.runtime.of_study import follows_measured
from vsgdesign.simulation.estimated import NO_DESIGN, EstimateLog
from vsgdesign.simulation.field_observer import FieldMemory
from vsgdesign.simulation.following import ScheduledAnswers
from vsgdesign.simulation.gains import GainChange, RunFeed
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.estimator import EstimatorSpec, ProbeSpec
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

SCR_LIMITS = (1.2, 25.0)
"""Short-circuit ratios, on |Z|, to which an estimate is clipped where the study has no specification."""

ANGLE_LIMITS_DEG = (14.0, 86.0)
"""The same for the angle of Z."""


_CODES_APART = 101
"""By how much the codes of two units differ, so that their probes do not change their signs alike."""

LEAST_RESISTANCE = -0.1
"""Least R of an estimate over its |Z|. An error may make a small resistance negative."""


@dataclass(frozen=True)
class GridBox:
    """The grids that a schedule is made for."""

    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    basis: str

    @property
    def middle(self) -> Place:
        """The geometric middle, with which a closed form begins that knows nothing of its grid."""
        (a, b), (c, d) = self.scr, self.x_over_r
        return Place(math.sqrt(a * b), math.sqrt(c * d), self.basis)

    def clipped(self, R_g: float, L_g: float, converter: Converter) -> Grid:
        """The grid of the box that is nearest to an estimate (Ω, H) in SCR and X/R."""
        return Grid(*(float(value) for value in self.all_clipped(R_g, L_g, converter)))

    def all_clipped(self, R_g: Any, L_g: Any, converter: Converter) -> tuple[Array, Array]:
        """R_g (Ω) and L_g (H) of the grids of the box that are nearest to estimates; numbers or arrays."""
        omega, Z_base, basis = converter.omega_n, converter.Z_base, SCR_BASES[self.basis]
        R, X = np.maximum(R_g, 0.0), np.maximum(omega * L_g, 1e-6 * Z_base)
        with np.errstate(divide="ignore"):
            x_over_r = X / R
        scr = basis.scr(R, X / omega, Z_base, omega)
        (a, b), (c, d) = self.scr, self.x_over_r
        inside = (a <= scr) & (scr <= b) & (c <= x_over_r) & (x_over_r <= d)
        near_R, near_L = basis.grid(np.clip(scr, a, b), np.clip(x_over_r, c, d), Z_base, omega)
        return np.where(inside, R_g, near_R), np.where(inside, L_g, near_L)


def box_of(study: Study) -> GridBox:
    """The grids of the study's specification, or a wide range where it has none."""
    asked = study.specification
    if asked is None:
        low, high = (math.tan(math.radians(angle)) for angle in ANGLE_LIMITS_DEG)
        return GridBox(SCR_LIMITS, (low, high), "impedance")
    return GridBox((asked.scr[0], asked.scr[-1]), (asked.x_over_r[0], asked.x_over_r[-1]), asked.scr_basis)


def settings_of_study(study: Study) -> FieldSettings:
    """The estimator's settings for a study's converter: it measures at the filter's capacitor."""
    c, part, probe = study.converter, study.filter, probe_of(study)
    return field_settings(
        T_s=c.T_s,
        omega_n=c.omega_n,
        V_base=rms_to_peak(c.V_rated_rms),
        Z_base=c.Z_base,
        R_2=part.R_2,
        L_2=part.L_2,
        limits=probe.limits,
        seed=probe.code,
        pair=probe.pair,
    )._replace(neighbours=1.0 if probe.neighbours else 0.0)


def settings_of_pairs(study: Study) -> tuple[FieldSettings, ...]:
    """The estimator's settings on each pair of lines, from the first to the last one. The sign codes are as far apart
    as those of a plant's units, so that these are the settings of its units, too."""
    own = probe_of(study).pair
    pairs = range(1, len(PAIRS) + 1)
    return tuple(settings_of_study(with_pair(study, pair, pair - own)) for pair in pairs)


def probe_of(study: Study) -> ProbeSpec:
    """What the study says of the probe."""
    asked = None if study.estimator is None else study.estimator.probe
    return ProbeSpec() if asked is None else asked


def with_pair(study: Study, pair: int, number: int = 0, *, neighbours: bool = False) -> Study:
    """The study with the probe on a pair of lines. ``number``: of the unit in its plant, which has a sign code of its
    own. ``neighbours``: whether the plant has other units."""
    probe = probe_of(study)
    code, others = probe.code + _CODES_APART * number, neighbours or probe.neighbours
    probe = replace(probe, pair=pair, code=code, neighbours=others)
    return replace(study, estimator=replace(study.estimator or EstimatorSpec(), probe=probe))


def network_of(study: Study, spec: ControllerSpec) -> FieldNetwork | None:
    """The network behind a controller's field estimator: that of the file that the study names, else the packaged one.

    None for a controller without one. Raises ArtifactError for a file that is damaged or does not fit.
    """
    if not estimator_kind(spec.estimate).field_network:
        return None
    named = None if study.estimator is None else study.estimator.field_weights_file
    return field_network(read_field_weights(named), FieldFeatures._fields)


class MeasuredCycle(NamedTuple):
    """What the schedule takes of a cycle (:class:`vsgdesign.simulation.following.MeasuredPowers`)."""

    t_s: float
    P: float
    Q: float
    V_rms: float
    limited: int


class FieldRow(NamedTuple):
    """One cycle of the estimator, and what came of it."""

    t_s: float
    answer: FieldAnswer
    no_design: bool
    held_back: bool
    """Whether the rate limit of the scheduler delayed the gains."""


class FieldScheduler(RunFeed):
    """What ``simulate`` is given for a controller with ``estimate = "field"``.

    It gets nothing that a real converter does not have. Until the first valid answer the gains are those of a safe
    place: that of the table, or the geometric middle of the grids that the closed form is made for. A valid answer is
    followed. With any other the last one is held, while the gains go on following the measured P, Q and V, if the
    schedule does. The object has a state, so it serves one run at a time.
    """

    def __init__(
        self, study: Study, spec: ControllerSpec, ready: Ready = NOTHING, *, probe: bool | None = None
    ) -> None:
        """``probe``: whether it is sent; None: as the study says."""
        self._study, self._spec = study, spec
        self._probing = probe_of(study).send if probe is None else probe
        self._settings = settings_of_study(study)
        self._answers = ScheduledAnswers(study, spec, ready, FieldEstimator(self._settings))
        self._has_table = ready.table(spec) is not None
        self._box, self._follows = box_of(study), follows_measured(spec)
        self._network = network_of(study, spec)
        self.begin()

    def fresh(self) -> FieldScheduler:
        """This object, ready for the beginning of a run."""
        return self if self._fresh else self.begin()

    def begin(self) -> FieldScheduler:
        """Starts again without any knowledge. Returns this object."""
        omega_n = self._study.converter.omega_n
        V_n = self._study.converter.V_rated_rms
        self._fresh = True
        self._gate = FIRST_GATE
        self.memory = self._memory = FieldMemory(self._settings, omega_n, V_n, allowed=self._probing)
        self._held = self._box.middle.grid(self._study.converter)
        self._first = self._answers.first(self._held, known=False)
        self.rows: list[FieldRow] = []
        self.changes = [GainChange(0.0, self._first, self.grid(0))]
        return self

    @property
    def closed(self) -> bool:
        """Whether a cycle of the estimator has ended. It may do so at any sample: the loop stops by itself."""
        return self._memory.closed

    def first(self) -> PowerLoopGains:
        self._fresh = False
        return self._first

    def grid(self, sample: int) -> Grid:
        del sample
        return self._answers.grid

    def conclude(self, sample: int, present: PowerLoopGains, state: ControllerState) -> PowerLoopGains:
        """Ends the estimator's cycle before a sample. Returns the gains from this sample on."""
        return self.take(self.concluded(), sample, present, state)

    def take(self, answer: FieldAnswer, sample: int, present: PowerLoopGains, state: ControllerState) -> PowerLoopGains:
        """The gains from a sample on, after an answer of this estimator or of one that several converters share."""
        T_s = self._study.converter.T_s
        measured = MeasuredCycle(sample * T_s, state.P_f, state.Q_f, state.V, int(answer.limited > 0.0))
        gains, held_back = self._followed(answer, measured)
        self.rows.append(FieldRow(measured.t_s, answer, gains is None, held_back))
        if gains is None or gains == present:
            return present
        self.changes.append(GainChange(measured.t_s, gains, self.grid(sample)))
        return gains

    def concluded(self) -> FieldAnswer:
        """The answer of the cycle, with the network behind the recursions if there is one."""
        answer = self._memory.conclude()
        if self._network is None:
            return answer
        self._gate, spoken = self._network.behind(self._gate, self._memory.seen, answer, self._settings)
        return spoken

    def _followed(self, answer: FieldAnswer, measured: MeasuredCycle) -> tuple[PowerLoopGains | None, bool]:
        followed = answer.valid > 0.5 and answer.spoilt < 0.5
        if self._has_table:
            R_g, L_g = (answer.R_g, answer.L_g) if followed else (math.nan, math.nan)
            decided = {"surprised": answer.event > 0.5, "changed": answer.changed > 0.5}
            spread = (answer.var_R, answer.cov_RL, answer.var_L)
            return self._answers.to(measured, R_g, L_g, covariance=spread, **decided)
        if followed:
            size = math.hypot(answer.R_g, self._study.converter.omega_n * answer.L_g)
            if not (answer.L_g > 0.0 and answer.R_g > LEAST_RESISTANCE * size):
                return None, False
            self._held = self._box.clipped(answer.R_g, answer.L_g, self._study.converter)
        return self._answers.to(measured, self._held.R_g, self._held.L_g)

    def log(self, timeline: Timeline) -> EstimateLog:
        """The answers of the run beside the true grid."""
        return field_log(self.rows, timeline, self._study, self._answers.rate)


def field_log(rows: list[FieldRow], timeline: Timeline, study: Study, rate: float | None) -> EstimateLog:
    """The rows of a run as a log. A value is NaN where the estimator knows nothing yet."""
    T_s, f_n = study.converter.T_s, study.converter.omega_n / (2.0 * math.pi)
    t_s = np.array([row.t_s for row in rows], dtype=float)
    said = np.array([row.answer for row in rows], dtype=float).reshape(-1, len(FieldAnswer._fields))
    answers = FieldAnswer(*said.T)
    estimates = [estimate_of(row.answer) for row in rows]
    known = np.array([one.status != "waiting" for one in estimates], dtype=bool)
    grids = [timeline.true_grid_at(t - 0.5 * T_s) for t in t_s]
    blank = np.where(known, 1.0, np.nan)
    return EstimateLog(
        t_s=t_s,
        R_g=np.array([grid.R_g for grid in grids]),
        L_g=np.array([grid.L_g for grid in grids]),
        R_g_hat=answers.R_g * blank,
        L_g_hat=answers.L_g * blank,
        status=tuple(
            NO_DESIGN if row.no_design and one.status == "ok" else one.status
            for row, one in zip(rows, estimates, strict=True)
        ),
        period=float(np.diff(t_s).mean()) if len(t_s) > 1 else 1.0 / f_n,
        R_g_deviation=np.sqrt(answers.var_R) * blank,
        L_g_deviation=np.sqrt(answers.var_L) * blank,
        limited=np.array([row.held_back for row in rows], dtype=bool),
        rate=rate,
        cycles=answers._replace(cov_RL=answers.cov_RL * blank),
    )
