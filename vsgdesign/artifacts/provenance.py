"""The provenance of a result: the versions of everything that influenced its numbers."""

from __future__ import annotations

import functools
import hashlib
import platform
from importlib import metadata
from pathlib import Path

from vsgdesign import __version__

_LIBRARIES = ("casadi", "clarabel", "cmaes", "control", "cvxpy", "llvmlite", "numba", "numpy", "scipy")


def provenance() -> dict[str, str]:
    """Versions by name."""
    return {"vsgdesign": __version__, "python": platform.python_version()} | _installed()


@functools.cache
def _installed() -> dict[str, str]:
    """Versions of the libraries by name, which reads a file for each: a design asks for every node."""
    return {name: metadata.version(name) for name in _LIBRARIES}


@functools.cache
def package_hash() -> str:
    """SHA-256 over the sources of this package: what an unfinished job was begun with."""
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root).as_posix()}\0".encode() + path.read_bytes())
    return digest.hexdigest()
