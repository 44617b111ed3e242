"""Reads [controllers.knowledge]: how wrong and how late a controller knows its grid."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.reader import TableReader


@dataclass(frozen=True)
class GridEstimate:
    """What a scheduled controller without an estimator of its own is told of the grid."""

    error_R: float = 0.0
    error_X: float = 0.0
    """Errors of the estimate, relative, at all times: it is R_g (1 + error_R) and L_g (1 + error_X)."""
    silent_s: float = 0.0
    """After every change of the grid or its source nothing is told for this long, s."""

    def of(self, grid: Grid) -> Grid:
        """The estimate of a grid."""
        return Grid(grid.R_g * (1.0 + self.error_R), grid.L_g * (1.0 + self.error_X))


def read_knowledge(table: TableReader | None) -> GridEstimate | None:
    """The table, None where there is none."""
    if table is None:
        return None
    found = GridEstimate(
        error_R=table.quantity("error_R", "1", -1.0, 10.0, default=0.0),
        error_X=table.quantity("error_X", "1", -0.99, 10.0, default=0.0),
        silent_s=table.quantity("silent", "s", 0.0, 36000.0, default=0.0),
    )
    table.finish()
    return found
