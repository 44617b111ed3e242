"""Lets the plain NumPy equations run on CasADi symbols."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import casadi as ca

_ONE_AT_A_TIME = threading.RLock()
"""CasADi's mode belongs to the whole process: another thread would put it back in the middle of this one's block."""


@contextmanager
def numpy_on_symbols() -> Iterator[None]:
    """Within this block ``np.sin(SX)`` and friends build CasADi expressions. The global mode is put back.

    Another thread that comes to such a block waits until this one has left it.
    """
    with _ONE_AT_A_TIME:
        before = ca.GlobalOptions.getNumpyMode()
        ca.GlobalOptions.setNumpyMode(1)
        try:
            yield
        finally:
            ca.GlobalOptions.setNumpyMode(before)
