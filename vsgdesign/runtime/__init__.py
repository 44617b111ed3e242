"""What ships to the controller. Needs NumPy alone."""

from vsgdesign.runtime.closed_form import ClosedFormSchedule, closed_form_schedule
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.runtime.table import TableSchedule, table_schedule

__all__ = ["ClosedFormSchedule", "Schedule", "TableSchedule", "closed_form_schedule", "table_schedule"]
