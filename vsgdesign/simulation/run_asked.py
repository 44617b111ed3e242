"""What is asked of a run of the EMT loop and what a batch has logged of it, and the run without a step that goes beside
it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.identification import Probe
from vsgdesign.simulation.batch import Batch
from vsgdesign.simulation.between_rows import RowsAsked
from vsgdesign.simulation.circuits import CircuitOfGrid
from vsgdesign.simulation.dc_start import rows_before_block
from vsgdesign.simulation.every_sample import EverySample
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange, ListedGains, OnlineGains, RunFeed
from vsgdesign.simulation.loop import LOG_COLUMNS, SENSED_COLUMNS, log_names
from vsgdesign.simulation.online import OnlineScheduler
from vsgdesign.simulation.outcome import good_rows
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RunOf:
    """What is simulated: a study with gains over time, or with a scheduler that is asked for them."""

    study: Study
    schedule: Sequence[GainChange] | OnlineScheduler | FieldScheduler
    log_states: int = 0
    """For how many first samples the controller's states are kept."""
    probe: Probe | None = None
    """Sent from t = 0 on, in place of one that the scheduler asks for."""
    circuit: CircuitOfGrid | None = None
    """Replaces the study's circuit between bridge and source."""
    twins: tuple[float, ...] = ()
    """The instants (s) of steps from which on the run without them goes beside it (``twin.steps_with_twin``)."""
    every_sample: EverySample | None = None
    """Gets every sample of the run, or as many as figures need, beside its log."""
    finds: ControllerSpec | None = None
    """The controller that the gains are those of, in a run that finds the instants which only it can tell; None: it
    finds none (:class:`vsgdesign.simulation.search.Search`)."""
    ends: Callable[[Study], float] | None = None
    """When the run may end, s, with the instants found so far; None: at the end of the study."""
    rows: RowsAsked | None = None
    """What rows of a log of every sample have to say of the samples between them; None: nothing."""
    together: bool = False
    """Whether the scheduler of its gain table, if it has one, is that of all runs side by side. Its updates are then
    machine code, with the sines of :mod:`vsgdesign.codegen.vector_math`: gains differ in their last bits."""


@dataclass(frozen=True)
class Twin:
    """The run without a step, from the step on up to the next event. Rows are those of the run's own log, or those of
    which figures are taken where the run is asked for these."""

    event_s: float
    """When the step comes, s."""
    t_s: Array
    log: Array
    circuit_log: Array
    timeline: Timeline
    """Without the step."""


def feed_of_run(of: RunOf, timeline: Timeline) -> RunFeed:
    """What gives the run its gains. Raises InfeasibleStudyError for a probe beside that of a field estimator."""
    schedule, study = of.schedule, of.study
    if isinstance(schedule, FieldScheduler):
        if of.probe is not None:
            raise InfeasibleStudyError(
                "probe: a field estimator sends its own in every sample and listens to that one alone. Leave probe "
                "out, or give a controller without a field estimator."
            )
        return schedule.fresh()
    T_s = study.converter.T_s
    return ListedGains(schedule, T_s) if isinstance(schedule, Sequence) else OnlineGains(schedule, study, timeline)


class RunLog:
    """What a batch has logged of one run, which is to have ``length`` rows. ``seen`` gets the rows of a log that is
    written anew again and again."""

    def __init__(self, batch: Batch, number: int, length: int, seen: EverySample | None = None) -> None:
        group, lane = batch.lane(number)
        self._batch, self._seen, last = batch, seen, batch.logs[-1]
        main = last.into or last
        self._kept = None if batch.seen is None else batch.seen.of(number)
        self._whole = main.rows[group, :, :, lane]
        self._log = main if last.again else last
        self._last = self._log.rows[group, :, :, lane]
        self._states = [log.rows[group, :, :, lane] for log in batch.logs[:-1]]
        self._sensed = len(SENSED_COLUMNS) if batch.kind.sensors else 0
        self._width = len(log_names(batch.kind))
        self._end_of_more = self._width - (0 if batch.kind.dc is None else len(batch.kind.dc.logged))
        self._every, self.length, self._over = main.every, length, False
        self.dc_end = self.dc[:0].ravel()
        """The dc link at the last sample before the end of which anything is logged; nothing where it is ideal."""
        self.samples = length * main.every
        """So many samples the run has at most."""

    @property
    def rows(self) -> Array:
        """(n, len(LOG_COLUMNS))."""
        return self._whole[: self.length, : len(LOG_COLUMNS)]

    @property
    def seen(self) -> Mapping[str, Array] | None:
        """Some columns of every sample, (samples,) each, where a log with fewer rows was asked for; else None."""
        return None if self._kept is None else {name: column[: self.samples] for name, column in self._kept.items()}

    @property
    def sensed(self) -> Array:
        """(n, 4): what the sensors say of the capacitor node's voltage and of i_g; (0, 4) where they are ideal."""
        found = self._whole[: self.length, len(LOG_COLUMNS) : len(LOG_COLUMNS) + self._sensed]
        return found if self._sensed else np.empty((0, len(SENSED_COLUMNS)))

    @property
    def more(self) -> Array:
        """(n, m): the circuit's other states."""
        return self._whole[: self.length, len(LOG_COLUMNS) + self._sensed : self._end_of_more]

    @property
    def dc(self) -> Array:
        """(n, k): the dc link; no columns where it is ideal."""
        return self._whole[: self.length, self._end_of_more :]

    @property
    def states(self) -> Array:
        """The controller's states, a row for each of the first samples."""
        if not self._states:
            return np.empty((0, 0))
        return self._states[0][: self.length * self._every, self._whole.shape[1] :].copy()

    def good(self, study: Study, begin: int, end: int) -> int:
        """The sample of the first row among those of samples ``begin`` to ``end`` − 1 that has diverged."""
        log = self._log
        first, last = (-(-sample // log.every) - log.begin // log.every for sample in (begin, end))
        rows = self._last[first:last]
        good = good_rows(study, rows[:, : len(LOG_COLUMNS)])
        if study.dc is not None:
            good = min(good, rows_before_block(study, rows[:, self._end_of_more : self._width]))
        return log.begin + (first + good) * log.every

    def make_room(self, begin: int, end: int) -> None:
        """Before samples ``begin`` to ``end`` − 1 are run: a log that is too full for them is written anew."""
        log = self._batch.logs[-1]
        if self._seen is not None and end - log.begin > len(self._last) * log.every:
            if not self._over:  # a run that has diverged may be in a stretch with others
                self._hand_over(begin)
                self._keep_link(begin)
            self._batch.log_anew(begin // log.every * log.every)

    def end(self, sample: int) -> None:
        """The log ends before a sample."""
        self.length, self._over = min(self.length, -(-sample // self._every)), True
        self._keep_link(sample)
        self.samples = min(self.samples, sample)
        if self._seen is not None:
            self._hand_over(sample)

    def _keep_link(self, end: int) -> None:
        rows = self._last[: -(-(end - self._log.begin) // self._log.every), self._end_of_more : self._width]
        self.dc_end = rows[-1].copy() if len(rows) else self.dc_end

    def _hand_over(self, end: int) -> None:
        """Gives what is logged of the samples before ``end``."""
        if self._seen is not None:
            log, own = self._batch.logs[-1], len(LOG_COLUMNS)
            rows = self._last[: -(-(end - log.begin) // log.every)]
            more = rows[:, own + self._sensed : self._end_of_more]
            found = rows[:, self._width :] if self._batch.kind.taken else None
            self._seen.take(log.begin, log.every, rows[:, :own], more, found)
