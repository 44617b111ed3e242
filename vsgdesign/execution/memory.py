"""The memory of a process that makes and drops large arrays one after the other."""

from __future__ import annotations

import ctypes
import functools
import gc
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of mallopt in malloc.h of the GNU C library."""
_USUAL = 128 * 1024
"""Bytes, of both, that the library has without a word."""
_LARGE, _MOST = 32 * 2**20, 2**31 - 1
"""Arrays of so many bytes still get memory of their own: between smaller ones they would leave holes."""


def keep_memory() -> None:
    """From now on large arrays get the memory of those that have been dropped.

    Without it, the C library gives the memory of arrays of 0.1 to 32 MB back, and the system fills it with zeros before
    the next one has it. Objects that are there already are not searched for circles of references any more. Only the
    GNU C library is told; elsewhere the first part does nothing.
    """
    gc.freeze()
    if (library := _gnu()) is not None:
        library.mallopt(_MMAP_THRESHOLD, _LARGE)
        library.mallopt(_TRIM_THRESHOLD, _MOST)


def give_memory_back() -> None:
    """What :func:`keep_memory` has kept goes back, and all is as before."""
    gc.unfreeze()
    if (library := _gnu()) is not None:
        library.mallopt(_MMAP_THRESHOLD, _USUAL)
        library.mallopt(_TRIM_THRESHOLD, _USUAL)
        library.malloc_trim(0)


@functools.cache
def _gnu() -> ctypes.CDLL | None:
    """The GNU C library; None for another one."""
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return (
        library if all(hasattr(library, name) for name in ("mallopt", "malloc_trim", "gnu_get_libc_version")) else None
    )
