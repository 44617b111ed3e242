"""Fed as a controller feeds it: sample by sample, through the guards of the scheduler, saved and restored."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests.gain_tables import table
from tests.identification.signals import AT, OMEGA, N, answers, power_step
from vsgdesign.equations.scheduler_data import FRESH, NO_ESTIMATE, NOT_FINITE
from vsgdesign.errors import ArtifactError
from vsgdesign.export.c_code import export_c
from vsgdesign.export.c_content import Origin
from vsgdesign.identification import ESTIMATORS, Estimate, Needs, Samples, build_estimator
from vsgdesign.identification.feeding import FedEstimator
from vsgdesign.runtime import scheduler_of

POWERS = (3000.0, 500.0, 112.0)
CLASSICAL = tuple(name for name, kind in ESTIMATORS.items() if not (kind.trained or kind.by_sample))


@pytest.mark.parametrize("name", CLASSICAL)
def test_sample_by_sample_is_window_by_window(name: str) -> None:
    estimator = build_estimator(name, AT)
    windows = power_step()[:25]
    expected = answers(estimator, windows)
    fed = FedEstimator(estimator)
    for window, one in zip(windows, expected, strict=True):
        due = [
            fed.push(window.v[:, k], window.i[:, k], window.omega, window.theta[k], window.sent[k]) for k in range(N)
        ]
        assert due == [False] * (N - 1) + [True]
        assert fed.push(np.ones(2), np.ones(2), 1.0)  # left out
        found = fed.answer()
        assert found is not None
        np.testing.assert_array_equal(found[:2], one[:2])
        assert fed.answer() is None


@pytest.mark.parametrize("name", CLASSICAL)
def test_restored_in_the_middle_of_a_window_it_goes_on_to_the_same_bits(name: str) -> None:
    windows = power_step()[:26]
    whole, first, second = (FedEstimator(build_estimator(name, AT)) for _ in range(3))
    for number, window in enumerate(windows):
        for k in range(N):
            sample = (window.v[:, k], window.i[:, k], window.omega, window.theta[k], window.sent[k])
            whole.push(*sample)
            if (number, k) == (20, 37):
                document = json.loads(json.dumps(first.document(), allow_nan=False))
                second.restore(document)
                assert second.document() == document
                first = second
            first.push(*sample)
        found, other = whole.answer(), first.answer()
        assert found is not None
        assert other is not None
        np.testing.assert_array_equal(found[:2], other[:2])


def test_the_memory_of_something_else_is_refused() -> None:
    fed, other = FedEstimator(build_estimator("kalman", AT)), FedEstimator(build_estimator("prbs", AT))
    good = fed.document()
    for wrong in (None, {}, [], other.document(), good | {"filled": 1}, good | {"omega": "x"}, good | {"filled": True}):
        with pytest.raises(ArtifactError, match=r"state\.estimator"):
            fed.restore(wrong)
    fed.restore(good)


def test_a_window_of_another_length_is_refused() -> None:
    with pytest.raises(ArtifactError, match="Extended Kalman filter takes 2 × 100 samples"):
        FedEstimator(build_estimator("kalman", AT)).window(np.zeros((2, 50)), np.zeros((2, 50)))


def test_the_schedulers_guards_stand_behind_every_estimator() -> None:
    """The gains follow the filter once it believes itself; what is no number is refused, an unsure estimate held."""
    scheduler = scheduler_of(table(), build_estimator("kalman", replace(AT, T_s=50e-6)))
    said = []
    for k, window in enumerate(power_step()):
        v = np.full_like(window.v, np.nan) if k == 3 else window.v
        said.append(scheduler.update(v, window.i, *POWERS, omega=window.omega))
    assert said[2].reason == NO_ESTIMATE
    assert said[3].reason == NOT_FINITE
    assert said[-1].status & FRESH
    # SCR of the true 0.9 + j0.911 Ω on 7.26 Ω; the filter is within 10 % of it after the step.
    assert said[-1].scr == pytest.approx(7.26 / abs(0.9 + 1j * OMEGA * 0.0029), rel=0.1)
    other = scheduler_of(table(), build_estimator("kalman", AT))
    other.restore(json.loads(json.dumps(scheduler.state(), allow_nan=False)))
    last = power_step()[-1]
    both = [one.update(last.v, last.i, *POWERS, omega=last.omega) for one in (scheduler, other)]
    assert both[0] == both[1]
    with pytest.raises(ArtifactError, match="another table or other settings"):
        scheduler_of(table(), build_estimator("rls", AT)).restore(scheduler.state())


def test_there_is_no_c_for_it_and_that_is_said(tmp_path: Path) -> None:
    scheduler = scheduler_of(table(), build_estimator("kalman", AT))
    with pytest.raises(ArtifactError, match="no C for the estimator Extended Kalman filter yet"):
        export_c(scheduler, Origin("t", "0", "s", "0"), tmp_path / "c")
    assert not (tmp_path / "c").exists()


class _Count(NamedTuple):
    seen: int


@dataclass(frozen=True)
class EveryTenth:
    """Fed sample by sample, with an answer at every tenth of them."""

    title: str = "every tenth"
    signals: str = "other"

    @property
    def needs(self) -> Needs:
        return Needs(1, 200e-6)

    def first(self) -> _Count:
        return _Count(0)

    def probe(self, state: _Count) -> None:
        pass

    def update(self, state: _Count, samples: Samples) -> tuple[_Count, Estimate | None]:
        seen = state.seen + samples.v.shape[-1] // 2
        return _Count(seen), Estimate(1.0, 4e-3, "ok") if seen % 10 == 0 else None


def test_an_estimator_that_is_fed_sample_by_sample_answers_when_it_likes() -> None:
    fed = FedEstimator(EveryTenth())
    due = [fed.push(np.zeros(2), np.zeros(2), OMEGA) for _ in range(9)]
    assert due == [False] * 9
    assert fed.answer() is None
    assert fed.push(np.zeros(2), np.zeros(2), OMEGA)
    assert fed.push(np.zeros(2), np.zeros(2), OMEGA)  # it goes on while the answer waits
    assert fed.answer() == Estimate(1.0, 4e-3, "ok")
    assert fed.state().memory == _Count(11)
