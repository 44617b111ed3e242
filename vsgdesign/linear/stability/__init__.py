"""Stability of a controller on a grid: modes, margins, maps, and the impedance as seen from the grid."""

from vsgdesign.linear.stability.margins import MarginTable, frequency_grid, full_order_margins, reduced_margins

__all__ = ["MarginTable", "frequency_grid", "full_order_margins", "reduced_margins"]
