"""The part that runs on the controller. It needs NumPy alone.

A scheduler is what most of its users want. What else there is here is imported when it is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from vsgdesign.identification import (
    ESTIMATORS,
    Estimate,
    Estimator,
    EstimatorKind,
    Installation,
    Needs,
    Probe,
    Samples,
    build_estimator,
)
from vsgdesign.identification.neural import NeuralEstimator, neural_estimator
from vsgdesign.runtime.guards import REASONS, STATUSES, SchedulerSettings, box_settings, settings_of, status_text
from vsgdesign.runtime.schedule import ClosedFormSchedule, Schedule, closed_form_schedule
from vsgdesign.runtime.scheduler import (
    Scheduler,
    closed_form_scheduler,
    load_neural_estimator,
    load_scheduler,
    scheduler_of,
)
from vsgdesign.runtime.table import TableSchedule, table_schedule
from vsgdesign.runtime.updating import Answer, GainLookup, gain_lookup

if TYPE_CHECKING:
    from vsgdesign.runtime.many import ManySchedulers
    from vsgdesign.runtime.power_controller import PowerController, guarded_step

_LATER = {
    "ManySchedulers": "many",
    "PowerController": "power_controller",
    "guarded_step": "power_controller",
}
"""What is imported when it is asked for, and its module here."""

__all__ = [
    "ESTIMATORS",
    "REASONS",
    "STATUSES",
    "Answer",
    "ClosedFormSchedule",
    "Estimate",
    "Estimator",
    "EstimatorKind",
    "GainLookup",
    "Installation",
    "ManySchedulers",
    "Needs",
    "NeuralEstimator",
    "PowerController",
    "Probe",
    "Samples",
    "Schedule",
    "Scheduler",
    "SchedulerSettings",
    "TableSchedule",
    "box_settings",
    "build_estimator",
    "closed_form_schedule",
    "closed_form_scheduler",
    "gain_lookup",
    "guarded_step",
    "load_neural_estimator",
    "load_scheduler",
    "neural_estimator",
    "scheduler_of",
    "settings_of",
    "status_text",
    "table_schedule",
]


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
