"""Linear algebra on one thread, where the last digit counts."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

from threadpoolctl import threadpool_limits


def one_thread() -> AbstractContextManager[Any]:
    """BLAS on one thread: its matrices here are tiny, other work has the other cores, and how a sum is shared among
    threads would decide its last digit. Libraries that are not loaded yet are not reached."""
    return threadpool_limits(1)
