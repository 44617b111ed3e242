"""The [survival] section: which disturbances a study sends its controllers through."""

from __future__ import annotations

from vsgdesign.parameters.fields import SEEDS, section, whole


@section
class SurvivalSpec:
    """Random disturbances beside the systematic ones."""

    random: int = whole(0, 1_000_000, default=600)
    """Number of random disturbances."""
    seed: int = whole(0, SEEDS, default=1)
    """Seed of their draw."""
