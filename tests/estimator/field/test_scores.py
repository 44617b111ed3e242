"""The three ways on made-up cycles: the gate opens when it may, and the figures are those of the hand-made answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.estimator.field.made_up import EVENT, PER_RUN, made_up_cycles
from vsgdesign.artifacts.field_weights import MODES, FieldLayers
from vsgdesign.equations.field import TRACK, FieldAnswer
from vsgdesign.equations.field.fusion import GateLimits
from vsgdesign.estimator.data_set import FieldCycles
from vsgdesign.estimator.scores import answers_of_ways, field_scores

GATE = GateLimits(first=4.0, first_refuted=2.0, last=6.0, confident=0.15)
RADII: dict[str, float] = dict.fromkeys(MODES, 5.991464547107979)


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
    flag = EVENT + 1
    for refuted, first in ((False, 4), (True, 2)):
        with_it = replace(cycles, refuted=np.full(len(cycles), refuted))
        found = answers_of_ways(with_it, oracle(0.005), RADII, GATE)
        spoke = (found["gated"] != found["physics"]).any(axis=1).reshape(-1, PER_RUN)
        expected = np.zeros(PER_RUN, dtype=bool)
        expected[flag + first : flag + 7] = True
        assert (spoke == expected).all()
        assert np.array_equal(found["gated"][:, :6][spoke.ravel()], found["ungated"][:, :6][spoke.ravel()])
        assert (found["gated"][spoke.ravel(), 6] == 1.0).all()


def test_a_change_is_announced_once(cycles: FieldCycles) -> None:
    gated = answers_of_ways(cycles, oracle(), RADII, GATE)["gated"]
    changed = gated[:, FieldAnswer._fields.index("changed")].reshape(-1, PER_RUN)
    assert changed.sum(axis=1).max() == 1.0
    # All but near jumps (a factor within four deviations of one) are announced, in the first cycle of the network.
    assert changed[:, EVENT + 5].mean() > 0.8
    assert changed.sum() == changed[:, EVENT + 5 : EVENT + 8].sum()


def test_nothing_is_said_in_a_limited_cycle(cycles: FieldCycles) -> None:
    limited = cycles.answer.copy()
    limited[:, FieldAnswer._fields.index("limited")] = 0.4
    found = answers_of_ways(replace(cycles, answer=limited), oracle(), RADII, GATE)
    assert np.array_equal(found["gated"], limited)
    valid = FieldAnswer._fields.index("valid")
    assert (found["ungated"][:, valid] == 0.0).all()


def test_a_valid_answer_of_the_recursions_is_left_alone(cycles: FieldCycles) -> None:
    sure = cycles.answer.copy()
    sure[:, FieldAnswer._fields.index("valid")] = 1.0
    assert np.array_equal(answers_of_ways(replace(cycles, answer=sure), oracle(0.005), RADII, GATE)["gated"], sure)


def test_a_network_that_is_less_sure_widens_the_covariance(cycles: FieldCycles) -> None:
    """With 5 % of deviation in size and angle, σ is 7 % of |Z|, a little more at the PCC; the impedance is kept."""
    found = answers_of_ways(cycles, oracle(), RADII, GATE)
    tracking = cycles.mode == TRACK
    before, after = (FieldAnswer(*found[way][tracking].T) for way in ("physics", "gated"))
    assert np.array_equal(before.R_g, after.R_g)
    assert np.array_equal(before.L_g, after.L_g)
    assert (after.valid == 1.0).all()
    assert np.median(after.sigma) == pytest.approx(0.05 * np.sqrt(2.0), rel=0.15)
    lost = FieldAnswer(*answers_of_ways(cycles, oracle(0.3), RADII, GATE)["gated"][tracking].T)
    assert (lost.valid == 0.0).all()


def test_figures(cycles: FieldCycles) -> None:
    scores = field_scores(cycles, oracle(), RADII, GATE)
    physics, gated, ungated = (scores[way]["jump"] for way in ("physics", "gated", "ungated"))
    # All changes are jumps; those of |Z_g| by less than a factor of 1.5 are another group.
    large = int(np.sum(cycles.factor[EVENT::PER_RUN] >= 1.5))
    assert 15 < large < 30
    assert (physics.changes, scores["physics"]["small_jump"].changes) == (large, 30 - large)
    # Five cycles after the jump the recursions are silent, and the network behind its gate has answered since.
    assert physics.valid_share[5] == 0.0
    assert gated.valid_share[5] == 1.0
    assert gated.error_p95[5] < 0.3 < physics.error_p95[5]
    # The held answer turns right in the cycle 8 after the jump, which ends 0.17 s after it; the answers of the network
    # have a deviation of 5 % each, so most stay within 10 % from its first cycle on, 0.11 s after the jump.
    assert physics.t10_s[0] == pytest.approx(0.17)
    # In the cycle of the jump the recursions still hold the old grid and are valid: from 40 ms on, nothing is wrong.
    assert physics.wrong_s == 0.0
    # A Gaussian error with the stated deviation is inside its 95 % ellipse 95 % of the time; here the deviation is
    # a mixture about 5 %, which covers 90 to 95 %.
    assert 0.85 < ungated.coverage["from 20"] < 0.97


def test_groups_without_changes_are_empty(cycles: FieldCycles) -> None:
    empty = field_scores(cycles, oracle(), RADII, GATE)["physics"]["grid_step"]
    assert empty.changes == 0
    assert np.isnan(empty.error_p95).all()
