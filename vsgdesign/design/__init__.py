"""Specification to gains: in closed form today."""

from vsgdesign.design.closed_form import ClosedFormDesign, design_closed_form, distinct_grids

__all__ = ["ClosedFormDesign", "design_closed_form", "distinct_grids"]
