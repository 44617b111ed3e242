"""The static limits and the steady states of the sampled controller agree on what a converter can carry."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.studies import GAINS
from vsgdesign.linear.operating_point.equilibrium import acting_current_pk, static_limit_uses
from vsgdesign.linear.operating_point.many import CURRENT, LIMITER_ACTS, LIMITER_PULLS, Lanes, many_steady_states
from vsgdesign.study.parameters import Study, study_from_text

OF_CURRENT = (CURRENT, LIMITER_ACTS, LIMITER_PULLS)


def study_with(case: str, limiter: str) -> Study:
    return study_from_text(
        f"""
        base = "case:{case}"
        converter = {{ current_limit_pu = 1.2, current_limiter = "{limiter}" }}
        simulation = {{ duration = "1 s", P_ref = "1 kW", Q_ref = "0 var" }}
        controllers = [{{ name = "fixed", kind = "fixed" }}]
        """,
        "a study",
    )


@pytest.mark.parametrize("limiter", ["projection", "circular"])
@pytest.mark.parametrize("case", ["lab_12kva_lcl", "utility_1mva_60hz"])
def test_the_current_at_rest_is_the_converters_below_the_limit_that_acts(case: str, limiter: str) -> None:
    """With the hard limit and the grid's current, points were asked for at which the converter's own limiter acts."""
    study = study_with(case, limiter)
    c, rng, count = study.converter, np.random.default_rng(18), 400
    Z, angle = c.Z_base / rng.uniform(1.5, 20.0, count), np.arctan(rng.uniform(0.3, 20.0, count))
    R_g, L_g = Z * np.cos(angle), Z * np.sin(angle) / c.omega_n
    power = c.S_rated * rng.uniform(0.8, 1.25, count) * np.exp(1j * rng.uniform(-np.pi, np.pi, count))
    lanes = Lanes(R_g, L_g, c.V_rated_rms, c.omega_n, power.real, power.imag)
    points = many_steady_states(study, lanes, GAINS)
    acts = np.isin(points.fault, OF_CURRENT)
    there = acts | (points.fault == 0)
    R, X = study.filter.R_2 + R_g, c.omega_n * (study.filter.L_2 + L_g)
    V_rms = np.where(there, points.controller.V, np.nan)
    use = static_limit_uses(study, R, X, c.omega_n, points.P, points.Q, V_rms)["current"]
    assert not acts[there & (use <= 1.0)].any()
    assert acts[there & (use > 1.01)].all()
    assert min(np.sum(there & (use <= 1.0)), np.sum(there & (use > 1.01))) > 50


def test_without_a_limit_no_current_is_too_large() -> None:
    study = study_from_text(
        'base = "case:hoang2025_5kva"\nsimulation = { duration = "1 s", P_ref = "1 kW", Q_ref = "0 var" }\n'
        'controllers = [{ name = "fixed", kind = "fixed" }]',
        "a study",
    )
    assert acting_current_pk(study) == np.inf
