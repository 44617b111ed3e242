"""An estimate that is off in the direction of R by more than R itself: what the design says of it, and the EMT."""

from __future__ import annotations

import numpy as np
import pytest

from tests.design.robust_studies import controller, law, specification, textbook, with_specification
from vsgdesign.design.box import scenarios_of_truth
from vsgdesign.design.evaluation import evaluate_gains
from vsgdesign.design.search import variables
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.metrics import step_response
from vsgdesign.simulation.steps import simulate_step
from vsgdesign.study.parameters.grid import Grid

SCR, X_OVER_R, ERROR_Z = 4.0, 10.0, 0.15
STEP = 100.0


@pytest.mark.parametrize("sign_R", [-1.0, 1.0])
def test_the_design_of_a_wrong_estimate_is_what_the_emt_does(sign_R: float) -> None:
    """±15 % of |Z| at X/R 10 is ±150 % of R: R̂ would be negative, and is drawn to the table's X/R of 20. Overshoot
    agrees within 0.2 points and settling within 2 %: the design's model has ideal inner loops."""
    study = with_specification(scr=(1.5, 20.0), x_over_r=(0.3, 20.0), error_R=0.2, error_X=0.0, error_Z=ERROR_Z)
    spec, target = specification(study), controller(study).target
    own = law(study)
    s = scenarios_of_truth(study, spec, SCR, X_OVER_R, target.P, target.Q)
    R_2, X_2 = study.filter.R_2, study.converter.omega_n * study.filter.L_2
    off = (s.R_hat - s.R) / np.hypot(s.R - R_2, s.X - X_2)
    drawn_in = s.R_hat / s.X_hat
    here = (np.sign(off) == sign_R) & (np.abs(s.P - 2000.0) < 3000.0) & (s.X_hat < s.X)
    k = int(np.flatnonzero(here)[0])
    assert (off[k] if sign_R > 0.0 else drawn_in[k]) == pytest.approx(ERROR_Z if sign_R > 0.0 else 0.05, rel=1e-6)
    one = s.take(np.array([k]))
    found = variables(own.structure, spec).normalised(textbook(study)[None])
    gains = own.gains(NormalisedGains(*(np.asarray(value).ravel()[:1] for value in found)), one)
    said = evaluate_gains(gains, one, spec.settling_time, study.power_lags)
    numbers = PowerLoopGains(*(float(np.ravel(value)[0]) for value in gains))
    grid = Grid(float(one.R[0] - R_2), float((one.X[0] - X_2) / study.converter.omega_n))
    t_s, P = simulate_step(study, grid, numbers, float(one.P[0]), float(one.Q[0]), "P", STEP, 3.0)
    seen = step_response(t_s, P, 0.0, STEP)
    assert seen.overshoot_pct == pytest.approx(100.0 * float(said["overshoot_P"][0]), abs=0.2)
    assert seen.settling_time_s == pytest.approx(float(said["settling_P"][0]), rel=0.02)
