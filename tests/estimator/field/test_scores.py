"""The three ways on made-up cycles: the gate opens when it may, and the figures are those of the hand-made answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimator.field.made_up import EVENT, PER_RUN, made_up_cycles
from vsgdesign.artifacts.field_weights import FieldLayers
from vsgdesign.equations.field_fusion import GateLimits
from vsgdesign.estimator.field.cycles import FieldCycles
from vsgdesign.estimator.field.scores import field_scores, speaking, streams

GATE = GateLimits(first=4.0, first_refuted=2.0, last=6.0, confident=0.15)
RADII = dict.fromkeys(("learning", "tracking", "doubt"), 5.991464547107979)


def oracle(deviation: float = 0.05) -> FieldLayers:
    """Layers that pass the first two features through: tanh of a small number is that number."""
    small = 1e-4
    first = np.zeros((2, 4))
    first[0, 0] = first[1, 1] = small
    last = np.zeros((5, 2))
    last[0, 0] = last[1, 1] = 1.0 / small
    bias = np.array([0.0, 0.0, np.log(deviation), np.log(deviation), 0.0])
    return FieldLayers(
        mean=np.zeros(4),
        deviation=np.ones(4),
        W_1=first,
        b_1=np.zeros(2),
        W_2=np.eye(2),
        b_2=np.zeros(2),
        W_3=last,
        b_3=bias,
    )


@pytest.fixture(scope="module")
def cycles() -> FieldCycles:
    return made_up_cycles(runs=30)


def test_gate_opens_after_the_flag_alone(cycles: FieldCycles) -> None:
    open_ = speaking(cycles, GATE).reshape(-1, PER_RUN)
    expected = np.zeros(PER_RUN, dtype=bool)
    flag = EVENT + 1
    expected[flag + 4 : flag + 7] = True
    assert (open_ == expected).all()
    refuted = replace(cycles, refuted=np.ones(len(cycles), dtype=bool))
    expected[flag + 2 : flag + 4] = True
    assert (speaking(refuted, GATE).reshape(-1, PER_RUN) == expected).all()


def test_gated_is_physics_elsewhere(cycles: FieldCycles) -> None:
    found = streams(cycles, oracle(), RADII, GATE)
    closed = ~speaking(cycles, GATE)
    assert np.array_equal(found["gated"].estimate[closed], found["physics"].estimate[closed])
    assert np.array_equal(found["gated"].valid[closed], found["physics"].valid[closed])
    assert np.array_equal(found["gated"].estimate[~closed], found["ungated"].estimate[~closed])
    assert found["gated"].valid[~closed].all()


def test_figures(cycles: FieldCycles) -> None:
    scores = field_scores(cycles, oracle(), RADII, GATE)
    physics, gated, ungated = (scores[way]["jump"] for way in ("physics", "gated", "ungated"))
    assert physics.changes == 30
    # Five cycles after the jump the recursions are silent, and the network behind its gate has answered since.
    assert physics.valid_share[0] == 0.0
    assert gated.valid_share[0] == 1.0
    assert gated.error_p95[0] < 0.3 < physics.error_p95[0]
    # The held answer turns right in the cycle 8 after the jump, which ends 0.17 s after it; the answers of the network
    # have a deviation of 5 % each, so most stay within 10 % from its first cycle on, 0.11 s after the jump.
    assert physics.t10_s[0] == pytest.approx(0.17)
    # In the cycle of the jump the recursions still hold the old grid and are valid: from 40 ms on, nothing is wrong.
    assert physics.wrong_s == 0.0
    assert ungated.wrong_s >= 0.0
    # A Gaussian error with the stated deviation is inside its 95 % ellipse 95 % of the time; here the deviation is
    # a mixture about 5 %, which covers 90 to 95 %.
    assert 0.85 < ungated.coverage["from 20"] < 0.97


def test_groups_without_changes_are_empty(cycles: FieldCycles) -> None:
    empty = field_scores(cycles, oracle(), RADII, GATE)["physics"]["grid_step"]
    assert empty.changes == 0
    assert np.isnan(empty.error_p95).all()
