"""From runs to the file of measured errors that the package ships."""

from __future__ import annotations

from typing import Any

import numpy as np

from evidence.field import JUMP_CYCLES, MOST, measured_errors


def rest(scr: float, x_over_r: float, answers: int, off: float) -> dict[str, Any]:
    R = 1.0 / np.hypot(1.0, x_over_r)
    found = [[off, -off, R, float(k % 10 > 0), 1.0] for k in range(answers)]
    return {"group": "rest", "converter": "one", "scr": [scr, scr], "x_over_r": [x_over_r, x_over_r], "rest": found}


def jump(cycle_s: float, cycles: int) -> dict[str, Any]:
    after = [[1.0 / (k + 1), 1.0, 1.0, 1.0 / (k + 1), 0.0, 0.5] for k in range(cycles)]
    return {"group": "jump", "converter": "two", "cycle_s": cycle_s, "after": after}


def test_answers_are_pooled_by_their_grid_and_thinned() -> None:
    rows = [rest(1.5, 2.0, 300, 0.01), rest(1.6, 2.5, 300, 0.02), rest(15.0, 5.0, 20, 0.03)]
    found = measured_errors(rows, seed=7)
    by_grid = {(one.scr, one.x_over_r): one for one in found.bins}
    assert set(by_grid) == {((1.2, 2.0), (1.0, 3.0)), ((12.0, 20.0), (3.0, 10.0))}
    one = by_grid[(1.2, 2.0), (1.0, 3.0)]
    assert (one.runs, one.answers, len(one.errors), one.valid) == (2, 600, MOST, 0.9)
    np.testing.assert_allclose(np.mean(one.errors[:, 0]), 0.015, atol=1e-4)
    np.testing.assert_allclose(one.errors[0], [0.01, -0.01, 0.4472], atol=1e-4)
    assert (found.seed, found.runs, found.jumps) == (7, 3, ())


def test_instants_after_a_jump_are_the_ends_of_cycles() -> None:
    """Of 50 and of 60 Hz at once: the later one. A run that ends too early is left out."""
    found = measured_errors([jump(0.02, 60), jump(1.0 / 60.0, 60), jump(0.02, 10)], seed=0)
    assert [one.t_s for one in found.jumps] == [round(0.02 * k, 6) for k in JUMP_CYCLES]
    assert [len(one.errors) for one in found.jumps] == [2] * len(JUMP_CYCLES)
    np.testing.assert_allclose([one.errors[0, 0] for one in found.jumps], [1.0 / k for k in JUMP_CYCLES], atol=1e-4)
