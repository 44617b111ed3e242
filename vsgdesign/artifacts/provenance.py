"""What made a result: the versions of everything that had a say in its numbers."""

from __future__ import annotations

import platform
from importlib import metadata

from vsgdesign import __version__

_LIBRARIES = ("casadi", "control", "numba", "numpy", "scipy")


def provenance() -> dict[str, str]:
    """Versions by name."""
    versions = {"vsgdesign": __version__, "python": platform.python_version()}
    return versions | {name: metadata.version(name) for name in _LIBRARIES}
