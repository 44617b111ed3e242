"""Files that a user gives: regular files alone, of a size that their kind can have.

A pipe would wait, and a device would be read until memory ends. What is wrong is an OSError whose ``strerror`` is the
end of a sentence, as of every file that cannot be read.
"""

from __future__ import annotations

import errno
import os
import stat
import zipfile
from pathlib import Path
from typing import IO

MB = 10**6

TOML_BYTES = 1 * MB
"""Of a study, a suite, a recipe or a datasheet; each has a few kB."""

TABLE_BYTES = 20 * MB
"""Of a gain table and of designed inner loops."""

WEIGHTS_BYTES = 100 * MB
"""Of weights and measured errors."""

RESULT_BYTES = 500 * MB
"""Of a results.json, of counts and of a trace."""

RECORD_BYTES = 2000 * MB
"""Of a recorded voltage, and of what an archive holds unpacked."""

WINDOWS_BYTES = 20_000 * MB
"""Of a data set of windows."""


def open_given(path: str | Path, most_bytes: int) -> IO[bytes]:
    """A regular file, to be read. Raises OSError for anything else, and for one that is larger."""
    try:
        _check(os.stat(path), most_bytes)
    except ValueError:
        raise OSError(errno.EINVAL, "its name has a character that no name of a file has") from None
    stream = open(path, "rb", opener=_open_at_once)  # noqa: SIM115 - returned
    try:
        _check(os.fstat(stream.fileno()), most_bytes)  # another one may have taken its place
    except OSError:
        stream.close()
        raise
    return stream


def read_given(path: str | Path, most_bytes: int) -> bytes:
    """The bytes of a regular file, as :func:`open_given`."""
    with open_given(path, most_bytes) as stream:
        data = stream.read(most_bytes + 1)  # the system's own files say that they are empty
    if len(data) > most_bytes:
        raise _too_large("more", most_bytes)
    return data


def check_unpacked(stream: IO[bytes], most_bytes: int) -> None:
    """Whether a zip archive is small enough unpacked, too. Raises OSError and zipfile.BadZipFile."""
    with zipfile.ZipFile(stream) as archive:
        size = sum(one.file_size for one in archive.infolist())
    if size > most_bytes:
        raise _too_large(f"{size / MB:,.3g} MB unpacked", most_bytes)
    stream.seek(0)


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check(found: os.stat_result, most_bytes: int) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise OSError(errno.EISDIR, "it is a folder, and a file is needed")
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device, and a file is needed")
    if found.st_size > most_bytes:
        raise _too_large(f"{found.st_size / MB:,.3g} MB", most_bytes)


def _too_large(size: str, most_bytes: int) -> OSError:
    return OSError(errno.EFBIG, f"it has {size}, and the limit of its kind is {most_bytes / MB:,g} MB")
