"""A hash of the sources that decide about the numbers of a simulation."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent
_ROOMS = ("equations", "simulation")


@functools.cache
def source_stamp() -> int:
    """The hash of every source file of the equations and the simulation: data that was simulated with others is
    stale."""
    digest = hashlib.sha256()
    for room in _ROOMS:
        for path in sorted((_PACKAGE / room).rglob("*.py")):
            digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")
