"""The program's constraints, at points of its space, against scipy and the margins room."""

from __future__ import annotations

import functools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from tests.design.robust_studies import SETTLING, law, robust_study, scenarios, specification, textbook
from vsgdesign.design import nlp
from vsgdesign.design.box import Scenarios
from vsgdesign.design.evaluation import LawOfStudy, evaluate, final_Q
from vsgdesign.linear.model.coupled import coupled_model
from vsgdesign.linear.stability.loops import ReducedLoop
from vsgdesign.metrics.margins import disk_margin_per_frequency
from vsgdesign.metrics.step_response import SETTLING_BAND

STUDY = robust_study()
SPEC = specification(STUDY)
YIELDING = replace(STUDY, inner_gains=STUDY.inner_gains._replace(R_t=0.3, X_t=2.0), omega_t=35.0)
STRUCTURES = ("published", "decoupled", "angle_damped", "yielding")
"""The last is angle-damped behind a transient impedance: the program opens the loop of plant and controller at the
powers, the margins of a model solve both at every frequency."""


def structure_of(name: str) -> str:
    return "angle_damped" if name == "yielding" else name


def rule_of(name: str) -> LawOfStudy:
    return law(YIELDING, "angle_damped") if name == "yielding" else law(STUDY, name)


@functools.cache
def slot_of(structure: str) -> ca.Function:
    return nlp._slot_function(rule_of(structure), SPEC, nlp.variables(structure_of(structure), SPEC))


def rows(
    structure: str, y: np.ndarray, margin: float, slack: np.ndarray, s: Scenarios, reserve: float = 0.0
) -> dict[str, np.ndarray]:
    """The rows of one scenario by kind, in order."""
    column = np.array([getattr(s, name)[0] for name in Scenarios.__dataclass_fields__])
    values = slot_of(structure)(y, margin, slack, reserve, ca.DM(column)).full().ravel()
    kinds = np.array(nlp._row_kinds(SPEC))
    assert len(kinds) == len(values)
    return {kind: values[kinds == kind] for kind in dict.fromkeys(kinds.tolist())}


@pytest.fixture(scope="module")
def box() -> Scenarios:
    return scenarios(STUDY, 3.0, 1.0)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_responses_by_matrix_exponential(structure: str, box: Scenarios) -> None:
    """The rows give back y(t)/y(∞) − 1 at multiples of T/20. Taylor's sixth order errs by less than 0.4⁷/7! = 3e-7 a
    step for modes up to a quarter of the largest |λ h| = 1.6. Faster ones are over within T/20, at their exact rest.
    60 steps of a stable system do not add up to 60 times that."""
    rule, y, s = rule_of(structure), textbook(STUDY, structure_of(structure)), box.take(np.array([11]))
    found = rows(structure, y, 0.5, np.zeros(4), s)
    gains = rule.gains(nlp.variables(structure_of(structure), SPEC).normalised(y), s)
    model = coupled_model(s.delta, s.V_rms, s.V_g_rms, s.R, s.X, gains, lags=rule.lags)
    assert np.linalg.eigvals(model.A[0]).real.max() < 0.0
    finals = (1.0, float(final_Q(model.J, np.atleast_1d(gains.D_q))[0]))
    peaks, tails = nlp._times()
    times = np.concatenate([np.arange(1, 25), 24 + 2 * np.arange(1, 19)]) * SETTLING / 20.0
    over, band = [], []
    for channel, final in enumerate(finals):
        n = len(model.A[0])
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n] = model.A[0], model.B[0][:, channel]
        error = np.array([model.C[0][channel] @ expm(whole * t)[:n, n] for t in times]) / final - 1.0
        over.append(nlp._GUARD_PEAK * SPEC.overshoot - error[peaks])
        limit = nlp._GUARD * SETTLING_BAND
        band += [limit - error[tails], limit + error[tails]]
    np.testing.assert_allclose(found["overshoot"], np.concatenate(over), atol=3e-6)
    np.testing.assert_allclose(found["settling_time"], np.concatenate(band), atol=3e-6)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_margin_rows_hold_just_up_to_the_disk_margin(structure: str, box: Scenarios) -> None:
    """(r ≥ t/2 and r² − t r + d ≥ 0) is α ≤ 1/μ, at each frequency on its own."""
    rule, y, s = rule_of(structure), textbook(STUDY, structure_of(structure)), box.take(np.array([11]))
    gains = rule.gains(nlp.variables(structure_of(structure), SPEC).normalised(y), s)
    model = coupled_model(s.delta, s.V_rms, s.V_g_rms, s.R, s.X, gains, lags=rule.lags)
    exact = disk_margin_per_frequency(ReducedLoop(model).on(nlp._FREQUENCIES / SETTLING))[0]
    for k, alpha in enumerate(exact):
        for margin, holds in ((alpha * (1.0 - 1e-6), True), (alpha * (1.0 + 1e-6), False)):
            pair = rows(structure, y, margin, np.zeros(4), s)["disk_margin"][2 * k : 2 * k + 2]
            assert (pair >= 0.0).all() == holds, (k, alpha)


def test_slacks_relax_what_they_are_named_after(box: Scenarios) -> None:
    y, s = textbook(STUDY), box.take(np.array([3]))
    tight = rows("angle_damped", y, 1.0, np.zeros(4), s)
    for k, kind in enumerate(("overshoot", "settling_time")):
        loose = rows("angle_damped", y, 1.0, np.eye(4)[k], s)
        for name, values in tight.items():
            assert (loose[name] > values).all() if name == kind else (loose[name] == values).all()


def test_the_whole_reserve_stays_within_the_promises(box: Scenarios) -> None:
    """What one unit of it adds is less than what the guards hold back: 0.4 of the band, 0.3 of the overshoot."""
    y, s = textbook(STUDY), box.take(np.array([3]))
    kept, used = (rows("angle_damped", y, 1.0, np.zeros(4), s, reserve) for reserve in (0.0, 1.0))
    for name, promise in (
        ("overshoot", 0.3 * SPEC.overshoot),
        ("settling_time", 0.4 * SETTLING_BAND),
        ("disk_margin", 1e-9),
    ):
        more = used[name] - kept[name]
        assert (more >= 0.0).all(), name
        assert more.max() < promise, name
    assert (used["overshoot"] > kept["overshoot"]).all()
    assert (used["settling_time"] > kept["settling_time"]).all()


def test_a_solution_keeps_what_the_kernels_measure(box: Scenarios) -> None:
    """The solved program's promises, looked at by other code on a finer grid: the guards cover the difference."""
    rule = law(STUDY)
    program, centre = nlp.robust_program(rule, SPEC), textbook(STUDY)
    few = box.take(np.array([0, 8, 20, 33, 47]))
    solved = program.solve(centre, centre, few, 3.0, 1.0, program.variables.high)
    assert solved is not None
    assert max(solved.slacks.values()) < 1e-4
    assert (solved.y >= program.variables.low).all()
    assert (solved.y <= program.variables.high).all()
    found = evaluate(rule, program.variables.normalised(solved.y), few, SETTLING)
    for own in "PQ":
        assert found[f"overshoot_{own}"].max() <= SPEC.overshoot
        assert found[f"settling_{own}"].max() <= SPEC.settling_time
    assert found["disk_margin"].min() >= SPEC.disk_margin
