"""How stable, what limits it, and how it looks from the grid: modes, margins, maps, impedance."""

from vsgdesign.stability.margins import MarginTable, frequency_grid, full_order_margins, reduced_margins

__all__ = ["MarginTable", "frequency_grid", "full_order_margins", "reduced_margins"]
