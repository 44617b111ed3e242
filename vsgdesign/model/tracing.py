"""Lets the plain NumPy equations run on CasADi symbols."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import casadi as ca


@contextmanager
def numpy_on_symbols() -> Iterator[None]:
    """Within this block ``np.sin(SX)`` and friends build CasADi expressions. The global mode is put back."""
    before = ca.GlobalOptions.getNumpyMode()
    ca.GlobalOptions.setNumpyMode(1)
    try:
        yield
    finally:
        ca.GlobalOptions.setNumpyMode(before)
