"""What ships to the controller. Needs NumPy alone."""

from vsgdesign.runtime.closed_form import ClosedFormSchedule, closed_form_schedule

__all__ = ["ClosedFormSchedule", "closed_form_schedule"]
