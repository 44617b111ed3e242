"""The paper's 60 s scenario with the network's estimate: errors at rest, delays, and the response beside the truth's.

Switched bridge, synchronised windows, seed 0. Errors are those that the scheme promises to keep, several times what
it measured on six seeds, but for the published recipe beyond the grids that it knows.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.artifacts.ready import Ready
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.scenario.judging import Judgement, judge_estimates
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.grid import Place
from vsgdesign.verbs.pipeline.estimators import make_network

STUDIES = Path(__file__).resolve().parents[2] / "studies"


@pytest.fixture(scope="module")
def continuous() -> tuple[Study, Ready]:
    study = load_study(STUDIES / "continuous" / "study.toml")
    network, trained = make_network(study)
    assert trained is not None
    assert trained.stop == "goal"
    for part in trained.parts.values():
        assert min(part.correlation) > 0.9999
    return study, Ready(network=network)


def on_grids(study: Study, *scr: float) -> Study:
    """The scenario with other short-circuit ratios; the last ten seconds, a step of Q, as they are."""
    grids = [Place(ratio, 1.0, study.scr_basis).grid(study.converter) for ratio in scr]
    later = iter(grids[1:])
    events = tuple(event if event.grid is None else replace(event, grid=next(later)) for event in study.events)
    return replace(study, grid=grids[0], events=events)


def judged(study: Study, ready: Ready) -> Judgement:
    """AVSG-ANN beside AVSG."""
    pair = tuple(spec for spec in study.controllers if spec.name in ("AVSG", "AVSG-ANN"))
    (one,) = judge_estimates(run_scenario(replace(study, controllers=pair), ready))
    return one


def worst_at_rest(one: Judgement, study: Study) -> dict[float, float]:
    """Largest error of R_g or L_g at rest, per cent, by SCR."""
    found: dict[float, float] = {}
    for rest in one.rest:
        scr = round(study.converter.Z_base / (study.converter.omega_n * rest.L_g), 3)
        found[scr] = max(found.get(scr, 0.0), rest.R_worst_pct, rest.L_worst_pct)
    return found


def as_with_the_truth(one: Judgement) -> None:
    """The second swing of Q at SCR 20 ends at the very edge of the band: its settling time jumps by 0.4 s with the
    last digits of the network, so only its overshoot is held."""
    for step in one.steps:
        assert step.overshoot_pct == pytest.approx(step.overshoot_truth_pct, abs=1.0)
        if step.signal == "P_pcc":
            assert step.settling_time_s == pytest.approx(step.settling_time_truth_s, abs=0.05)


def test_trained_on_every_grid(continuous: tuple[Study, Ready]) -> None:
    one = judged(*continuous)
    errors = worst_at_rest(one, continuous[0])
    assert set(errors) == {2.0, 8.0, 20.0}
    assert errors[2.0] <= 0.5
    assert errors[8.0] <= 1.0
    assert errors[20.0] <= 3.0
    assert [change.t_s for change in one.changes] == [20.0, 40.0]
    for change in one.changes:
        assert change.kept_windows is not None
        assert change.kept_windows <= 2
    assert one.statuses == {"ok": 3000}
    assert one.with_the_truth == "AVSG"
    assert [step.t_s for step in one.steps] == [10.0, 30.0, 50.0]
    as_with_the_truth(one)


def test_trained_on_every_grid_on_grids_it_never_saw(continuous: tuple[Study, Ready]) -> None:
    study = on_grids(continuous[0], 3.0, 5.0, 12.0)
    errors = worst_at_rest(judged(study, continuous[1]), study)
    assert set(errors) == {3.0, 5.0, 12.0}
    assert max(errors.values()) <= 1.0


@pytest.fixture(scope="module")
def published() -> tuple[Study, Ready]:
    study = load_study(STUDIES / "published" / "study.toml")
    return study, Ready(network=make_network(study)[0])


def test_trained_on_five_grids(published: tuple[Study, Ready]) -> None:
    study = published[0]
    one = judged(*published)
    errors = worst_at_rest(one, study)
    assert errors[2.0] <= 0.5
    assert errors[8.0] <= 1.0
    # Never seen, as in the paper, whose own network is 4.6 % off there.
    assert 1.0 < errors[20.0] < 10.0
    as_with_the_truth(one)
    assert np.isfinite(one.log.R_g_hat).all()


def test_the_damped_controller_keeps_its_current_limit(published: tuple[Study, Ready]) -> None:
    """The jumps to SCR 8 and 20 ask for 11.5 and 8.5 kW; 1.2 pu of current carry 6 kW per pu of voltage."""
    study, ready = published
    alone = replace(study, controllers=tuple(spec for spec in study.controllers if spec.name == "DAMPED-ANN"))
    (found,) = run_scenario(alone, ready).controllers
    t_s, current = found.series["t_s"], np.hypot(*found.simulation.log[:, :2].T) / study.converter.I_rated_pk
    for jump_s in (20.0, 40.0):
        after = (t_s >= jump_s) & (t_s < jump_s + 10.0)
        assert 4500.0 < found.series["P_pcc"][after].max() < 6000.0
        assert current[after].max() < 1.26
        assert np.ptp(found.simulation.column("limited_samples")[after]) > 100
    steps = {(e.t_s, e.signal): e.cycle_mean for e in found.events}
    for place in ((10.0, "P_pcc"), (30.0, "P_pcc"), (50.0, "Q_pcc")):
        settled, overshoot = steps[place].settling_time_s, steps[place].overshoot_pct
        assert settled is not None
        assert overshoot is not None
        assert 0.85 < settled <= 1.005  # 1.014 s and 0.45 % with poles for 1 s
        assert 0.0 <= overshoot <= 0.25


def test_the_continuous_study_is_the_published_one_but_for_the_recipe() -> None:
    published, continuous = (load_study(STUDIES / name / "study.toml") for name in ("published", "continuous"))
    assert published.estimator is not None
    assert continuous.estimator == replace(published.estimator, recipe="continuous")
    assert (continuous.controllers, continuous.events) == (published.controllers, published.events)
    assert continuous.simulation == published.simulation
