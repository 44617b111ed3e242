"""Full-order figures of a design against a recursion of the same model, sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.design.robust_studies import SETTLING, controller, robust_study, scenarios
from vsgdesign.design import verification
from vsgdesign.design.evaluation import final_Q
from vsgdesign.design.verification import full_order_figures
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS
from vsgdesign.linear.operating_point.full_order import linearise_full_order
from vsgdesign.linear.stability.margins import full_order_margins
from vsgdesign.runtime.of_study import schedule_of


def test_figures_against_a_recursion(monkeypatch: pytest.MonkeyPatch) -> None:
    study = robust_study()
    s = scenarios(study, 4.0, 2.0).take(np.array([0, 5, 20]))
    schedule = schedule_of(study, controller(study))
    estimated = s.R_hat - study.filter.R_2, s.X_hat / study.converter.omega_n - study.filter.L_2
    gains = schedule.gains_measured(*estimated, s.P, s.Q, s.V_rms)
    seen: list[Any] = []

    def kept(*arguments: Any) -> Any:
        seen.append(linearise_full_order(*arguments))
        return seen[-1]

    monkeypatch.setattr(verification, "linearise_full_order", kept)
    found = full_order_figures(study, gains, s, SETTLING)
    model = seen[0]
    exact = full_order_margins(model).disk_output.value.min()
    assert found.worst().disk_margin == pytest.approx(exact, rel=1e-9)
    J = np.array(jacobian_from_powers(s.P, s.Q, s.V_rms, s.R, s.X)).T.reshape(-1, 2, 2)
    D_q = np.broadcast_to(np.asarray(gains.D_q, dtype=float), s.P.shape)
    finals = {"P": np.ones(3), "Q": final_Q(J, D_q)}
    count = round(1.5 * SETTLING / model.T_s)  # settled by then, so nothing is left to peak
    cross = np.zeros(3)
    for own, other in (("P", "Q"), ("Q", "P")):
        x, y = np.zeros(model.B.shape[:2]), np.empty((count, 3, 2))
        for k in range(count):
            x = np.einsum("nij,nj->ni", model.A, x) + model.B[:, :, INPUTS.index(f"{own}_ref")]
            y[k] = np.einsum("nij,nj->ni", model.C[:, [OUTPUTS.index(own), OUTPUTS.index(other)]], x)
        progress = y[:, :, 0] / finals[own]
        # 320 instants of all samples: a hundredth of the settling time apart, on responses that bend in a tenth of it.
        overshoot = np.maximum(progress.max(axis=0) - 1.0, 0.0)
        np.testing.assert_allclose(getattr(found, f"overshoot_{own}"), overshoot, atol=1e-4)
        last = [np.flatnonzero(np.abs(progress[:, n] - 1.0) > 0.02)[-1] for n in range(3)]
        settled = (np.array(last) + 1) * model.T_s
        np.testing.assert_allclose(getattr(found, f"settling_{own}"), settled, atol=2e-3 * SETTLING)
        cross = np.maximum(cross, np.abs(y[:, :, 1]).max(axis=0))
    np.testing.assert_allclose(found.cross_peak, cross, rtol=2e-3)
