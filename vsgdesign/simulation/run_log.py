"""The log of a run: a row for every n-th sample, and the first states of the controller."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.loop import LOG_COLUMNS, SENSED_COLUMNS, PieceRows, RunLoop
from vsgdesign.simulation.outcome import good_rows

Array = NDArray[np.float64]


class RunLog:
    """The log of a run: a row for every ``every``-th sample, and the controller's states in the first ``states``
    samples."""

    def __init__(
        self, samples: int, every: int, states: int, like: ControllerState, *, sensed: bool, more: int = 0
    ) -> None:
        """``more``: how many states the circuit has besides those of LOG_COLUMNS."""
        self._every, self._sensed = every, len(SENSED_COLUMNS) if sensed else 0
        self._columns = len(LOG_COLUMNS) + self._sensed + more
        self._whole = np.empty((-(-samples // every), self._columns))
        self._with_states = np.empty((states, self._columns + len(flat_state(like))))
        self._length = len(self._whole)

    @property
    def rows(self) -> Array:
        """(n, len(LOG_COLUMNS))."""
        return self._whole[: self._length, : len(LOG_COLUMNS)]

    @property
    def sensed(self) -> Array:
        """(n, 4): what the sensors say of the capacitor node's voltage and of i_g; (0, 4) where they are ideal."""
        found = self._whole[: self._length, len(LOG_COLUMNS) : len(LOG_COLUMNS) + self._sensed]
        return found if self._sensed else np.empty((0, len(SENSED_COLUMNS)))

    @property
    def more(self) -> Array:
        """(n, m): the circuit's other states."""
        return self._whole[: self._length, len(LOG_COLUMNS) + self._sensed :]

    @property
    def states(self) -> Array:
        """The controller's states, a row for each of the first samples."""
        return self._with_states[: self._length * self._every, self._columns :].copy()

    def run(self, loop: RunLoop, begin: int, end: int, fed: Array | None) -> int:
        """Runs samples ``begin`` to ``end`` − 1, or fewer. Returns how many."""
        asked = len(self._with_states)
        if begin >= asked:
            return loop.advance(begin, end, self._whole, self._every, fed)
        done = loop.advance(begin, min(end, asked), self._with_states, 1, fed, states=True)
        first = -(-begin // self._every)
        last = -(-(begin + done) // self._every)
        at = slice(first * self._every, begin + done, self._every)
        self._whole[first:last] = self._with_states[at, : self._columns]
        return done

    def run_in_pieces(self, loop: RunLoop, sample: int, pieces: list[PieceRows], fed: Array) -> None:
        """Runs one sample whose interval is in pieces."""
        due = sample % self._every == 0
        with_states = sample < len(self._with_states)
        row = self._with_states[sample] if with_states else np.empty(self._columns)
        loop.advance_in_pieces(pieces, row, fed, states=with_states)
        if due:
            self._whole[sample // self._every] = row[: self._columns]

    def good(self, study: Study, begin: int, end: int) -> int:
        """How many rows come before the first one among those of samples ``begin`` to ``end`` − 1 that has diverged."""
        first, last = -(-begin // self._every), -(-end // self._every)
        return first + good_rows(study, self.rows[first:last])

    def end(self, rows: int) -> None:
        """The log ends after so many rows."""
        self._length = rows
