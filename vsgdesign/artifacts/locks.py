"""Locks that die with their process, whatever ends it and on whatever host it ran."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # not POSIX: nothing is locked there, and nothing is taken for dead
    fcntl = None


class LockedError(Exception):
    """Another process holds the lock."""


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock file ``path`` within this block; it is made where it is missing, and stays.

    The kernel gives the lock back when the process ends, also when it is killed; a process that only started
    beside it is never taken for it, as a process number could be. Raises LockedError at once where another holds it,
    OSError where the file cannot be made. A file system without locks has none: the block is entered.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        # The one who held it may have removed the file in between: then what was locked is no longer this path.
        if _lock(handle) is False or not _is(handle, path):
            raise LockedError(str(path))
        yield
    finally:
        os.close(handle)


@contextmanager
def locked_by_the_dead(path: Path) -> Iterator[bool]:
    """Whether ``path`` is a lock file that nobody holds any more; within the block it is held here.

    No where there is no such file, and where the file system cannot say.
    """
    try:
        handle = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        yield False
        return
    try:
        yield _lock(handle) is True and _is(handle, path)
    finally:
        os.close(handle)


def _lock(handle: int) -> bool | None:
    """Yes, no, or None where the file system has no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _is(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except OSError:
        return False
