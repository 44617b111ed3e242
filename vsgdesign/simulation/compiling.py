"""Compiles the plain functions of ``equations`` with Numba, without a decorator in their source.

A function is rebuilt with every function of this project that it names replaced by its compiled twin, so the
text that Python and CasADi run is the text that LLVM gets.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import numba

_PACKAGE = Path(__file__).resolve().parent.parent
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}, "nogil": True}
_ROOMS = ("equations", "simulation")


@functools.cache
def compile_function(function: FunctionType, cache: bool = False) -> Callable[..., Any]:
    """The function, and every function of this package that it calls, compiled for speed.

    ``cache=True`` keeps the machine code on disk; only for the outermost function, through
    :func:`source_stamp`, so that a change anywhere in the compiled sources makes it stale.
    """
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        value = names.get(name)
        if isinstance(value, FunctionType) and value.__module__.startswith("vsgdesign."):
            names[name] = compile_function(value)
    rebuilt = FunctionType(function.__code__, names, function.__name__, function.__defaults__, function.__closure__)
    rebuilt.__module__ = function.__module__
    rebuilt.__qualname__ = function.__qualname__
    return numba.njit(cache=cache, **_OPTIONS)(rebuilt)


@functools.cache
def source_stamp() -> int:
    """A hash of every source file whose functions are compiled.

    Numba's disk cache looks at one file's date; a compiled loop is made of many files. A closure over this
    number is part of the cache key.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for room in _ROOMS:
        for path in sorted((_PACKAGE / room).glob("*.py")):
            digest.update(path.read_bytes())
    digest.update((_PACKAGE / "frames.py").read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")
