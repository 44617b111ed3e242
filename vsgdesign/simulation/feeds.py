"""The gains that a run of a controller is given."""

from __future__ import annotations

from vsgdesign.artifacts.ready import Ready
from vsgdesign.identification import estimator_kind
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.simulation.estimated import EstimatedScheduler
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.late import gain_feed
from vsgdesign.simulation.online import OnlineScheduler
from vsgdesign.simulation.timeline import Timeline


def feed_of(
    study: Study, spec: ControllerSpec, timeline: Timeline, ready: Ready
) -> EstimatedScheduler | FieldScheduler | OnlineScheduler | tuple[GainChange, ...]:
    """The gains that a run of a controller is given, or the scheduler that is asked for them. ``study`` has the
    controller's current limit. Raises InfeasibleStudyError where there are no gains on a grid of the scenario."""
    if spec.estimate == "truth":
        return gain_feed(study, spec, timeline, ready)
    kind = FieldScheduler if estimator_kind(spec.estimate).by_sample else EstimatedScheduler
    return kind(study, spec, ready)
