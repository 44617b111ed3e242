"""Gains of floats: the bits of the arrays, and values that are not finite where arrays have them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import load_study


@pytest.mark.parametrize("name", list(STRUCTURES))
def test_gains_of_floats_have_the_bits_of_arrays(name: str) -> None:
    study = load_study("studies/structures/study.toml")
    spec = study.controllers[0]
    schedule = gain_law(study, replace(spec, target=replace(spec.target, structure=name))).schedule
    rng = np.random.default_rng(8)
    R_g, L_g = rng.uniform(0.0, 20.0, 200), rng.uniform(1e-4, 0.1, 200)
    P, Q, V = rng.uniform(-6e3, 6e3, 200), rng.uniform(-3e3, 3e3, 200), rng.uniform(20.0, 200.0, 200)
    P[:4], Q[:4], V[4], L_g[5], V[6] = 0.0, 0.0, np.nan, np.nan, 0.0
    P[6] = Q[6] = 0.0
    with np.errstate(all="ignore"):
        arrays = np.array([np.broadcast_to(x, (200,)) for x in schedule.gains_measured(R_g, L_g, P, Q, V)])
        single = [schedule.gains_of_floats(*at) for at in np.array([R_g, L_g, P, Q, V]).T.tolist()]
    assert np.array_equal(np.array(single).T, arrays, equal_nan=True)
    assert not np.isfinite(arrays[:, 6]).all()
