"""What ships to the controller. Needs NumPy alone."""

from vsgdesign.runtime.closed_form import ClosedFormSchedule

__all__ = ["ClosedFormSchedule"]
