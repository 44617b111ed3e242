"""The field estimator as C: its functions, its settings, and what the templates say of them. And every number of the
records that run on a converter: name, unit, meaning and start value.
"""

from __future__ import annotations

import functools
import typing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vsgdesign.codegen import CText, c_functions
from vsgdesign.codegen.described import DescribedNumber, described_numbers
from vsgdesign.codegen.vector_math import SINGLE
from vsgdesign.equations.controller import ControllerOutput, ControllerSettings, ControllerState, GridWatch, Measurement
from vsgdesign.equations.field import (
    FieldAnswer,
    FieldSettings,
    FieldTrack,
    LockIn,
    conclude,
    features,
    first_lock_in,
    first_track,
    listen,
    probe_value,
)
from vsgdesign.equations.field.fusion import fused_answer, next_gate, step_refuted
from vsgdesign.equations.field.lock_in import probe_offset
from vsgdesign.equations.field.tracks import Track
from vsgdesign.equations.frames import rotate
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.equations.scheduler_data import SchedulerInput, SchedulerLimits, SchedulerState
from vsgdesign.identification.field import FieldNetwork
from vsgdesign.runtime.power_controller import state_at_set_points
from vsgdesign.runtime.scheduler import Scheduler
from vsgdesign.runtime.updating import first_state

if TYPE_CHECKING:
    from vsgdesign.study.parameters.study import Study


WAITING = 8
"""Samples that may come in while a cycle is being concluded in a slower task."""

LARGEST_BYTES = 2048
"""Of the whole state in single precision, the waiting samples included."""

NAMES = {Track: "field_sums"}
"""What C calls a record, where it is not its own name behind ``field_``."""

PUBLIC = ("settings", "lock_in", "lock_in_lost", "track", "answer")
PUBLIC_OF_NETWORK = ("network_gate",)
FUNCTIONS = (first_lock_in, first_track, probe_value, probe_offset, rotate, listen, conclude)
OF_NETWORK = (features, next_gate, step_refuted, fused_answer)
"""What a network behind the estimator needs besides."""


@functools.cache
def field_laws(network: bool = False) -> CText:
    """C99 of the estimator, with what a ``network`` behind it needs, read once: an export of every kind asks for it a
    dozen times.

    Its records are called vsg_field_…_t and its constants VSG_FIELD_…
    """
    functions = (*FUNCTIONS, *(OF_NETWORK if network else ()))
    return c_functions(functions, names=NAMES, prefix="field_", printed=SINGLE)


def count_of(record: Any) -> int:
    """Numbers in a record."""
    hints = typing.get_type_hints(record)
    return sum(count_of(kind) if hasattr(kind, "_fields") else 1 for kind in (hints[name] for name in record._fields))


def field_content(network: bool = False) -> dict[str, Any]:
    """What the templates take of the estimator."""
    text = field_laws(network)
    public = text.needed_by(f"vsg_field_{name}_t" for name in (*PUBLIC, *(PUBLIC_OF_NETWORK if network else ())))
    return {
        "waiting": WAITING,
        "largest_bytes": LARGEST_BYTES,
        "public_structs": "\n".join(text.structs[name] for name in public).rstrip(),
        "private_structs": "\n".join(body for name, body in text.structs.items() if name not in public).rstrip(),
        "constants": text.constants.rstrip(),
        "functions": text.functions.rstrip(),
        "lock_in_count": count_of(LockIn),
        "track_count": count_of(FieldTrack),
        "answer_count": count_of(FieldAnswer),
    }


@dataclass(frozen=True)
class ConverterConstants:
    """What a folder with the estimator holds of its converter."""

    inner_gains: InnerLoopGains
    references: References
    controller_settings: ControllerSettings
    field_settings: FieldSettings
    network: FieldNetwork | None = None
    """The network behind the field estimator."""
    network_sha256: str | None = None


def converter_constants(
    study: Study, network: FieldNetwork | None = None, network_sha256: str | None = None
) -> ConverterConstants:
    """The constants of a study's converter, with set points without power, and of the network that it is given."""
    from vsgdesign.simulation.field_feed import settings_of_study

    c = study.converter
    return ConverterConstants(
        study.inner_gains,
        c.references(),
        study.controller_settings(),
        settings_of_study(study),
        network,
        network_sha256,
    )


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
