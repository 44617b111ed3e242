"""Equilibrium, then linearisation: where the converter sits on a grid, and its power loops there."""

from vsgdesign.operating_point.equilibrium import OperatingPoint, solve_operating_point, solve_with_droop

__all__ = ["OperatingPoint", "solve_operating_point", "solve_with_droop"]
