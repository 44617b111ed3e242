"""The best single fixed tuning: what it keeps to, and that no better one lies beside it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from tests.design.robust_studies import controller, law, robust_study, specification
from vsgdesign.design.evaluation import Evaluation, evaluate_fixed, evaluate_pairs
from vsgdesign.design.single import best_fixed, exact_scenarios, violations
from vsgdesign.equations.power_flow import Lags
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import NormalisedGains, effective_inertia
from vsgdesign.errors import InfeasibleStudyError

GRIDS = ((3.0, 2.0), (6.0, 2.0))
best_of_few = partial(best_fixed, population=8, generations=4)


def test_given_gains_have_the_figures_of_the_parameters_they_come_from() -> None:
    study = robust_study()
    spec, structure = specification(study), law(study)
    s = exact_scenarios(study, spec, GRIDS[:1], 4500.0, 1000.0).take(np.array([0]))
    normalised = NormalisedGains(9.3, 5.1, 3.1, 0.0, 1.0, 1.0)
    gains = PowerLoopGains(*(float(np.ravel(value)[0]) for value in structure.gains(normalised, s)))
    fixed = evaluate_fixed(gains, s, spec.settling_time, structure.lags)
    pair = evaluate_pairs(structure, normalised, s, spec.settling_time)
    for name, values in pair.figures.items():
        np.testing.assert_allclose(fixed[name][0], values, rtol=1e-12)


@pytest.mark.parametrize("name", ["published", "decoupled", "angle_damped"])
def test_it_is_no_worse_than_any_closed_form_made_for_one_of_the_grids(name: str) -> None:
    """The oracle is the closed form of each grid, at its own design point and at three paces."""
    study = robust_study()
    spec, target, structure = specification(study), controller(study, name).target, law(study, name)
    found = best_of_few(study, target, GRIDS)
    s = exact_scenarios(study, spec, GRIDS, target.P, target.Q)
    share, q = (0.0, 0.01) if name == "published" else (1.0, 0.0)
    worst = []
    for pace in (0.6, 1.0, 1.6):
        T = spec.settling_time / pace
        made = structure.gains(NormalisedGains(15.8 / T**2, 6.6 / T, 4.0 / T, q, share, share), s)
        for k in (0, len(s) // 2):
            gains = PowerLoopGains(*(float(np.broadcast_to(value, s.P.shape)[k]) for value in made))
            e = evaluate_fixed(gains, s, spec.settling_time, structure.lags)
            worst.append(violations(spec, e, np.array([1.0])).max())
    assert found.violation <= min(worst) + 1e-9


def test_equal_calls_give_equal_digits_and_the_droops_are_those_asked_for() -> None:
    study = robust_study()
    target = controller(study).target
    one, other = (best_of_few(study, target, GRIDS, seed=3) for _ in range(2))
    assert one == other
    c = study.converter
    assert one.gains.D_p == pytest.approx(c.S_rated / (0.05 * c.omega_n))
    assert one.gains.D_q == pytest.approx(c.S_rated / (0.5 * c.V_rated_rms))
    assert one.gains.D_p == law(study).D_p


def test_every_set_of_gains_that_was_evaluated_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search asks for the closed forms once, and in each of three rounds for the first population and two
    generations. What is evaluated in all scenarios besides is one winner a round, and all winners in the end."""
    asked: list[int] = []

    def counted(gains: PowerLoopGains, *arguments: Any) -> Evaluation:
        asked.append(np.size(gains.K_ip))
        return evaluate_fixed(gains, *arguments)

    monkeypatch.setattr("vsgdesign.design.single.evaluate_fixed", counted)
    study = robust_study()
    found = best_fixed(study, controller(study).target, GRIDS, population=8, generations=2)
    assert asked[1:] == [8, 8, 8, 1] * 3 + [4]
    assert found.designs == asked[0] + 3 * 3 * 8


def test_an_unstable_tuning_is_worse_than_any_stable_one() -> None:
    study = robust_study()
    spec = specification(study)
    s = exact_scenarios(study, spec, GRIDS, 4500.0, 1000.0)
    stable, unstable = (PowerLoopGains(2e-3, D_p, 0.05, 50.0) for D_p in (1e3, 1e-3))
    H = np.array([1.0])
    low, high = (
        violations(spec, evaluate_fixed(g, s, spec.settling_time, Lags(5e-3, 5e-3)), H) for g in (stable, unstable)
    )
    assert low.max() <= 5.0 < 10.0 <= high.max()


def test_it_says_what_is_missing() -> None:
    study = replace(robust_study(), specification=None)
    with pytest.raises(InfeasibleStudyError, match="specification"):
        best_fixed(study, controller(study).target, GRIDS)
    study = robust_study()
    strict = replace(study, converter=replace(study.converter, V_min_pu=1.2, V_max_pu=1.21))
    with pytest.raises(InfeasibleStudyError, match="no grid has an operating point"):
        best_fixed(strict, controller(study).target, GRIDS)


def test_a_bound_on_the_inertia_is_part_of_the_search() -> None:
    """Half of the inertia of the tuning without a bound at most, or twice at least: another tuning is found."""
    study = robust_study()
    target, c = controller(study).target, study.converter
    free = best_of_few(study, target, GRIDS)
    H = float(effective_inertia(free.gains, c.S_rated, c.omega_n))
    for low, high in ((0.0, 0.5 * H), (2.0 * H, 1e6)):
        bounded = replace(study, specification=replace(specification(study), H_min=low, H_max=high))
        found = best_of_few(bounded, target, GRIDS)
        reached = float(effective_inertia(found.gains, c.S_rated, c.omega_n))
        assert low <= reached <= high
        assert found.violation == free.violation == 0.0
    spec = replace(specification(study), H_min=2.0)
    e = evaluate_fixed(free.gains, exact_scenarios(study, spec, GRIDS, 4500.0, 1000.0), 1.3, study.power_lags)
    assert (violations(spec, e, np.array([1.0])) >= 0.5 - 1e-12).all()
    assert (violations(spec, e, np.array([-1.0])) >= 5.0 - 1e-12).all()
