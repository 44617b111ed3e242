"""The power loops a sample at a time: the same numbers as the EMT, no jump on retuning, a state to go on from."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from tests.simulation.studies import FAST_GAINS, GAINS, lc_study
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime import PowerController
from vsgdesign.simulation import GainChange, simulate

DAMPED = GAINS._replace(k_P=2e-4, k_Q=1e-4, K_pq=1e-4, K_qp=2e-4)
REFS = References(2e3, 500.0, 100.0 * math.pi, 110.0)


@pytest.mark.parametrize("power_filter", ["low_pass", "notch"])
def test_the_same_as_in_emt(power_filter: str) -> None:
    """Fed the run's P and Q it goes the run's way, across two changes of gains; rounding alone differs."""
    filters = f'[power_loops]\ntau_P = "5 ms"\ntau_Q = "2 ms"\npower_filter = "{power_filter}"\n'
    study = lc_study("0.12 s", sections="[grid]\ncomponents = [{ order = -1, amplitude_pu = 0.02 }]\n" + filters)
    changes = [GainChange(0.0, GAINS), GainChange(0.04, DAMPED), GainChange(0.08, FAST_GAINS)]
    run = simulate(study, changes, log_states=1)
    settings = study.controller_settings()
    P, Q, omega, V, theta = (run.column(name) for name in ("P", "Q", "omega", "V_rms", "theta"))
    refs = run.timeline.references_at(0.0)
    controller = PowerController(GAINS, refs, settings.T_s, settings.smoothing_P, settings.smoothing_Q, study.notch)
    first = run.controller_log[0]
    controller.restore(
        dict(zip(("theta", "omega_i", "V", "P_f", "Q_f"), map(float, first[:5]), strict=True)) | {"gains": list(GAINS)}
    )
    at = {round(change.t_s / settings.T_s): change.gains for change in changes[1:]}
    got = []
    for k, (P_k, Q_k) in enumerate(zip(P, Q, strict=True)):
        if k in at:
            controller.retune(at[k])
        got.append(controller.step(float(P_k), float(Q_k)))
    np.testing.assert_allclose(np.array(got), np.column_stack([omega, V, theta]), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("gains", [GAINS, DAMPED])
def test_rests_at_the_set_points(gains: PowerLoopGains) -> None:
    controller = PowerController(gains, REFS, 1e-4)
    for _ in range(5):
        omega, V, _ = controller.step(2e3, 500.0)
        assert omega == pytest.approx(REFS.omega_0, rel=1e-14)
        assert pytest.approx(REFS.V_n, rel=1e-14) == V


@pytest.mark.parametrize("order", [(GAINS, DAMPED), (DAMPED, GAINS)])
def test_retuning_at_rest_moves_nothing(order: tuple[PowerLoopGains, PowerLoopGains]) -> None:
    """On a grid of 50.3 Hz: P has moved along the droop, which both sets share."""
    first, second = (gains._replace(D_p=318.3, D_q=90.0) for gains in order)
    offset = 0.3 * 2.0 * math.pi
    P = REFS.P_ref - first.D_p * offset
    controller = PowerController(first, REFS, 1e-4)
    at_rest = REFS.omega_0 + offset + first.k_P * P + first.k_Q * (REFS.Q_ref + first.D_q * REFS.V_n)
    controller.restore(controller.state() | {"omega_i": at_rest, "P_f": P})
    controller.step(P, REFS.Q_ref)
    controller.retune(second)
    for _ in range(50):
        omega, V, _ = controller.step(P, REFS.Q_ref)
        assert omega == pytest.approx(REFS.omega_0 + offset, abs=1e-9)
        assert pytest.approx(REFS.V_n, abs=1e-9) == V


def test_retuning_during_a_surge_keeps_nothing_of_it() -> None:
    """Two controllers that differ only in the power that they measure take the same step of ω_i."""
    steps = []
    for P in (2e3, 30e3):
        controller = PowerController(DAMPED, REFS, 1e-4, 0.02, 0.02)
        controller.restore(controller.state() | {"P_f": P})
        before = controller.state()["omega_i"]
        controller.retune(DAMPED._replace(k_P=9e-4))
        steps.append(controller.state()["omega_i"] - before)
    assert steps[0] == steps[1] != 0.0


def test_the_angle_stays_within_a_turn() -> None:
    controller = PowerController(GAINS, REFS, 1e-3)
    angles = [controller.step(2e3, 500.0)[2] for _ in range(200)]
    assert 0.0 <= min(angles) <= max(angles) <= 2.0 * math.pi + 0.4


def test_restored_goes_on_to_the_same_bits() -> None:
    a, b = PowerController(DAMPED, REFS, 1e-4, 0.02, 0.02), PowerController(GAINS, REFS, 1e-4, 0.02, 0.02)
    rng = np.random.default_rng(2)
    for _ in range(30):
        a.step(*rng.normal(1e3, 500.0, 2))
    b.restore(json.loads(json.dumps(a.state())))
    for _ in range(30):
        P, Q = rng.normal(1e3, 500.0, 2)
        assert a.step(P, Q) == b.step(P, Q)


def test_what_cannot_run_is_refused() -> None:
    with pytest.raises(ArtifactError, match="T_s = 0 s"):
        PowerController(GAINS, REFS, 0.0)
    for bad in ({}, {"theta": "x"}, PowerController(GAINS, REFS, 1e-4).state() | {"gains": [1.0]}):
        with pytest.raises(ArtifactError, match="start afresh"):
            PowerController(GAINS, REFS, 1e-4).restore(bad)
