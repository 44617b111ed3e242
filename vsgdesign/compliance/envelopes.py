"""Envelopes: two curves over time between which a signal of a test must stay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.compliance.trace import Trace

Array = NDArray[np.float64]


class Bounds(NamedTuple):
    """An envelope on the instants of a trace: arrays (n,), in the unit of the signal."""

    signal: str
    """Name of the field of :class:`Trace` that it bounds."""
    t_s: Array
    low: Array
    """-inf where nothing is asked."""
    high: Array
    """inf where nothing is asked."""

    def excess(self, trace: Trace) -> float:
        """By how much the signal leaves the envelope at most; 0 inside, NaN if the signal holds NaN."""
        values = np.asarray(getattr(trace, self.signal))
        beyond = np.maximum(np.maximum(self.low - values, values - self.high), 0.0)
        return float(np.max(beyond)) if beyond.size else 0.0
