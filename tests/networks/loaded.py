"""pandapower, which is loaded where a test runs: it takes two seconds, and every worker collects every test."""

from __future__ import annotations

import copy
import importlib
from functools import cache
from typing import Any


def pandapower() -> Any:
    """The library, with its networks."""
    importlib.import_module("pandapower.networks")
    return importlib.import_module("pandapower")


@cache
def _made(converters: str | None) -> Any:
    make = pandapower().networks.create_cigre_network_mv
    return make(with_der=converters) if converters else make()


def cigre(converters: str | None = None) -> Any:
    """The CIGRE network. It is made once: a copy takes a fifteenth of the time."""
    return copy.deepcopy(_made(converters))
