"""How many examples a property is tried on: some in every run of the suite, always the same; many for the evidence."""

from __future__ import annotations

import os
from typing import Any

from hypothesis import settings

TIMES = int(os.environ.get("VSGDESIGN_EXAMPLES", "1"))
"""``python -m evidence properties`` sets it: so many times the examples, and other ones in every run."""

USUAL = 30
"""Examples of a property that names no number."""


def examples(count: int, **more: Any) -> settings:
    """The settings of a property that wants ``count`` examples in every run of the suite."""
    return settings(max_examples=TIMES * count, **more)


def load_profile() -> None:
    """No deadline: a machine that is busy is no fault of the code."""
    settings.register_profile("suite", derandomize=TIMES == 1, deadline=None, max_examples=TIMES * USUAL)
    settings.load_profile("suite")
