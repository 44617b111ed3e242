"""The table [controllers.knowledge]: how wrong and how late a controller knows its grid."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.parameters.fields import number
from vsgdesign.parameters.grid import Grid


@dataclass(frozen=True)
class GridEstimate:
    """What a scheduled controller without an estimator of its own knows of the grid."""

    error_R: float = number("1", -1.0, 10.0, default=0.0)
    """The controller takes R_g for R_g (1 + `error_R`)."""
    error_X: float = number("1", -0.99, 10.0, default=0.0)
    """The same of L_g."""
    silent_s: float = number("s", 0.0, 36000.0, default=0.0, name="silent")
    """After each change of the grid or its source it is told nothing for this long."""

    def of(self, grid: Grid) -> Grid:
        """The estimate of a grid."""
        return Grid(grid.R_g * (1.0 + self.error_R), grid.L_g * (1.0 + self.error_X))
