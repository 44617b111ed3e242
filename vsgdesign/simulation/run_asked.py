"""What is asked of a run of the EMT loop, and the run without a step that goes beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.identification import Probe
from vsgdesign.simulation.between_rows import RowsAsked
from vsgdesign.simulation.circuits import CircuitOfGrid
from vsgdesign.simulation.every_sample import EverySample
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange, RunFeed
from vsgdesign.simulation.gains_of_run import ListedGains, OnlineGains
from vsgdesign.simulation.online import OnlineScheduler
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
