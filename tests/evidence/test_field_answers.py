"""Silence and false announcements of an estimator, on hand-made rows of 20 ms."""

from __future__ import annotations

import numpy as np
import pytest

from evidence._field_answers import false_changes, longest_silence, silence
from tests.metrics.test_answers import CHANGE, made


def test_silence() -> None:
    valid = np.ones(100, dtype=bool)
    valid[50:55] = False
    valid[60] = False
    answers = made(valid=valid)
    assert silence(answers, CHANGE, 2.0) == pytest.approx(5 * 0.02 + 0.02)
    assert longest_silence(answers, CHANGE, 2.0) == pytest.approx(0.1)
    assert longest_silence(answers, 1.05, 2.0) == pytest.approx(1.12 - 1.05)
    assert longest_silence(made(valid=False), 1.0, 2.0) == pytest.approx(1.0)


def test_false_changes() -> None:
    changed = np.zeros(100, dtype=bool)
    changed[[10, 55, 99]] = True  # 0.22, 1.12 and 2.00 s
    answers = made(changed=changed)
    assert false_changes(answers, 0.0, 2.01, [CHANGE]) == 1  # 2.00 s is 0.99 s after the change
    assert false_changes(answers, 0.0, 2.01, [CHANGE], after_s=0.5) == 2
    assert false_changes(answers, 0.5, 2.01, [CHANGE]) == 0
    assert false_changes(answers, 0.0, 2.01, []) == 3
