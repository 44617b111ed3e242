"""The numbers of runs side by side, found by their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import LoopSpec, aligned_zeros
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.simulation.loop import spans_of

Array = NDArray[np.float64]


class Numbers:
    """Numbers of a loop for G groups of L runs, of which the first ``count`` are used.

    A number is found by its name, those of a record by the record's (``put("refs.P_ref", values)``). Behind the numbers
    of the loop there are others that nothing but the program writes (``kept``).
    """

    def __init__(self, spec: LoopSpec, count: int, kept: Mapping[str, int] | None = None) -> None:
        """``kept``: how many numbers are kept under which name."""
        self.spec, self.count = spec, count
        self.spans = spans_of(spec.rows)
        self.place = {name: row for row, name in enumerate(spec.rows)}
        self.kept: dict[str, int] = {}
        at = len(spec.rows)
        for name, numbers in (kept or {}).items():
            self.kept[name], at = at, at + numbers
        self.rows: Array = aligned_zeros((-(-count // spec.width), at, spec.width))
        """(G, R, L)."""

    def __len__(self) -> int:
        return self.count

    def span(self, name: str) -> slice:
        """The rows of a record or of a number."""
        return self.spans[name]

    def lane(self, run: int) -> tuple[int, int]:
        """Group and place in the group of a run."""
        return divmod(run, self.spec.width)

    def view(self, name: str, run: int = 0) -> Array:
        """The numbers of a record of one run as an array that moves with it."""
        group, lane = self.lane(run)
        return self.rows[group, self.spans[name], lane]

    def set(self, name: str, record: Any, run: int = 0) -> None:
        """Sets the numbers of a record of one run."""
        self.view(name, run)[:] = flat_state(record) if name == "state" else record

    def get(self, row: int | str) -> Array:
        """A row of every run, (n,)."""
        place = self.place[row] if isinstance(row, str) else row
        return self.rows[:, place, :].reshape(-1)[: self.count].copy()

    def put(self, row: int | str, values: Any) -> None:
        """Sets a row of every run, (n,), or m rows that are beside each other, (m, n).

        Places that are left in the last group take what the last run has.
        """
        values = np.asarray(values, dtype=float)
        values = values[None] if values.ndim == 1 else values
        groups, _, width = self.rows.shape
        first = self.spans[row].start if isinstance(row, str) else row
        to = self.rows[:, first : first + len(values)]
        whole = self.count // width
        to[:whole] = values[:, : whole * width].reshape(len(values), whole, width).swapaxes(0, 1)
        if whole < groups:
            rest = values[:, whole * width :]
            to[whole, :, : rest.shape[1]], to[whole, :, rest.shape[1] :] = rest, rest[:, -1:]
