"""What ships to the controller. Needs NumPy alone."""

from vsgdesign.runtime.closed_form import ClosedFormSchedule, closed_form_schedule
from vsgdesign.runtime.network import Estimate, NeuralEstimator, load_neural_estimator, neural_estimator
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.runtime.table import TableSchedule, table_schedule

__all__ = [
    "ClosedFormSchedule",
    "Estimate",
    "NeuralEstimator",
    "Schedule",
    "TableSchedule",
    "closed_form_schedule",
    "load_neural_estimator",
    "neural_estimator",
    "table_schedule",
]
