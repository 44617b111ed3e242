"""Fewer rows of a trace for its file: close together after each event, and far apart where little happens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.compliance.evidence import Evidence
from vsgdesign.compliance.trace import Trace

Array = NDArray[np.float64]

BEFORE_S, AFTER_S = 0.02, 0.15
"""Around each event every row is kept: from so long before it to so long after it, s."""

REST_S = 5e-3
"""Elsewhere one row is kept in so many seconds."""

LARGEST, MEAN = ("i_s_pu", "i_phase_pu"), ("P_dc_pu", "limited")
"""Columns of which a kept row has the largest, or the mean, of itself and of the rows left out before it."""


def thinned(evidence: Evidence, events_s: Sequence[float]) -> Evidence:
    """The evidence with fewer rows. All other columns have their value at the instant of the row."""
    trace = evidence.trace
    t, rows = trace.t_s, len(trace.t_s)
    if rows < 3:
        return evidence
    step = float(t[-1] - t[0]) / (rows - 1)
    keep = np.zeros(rows, dtype=bool)
    keep[:: max(round(REST_S / step), 1)] = True
    keep[-1] = True
    for event_s in events_s:
        keep |= (t >= event_s - BEFORE_S - 0.5 * step) & (t <= event_s + AFTER_S + 0.5 * step)
    kept = np.flatnonzero(keep)
    begins = np.concatenate(([0], kept[:-1] + 1))
    counts = np.diff(np.append(begins, kept[-1] + 1))
    columns: dict[str, Array] = {}
    for name, values in vars(trace).items():
        if name in LARGEST:
            columns[name] = np.maximum.reduceat(values, begins)
        elif name in MEAN:
            columns[name] = np.add.reduceat(values, begins) / counts
        else:
            columns[name] = values[kept]
    limits = tuple(replace(one, low=one.low[kept], high=one.high[kept]) for one in evidence.limits)
    return Evidence(trace=Trace(**columns), limits=limits)
