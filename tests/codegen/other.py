"""A function and a record whose names another module has, too."""

from __future__ import annotations

from typing import Any, NamedTuple


class Pair(NamedTuple):
    """Another record of the same name."""

    left: Any
    right: Any


def joined(pair: Pair) -> Any:
    return pair.left + pair.right


def half(x: Any) -> Any:
    """Not quite."""
    return 0.501 * x
