"""Every number of the records that run on a converter: name, unit, meaning and start value."""

from __future__ import annotations

from typing import Any

from vsgdesign.codegen.described import DescribedNumber, described_numbers
from vsgdesign.equations.controller import ControllerOutput, ControllerSettings, ControllerState, Measurement
from vsgdesign.equations.field import FieldAnswer, FieldSettings, FieldTrack, LockIn, first_lock_in, first_track
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.equations.scheduler_data import SchedulerInput, SchedulerLimits, SchedulerState
from vsgdesign.equations.synchronising import GridWatch
from vsgdesign.export.field import ConverterConstants
from vsgdesign.runtime.power_controller import state_at_set_points
from vsgdesign.runtime.scheduler import Scheduler
from vsgdesign.runtime.updating import first_state


def converter_numbers(scheduler: Scheduler, converter: ConverterConstants) -> dict[str, list[DescribedNumber]]:
    """The numbers of each record that runs on a converter, by the name of the record, in SI or as their units say.

    A state's start values are those with which the converter begins: at rest at its set points, with the gains of the
    scheduler's first place, and with an estimator that knows nothing. Inputs and outputs have none.
    """
    refs, settings, field = converter.references, converter.controller_settings, converter.field_settings
    first = first_state(scheduler.lookup, scheduler.settings)
    records: tuple[tuple[Any, Any], ...] = (
        (Measurement, None),
        (References, refs),
        (PowerLoopGains, first.gains),
        (InnerLoopGains, converter.inner_gains),
        (ControllerSettings, settings),
        (ControllerState, state_at_set_points(refs, first.gains)),
        (ControllerOutput, None),
        (GridWatch, GridWatch(0.0, 0.0, refs.omega_0)),
        (SchedulerLimits, scheduler.settings.limits),
        (SchedulerInput, None),
        (SchedulerState, first),
        (FieldSettings, field),
        (LockIn, first_lock_in(field, field.omega_n)),
        (FieldTrack, first_track(field)),
        (FieldAnswer, None),
    )
    return {record.__name__: described_numbers(record, start) for record, start in records}
