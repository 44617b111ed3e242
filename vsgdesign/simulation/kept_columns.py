"""A few columns of every sample of runs whose logs have fewer rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.apart import TakenApart
from vsgdesign.simulation.loop import LOG_COLUMNS, SEEN_COLUMNS, Build

Array = NDArray[np.float64]


class KeptColumns:
    """SEEN_COLUMNS of every sample of runs side by side, while they are logged.

    Each column has memory of its own. In one piece they would be too large for memory that later runs get again
    (:func:`vsgdesign.execution.executors.keep_memory`).
    """

    def __init__(self, count: int, samples: int, build: Build) -> None:
        self._columns = {name: np.empty((count, samples)) for name in SEEN_COLUMNS}
        places: Sequence[int] = [LOG_COLUMNS.index(name) for name in SEEN_COLUMNS]
        width = build.lanes * build.vectors
        self._apart = TakenApart(places, list(self._columns.values()), width, build.target)

    def take(self, begin: int, rows: Array) -> None:
        """The rows (1, n, m, L) of a log, of samples ``begin`` to ``begin`` + n − 1."""
        self._apart.take(begin, rows[0])

    def of(self, lane: int) -> dict[str, Array]:
        """The columns of a run, (samples,) each."""
        return {name: column[lane] for name, column in self._columns.items()}
