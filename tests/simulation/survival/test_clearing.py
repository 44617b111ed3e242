"""The critical clearing time, of converters whose limit is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from vsgdesign.simulation.survival.verdicts import LENGTHS_S, FaultsOf, Verdicts, critical_clearing_times

Array = NDArray[np.float64]


def lost_within(*ranges: tuple[tuple[float, float], ...]) -> tuple[FaultsOf, list[tuple[int, float]]]:
    """Cells that lose the faults whose length lies in one of their ranges; (cell, length) of every fault tried."""
    tried: list[tuple[int, float]] = []

    def faults_of(index: NDArray[np.intp], length_s: Array) -> Verdicts:
        pairs = [(int(cell), float(length)) for cell, length in zip(index, length_s, strict=True)]
        tried.extend(pairs)
        held = [not any(low < length <= high for low, high in ranges[cell]) for cell, length in pairs]
        return Verdicts(np.ones(len(pairs), dtype=bool), np.array(held, dtype=bool))

    return faults_of, tried


def test_every_cell_has_its_own_to_the_resolution() -> None:
    limits = (0.0123, 0.26, 1.234)
    found = critical_clearing_times(lost_within(*(((limit, 9.0),) for limit in limits))[0], 3)
    assert found.bounded.all()
    assert found.longest_s == pytest.approx(limits, abs=0.005)
    assert (found.longest_s <= limits).all()


def test_the_first_loss_counts() -> None:
    faults_of, _ = lost_within(((0.16, 0.25), (2.5, 9.0)))
    assert critical_clearing_times(faults_of, 1).longest_s == pytest.approx([0.16], abs=0.005)


def test_nothing_lost_is_said_after_every_length_once() -> None:
    faults_of, tried = lost_within(())
    found = critical_clearing_times(faults_of, 1)
    assert found.longest_s.tolist() == [LENGTHS_S[-1]]
    assert not found.bounded.any()
    assert [length for _, length in tried] == list(LENGTHS_S)


def test_nothing_survived_is_zero() -> None:
    found = critical_clearing_times(lost_within(((0.0, 9.0),))[0], 1)
    assert found.longest_s.tolist() == [0.0]
    assert found.bounded.all()


def test_a_length_beyond_a_loss_is_tried_within_the_shorter_half_alone() -> None:
    faults_of, tried = lost_within(((0.16, 9.0),), ((0.8, 0.9), (2.5, 9.0)))
    found = critical_clearing_times(faults_of, 2)
    assert found.longest_s == pytest.approx([0.16, 2.5], abs=0.005)
    half = len(LENGTHS_S) // 2
    assert max(length for cell, length in tried if cell == 0) == LENGTHS_S[half - 1]
    assert [length for cell, length in tried if cell == 1][: len(LENGTHS_S)] == list(LENGTHS_S)


def test_a_cell_without_a_verdict_has_no_time_and_is_not_tried_again() -> None:
    tried: list[tuple[int, float]] = []

    def faults_of(index: NDArray[np.intp], length_s: Array) -> Verdicts:
        tried.extend(zip(index.tolist(), length_s.tolist(), strict=True))
        return Verdicts(index != 0, np.zeros(len(index), dtype=bool) | (length_s < 0.1))

    found = critical_clearing_times(faults_of, 2)
    assert np.isnan(found.longest_s[0])
    assert found.longest_s[1] == pytest.approx(0.1, abs=0.005)
    assert [length for cell, length in tried if cell == 0] == list(LENGTHS_S[: len(LENGTHS_S) // 2])
