"""What was compiled before, kept in a folder of the user for the next process."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import sys
from pathlib import Path

FOLDER = "VSGDESIGN_CACHE"
"""The environment variable that names the folder in place of the usual one. Empty: nothing is kept."""

LARGEST_BYTES = 200e6
"""What was not used for the longest time is deleted beyond."""

_HASH = hashlib.sha256().digest_size

_OURS = re.compile(r"[0-9a-f]{64}(\.\d+)?")
"""Names of files that a store writes: a key, and while it is written the process that does."""


class Store:
    """Contents by the hash of what they follow from, a key of 64 hexadecimal digits. Nothing here is an error: what
    cannot be kept is made again. Other files of the folder are left alone."""

    def __init__(self, folder: Path) -> None:
        """Raises OSError where the folder cannot be made."""
        self._folder, self._swept = folder, False
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)

    def get(self, key: str) -> bytes | None:
        """What is kept under a name; None if nothing is, or if it is not as it was written."""
        place = self._folder / key
        try:
            found = place.read_bytes()
            os.utime(place)
        except OSError:
            return None
        content = found[_HASH:]
        return content if hashlib.sha256(content).digest() == found[:_HASH] else None

    def put(self, key: str, content: bytes) -> None:
        """Keeps it: completely or, where there is no room, not at all."""
        if not self._swept:
            self.sweep()
        place = self._folder / f"{key}.{os.getpid()}"
        try:
            place.write_bytes(hashlib.sha256(content).digest() + content)
            os.replace(place, self._folder / key)
        except OSError:
            with contextlib.suppress(OSError):
                place.unlink(missing_ok=True)

    def sweep(self) -> None:
        """Deletes what is too much of what a store has written, what was not used for the longest time first."""
        size, self._swept = 0.0, True
        with contextlib.suppress(OSError):
            ours = [place for place in self._folder.iterdir() if _OURS.fullmatch(place.name)]
            for place in sorted(ours, key=_last_used, reverse=True):
                with contextlib.suppress(OSError):  # another process was faster
                    size += place.stat().st_size
                    if size > LARGEST_BYTES:
                        place.unlink()


def _last_used(place: Path) -> float:
    try:
        return place.stat().st_mtime
    except OSError:
        return 0.0


def user_store() -> Store | None:
    """Where machine code is kept; None where nothing is to be kept, or nothing can be."""
    return _store(os.path.expanduser(os.environ.get(FOLDER, _usual_folder())))


@functools.cache
def _store(folder: str) -> Store | None:
    if not folder:
        return None
    try:
        return Store(Path(folder))
    except OSError:
        return None


def _usual_folder() -> str:
    """Where this system has what programs keep; empty for a user without a home."""
    at = {"win32": "LOCALAPPDATA", "darwin": ""}.get(sys.platform, "XDG_CACHE_HOME")
    usual = "~/Library/Caches" if sys.platform == "darwin" else "~/.cache"
    place = os.path.expanduser(os.environ.get(at) or usual)
    return "" if place.startswith("~") else os.path.join(place, "vsgdesign", "machine-code")
