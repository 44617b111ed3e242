"""Where results wait until they are whole, in a hidden folder beside their place, and locks that die with a process."""

from __future__ import annotations

import errno
import glob
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

from vsgdesign.errors import ArtifactError

WINDOWS = os.name == "nt"
"""There no open file can be removed: a lock is given back before its file goes, and elsewhere after it."""

_SUFFIX = ".part"
_NEW, _OLD, _LOCK = "new", "old", "lock"
_LONGEST = 200
"""Bytes of a name that are taken over into the hidden one: names end at 255."""

_ADVICE = {
    errno.ENOSPC: "Free some space, or give a place on another disk.",
    errno.EDQUOT: "Remove what is no longer needed, or give a place on another disk.",
    errno.EFBIG: "Give a place that takes larger files.",
    errno.ENAMETOOLONG: "Give a shorter name.",
    errno.ELOOP: "Mend the link, or give another place.",
    errno.EBUSY: "It is a disk of its own; give a place within it.",
    errno.EXDEV: "It is a disk of its own; give a place within it.",
}
_ELSEWHERE = "Give a place that may be written to."
OF_THE_DISK = frozenset(_ADVICE) | {errno.EIO, errno.EROFS, errno.ESTALE}
"""What goes wrong while a file is written, and is neither the study's fault nor the program's."""


def cannot_write(target: str | Path, error: OSError) -> ArtifactError:
    """The one sentence for a place that could not be written to."""
    advice = _ADVICE.get(error.errno or 0, _ELSEWHERE)
    return ArtifactError(f'cannot write "{target}": {error.strerror or error}. {advice}')


def check_writable(folder: Path, shown: str | Path) -> None:
    """Before the long work: raises ArtifactError where nothing can be written to a folder, which may be missing yet."""
    there = next(parent for parent in (folder, *folder.parents) if os.path.lexists(parent))
    if not there.is_dir():
        raise ArtifactError(f'cannot write "{shown}": "{there}" is not a folder. {_ELSEWHERE}')
    if not os.access(there, os.W_OK | os.X_OK):
        raise ArtifactError(f'cannot write "{shown}": Permission denied in "{there}". {_ELSEWHERE}')


@contextmanager
def staged(target: Path, shown: str | Path) -> Iterator[Path]:
    """A path to write a file or folder at, which is moved to ``target`` when the block ends without an error.

    ``target`` has no symbolic links in it. What was there before is kept until the new one is in its place; after an
    error or an interruption it is as it was, and missing parents that were made are gone again. What processes left
    that were killed here earlier is removed, and what they had moved aside is put back. Raises ArtifactError, which
    calls the place ``shown``.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(parents_made(target.parent))
            _sweep(target)
            space = stack.enter_context(_space(target))
        except OSError as error:
            raise cannot_write(shown, error) from error
        try:
            yield space / _NEW
        except OSError as error:
            if error.errno in OF_THE_DISK:
                raise cannot_write(shown, error) from error
            raise
        try:
            _replace(space, target)
        except OSError as error:
            raise cannot_write(shown, error) from error


def _replace(space: Path, target: Path) -> None:
    if not target.is_dir():
        os.replace(space / _NEW, target)
        return
    # A folder cannot be renamed over a full one: the old moves aside first, and back if that fails.
    try:
        os.replace(target, space / _OLD)
        os.replace(space / _NEW, target)
    except BaseException:  # an interruption counts: the old results must not go with the folder they wait in
        _put_back(space, target)
        raise


def _put_back(space: Path, target: Path) -> None:
    if not os.path.lexists(target) and os.path.lexists(space / _OLD):
        os.replace(space / _OLD, target)


def hidden_prefix(target: Path) -> str:
    """How the hidden name of what waits beside a target begins."""
    name = target.name
    if len(os.fsencode(name)) > _LONGEST:
        name = hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
    return f".{name}."


@contextmanager
def _space(target: Path) -> Iterator[Path]:
    """A new hidden folder beside ``target``, on the same file system, locked; removed at the end."""
    with ExitStack() as held:
        while True:
            space = Path(tempfile.mkdtemp(_SUFFIX, hidden_prefix(target), target.parent))
            try:
                held.enter_context(locked(space / _LOCK, partial(_remove, space)))
                break
            except (LockedError, FileNotFoundError):
                continue  # somebody swept it between its making and its locking
        yield space


def _sweep(target: Path) -> None:
    """Remove what dead processes left of this target. Another's, or what cannot be judged, stays."""
    for space in sorted(target.parent.glob(f"{glob.escape(hidden_prefix(target))}*{_SUFFIX}")):
        with locked_by_the_dead(space / _LOCK) as dead:
            if dead:
                with suppress(OSError):
                    _put_back(space, target)
                    _remove(space)
        if dead and WINDOWS:  # the lock was open until here
            _remove(space)


def _remove(space: Path) -> None:
    """The lock goes last: what a kill leaves in between can still be swept."""
    for name in (_NEW, _OLD):
        path = space / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    shutil.rmtree(space, ignore_errors=True)


@contextmanager
def parents_made(folder: Path) -> Iterator[None]:
    """Missing folders are made; those that are still empty after an error are taken away again."""
    missing = [parent for parent in (folder, *folder.parents) if not os.path.lexists(parent)]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for parent in missing:
            with suppress(OSError):
                parent.rmdir()
        raise


class LockedError(Exception):
    """Another process holds the lock."""


@contextmanager
def locked(path: Path, tidy: Callable[[], object] | None = None) -> Iterator[None]:
    """Hold the lock file ``path`` within this block; it is made where it is missing, and stays unless ``tidy``, which
    is called at the end, removes it.

    The kernel gives the lock back when the process ends, also when it is killed; a process that only started
    beside it is never taken for it, as a process number could be. Raises LockedError at once where another holds it,
    OSError where the file cannot be made. A file system without locks has none: the block is entered.
    """
    with ExitStack() as end:
        stream = end.enter_context(path.open("ab"))
        # The one who held it may have removed the file in between: then what was locked is no longer this path.
        if _lock(stream.fileno()) is False or not _is(stream.fileno(), path):
            raise LockedError(str(path))
        if tidy is not None:
            end.callback(tidy)
        if WINDOWS:
            end.callback(stream.close)  # comes before
        yield


@contextmanager
def locked_by_the_dead(path: Path) -> Iterator[bool]:
    """Whether ``path`` is a lock file that nobody holds any more; within the block it is held here.

    No where there is no such file, and where the file system cannot say.
    """
    try:
        stream = path.open("r+b")
    except OSError:
        yield False
        return
    with stream:
        yield _lock(stream.fileno()) is True and _is(stream.fileno(), path)


def _lock(handle: int) -> bool | None:
    """Yes, no, or None where the file system has no locks."""
    from filelock import lock_descriptor  # here, because the runtime reads files with NumPy alone, and locks none

    try:
        return lock_descriptor(handle, blocking=False)
    except OSError:
        return None


def _is(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except OSError:
        return False
