"""Operating points of the converter on a grid, and linear models at them."""

from vsgdesign.linear.operating_point.equilibrium import OperatingPoint, solve_operating_point, solve_with_droop

__all__ = ["OperatingPoint", "solve_operating_point", "solve_with_droop"]
