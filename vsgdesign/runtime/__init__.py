"""What ships to the controller. Needs NumPy alone."""

from vsgdesign.runtime.closed_form import ClosedFormSchedule, closed_form_schedule
from vsgdesign.runtime.guards import REASONS, STATUSES, SchedulerSettings, box_settings, settings_of, status_text
from vsgdesign.runtime.lookup import GainLookup, gain_lookup
from vsgdesign.runtime.network import Estimate, NeuralEstimator, load_neural_estimator, neural_estimator
from vsgdesign.runtime.power_controller import PowerController
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.runtime.scheduler import Answer, Scheduler, closed_form_scheduler, load_scheduler, scheduler_of
from vsgdesign.runtime.table import TableSchedule, table_schedule

__all__ = [
    "REASONS",
    "STATUSES",
    "Answer",
    "ClosedFormSchedule",
    "Estimate",
    "GainLookup",
    "NeuralEstimator",
    "PowerController",
    "Schedule",
    "Scheduler",
    "SchedulerSettings",
    "TableSchedule",
    "box_settings",
    "closed_form_schedule",
    "closed_form_scheduler",
    "gain_lookup",
    "load_neural_estimator",
    "load_scheduler",
    "neural_estimator",
    "scheduler_of",
    "settings_of",
    "status_text",
    "table_schedule",
]
