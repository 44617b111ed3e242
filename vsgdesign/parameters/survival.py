"""Reads the [survival] section: which disturbances a study sends its controllers through."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.parameters.reader import TableReader


@dataclass(frozen=True)
class SurvivalSpec:
    """Random disturbances beside the systematic ones."""

    random: int = 600
    """How many there are."""
    seed: int = 1
    """Seed of their draw."""


def read_survival(table: TableReader | None) -> SurvivalSpec:
    """The section, or its defaults."""
    default = SurvivalSpec()
    if table is None:
        return default
    spec = SurvivalSpec(
        random=table.integer("random", 0, 1_000_000, default=default.random),
        seed=table.integer("seed", 0, 2**31 - 1, default=default.seed),
    )
    table.finish()
    return spec
