"""From runs of the field estimator to the errors that the package ships: a gain table's page holds them against its
error set."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._field_summary import RESTS, Array, Row, at_rest, between, of
from vsgdesign.artifacts.measured_errors import GridBin, JumpInstant, MeasuredErrors
from vsgdesign.artifacts.provenance import provenance

SCR = (1.2, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)
X_OVER_R = (0.3, 1.0, 3.0, 10.0, 20.0)
"""Limits of the ranges of grids."""

MOST = 400
"""Answers of a range, and jumps, that are kept."""

CYCLES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 25, 30, 40, 50)
"""Answers since a jump that are kept."""

_DIGITS = 4


def measured_errors(rows: Sequence[Row], seed: int) -> MeasuredErrors:
    """The errors at rest by ranges of the grid, and those of the answers after a jump of the grid over all grids."""
    rest = of(rows, *RESTS)
    answers = at_rest(rest)
    bins = [_bin(rest, answers, scr, x_over_r) for scr in pairwise(SCR) for x_over_r in pairwise(X_OVER_R)]
    return MeasuredErrors(
        estimator="field",
        converters=tuple(dict.fromkeys(row["converter"] for row in rows)),
        background="a drawn background of a real grid with noise, harmonics, unbalance and sensors, switched bridge",
        runs=len(rest) + len(of(rows, "jump")),
        seed=seed,
        bins=tuple(one for one in bins if one.answers),
        jumps=_since(of(rows, "jump")),
        provenance=provenance(),
    )


def _bin(rest: Sequence[Row], answers: Array, scr: tuple[float, float], x_over_r: tuple[float, float]) -> GridBin:
    mine = between(answers, scr, x_over_r)
    grids = np.array([(row["scr"][0], row["x_over_r"][0]) for row in rest]).reshape(-1, 2)
    runs = len(between(grids, scr, x_over_r))
    valid = float(np.mean(mine[:, 5])) if len(mine) else 0.0
    return GridBin(scr, x_over_r, runs, len(mine), round(valid, _DIGITS), _thinned(mine[:, 2:5]))


def _since(jumps: Sequence[Row]) -> tuple[JumpInstant, ...]:
    """Answers k after a jump act from the end of their cycle on. Cycles of 50 and of 60 Hz count alike, at 50 Hz's
    time: the later one."""
    chosen = [row for row in jumps if len(row.get("after", ())) >= max(CYCLES)]
    chosen = [chosen[k] for k in _evenly(len(chosen))]
    if not chosen or len(chosen[0]["after"][0]) < 6:
        return ()
    longest = max(row["cycle_s"] for row in chosen)
    return tuple(
        JumpInstant(round(k * longest, 6), _rounded([row["after"][k - 1][3:6] for row in chosen])) for k in CYCLES
    )


def _thinned(values: Array) -> Array:
    return _rounded(values[_evenly(len(values))])


def _rounded(values: Any) -> Array:
    return np.asarray(np.round(np.asarray(values, dtype=np.float64), _DIGITS), dtype=np.float64)


def _evenly(count: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(np.int64)) if count else np.arange(0)
