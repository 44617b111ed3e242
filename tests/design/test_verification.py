"""Full-order figures of a design against a recursion of the same model, sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.design.robust_studies import SETTLING, controller, robust_study, scenarios
from vsgdesign.artifacts.table_text import link_text
from vsgdesign.design import verification
from vsgdesign.design.evaluation import final_Q
from vsgdesign.design.verification import full_order_figures, range_of_link
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


def test_figures_with_a_battery_are_the_worst_over_its_charge() -> None:
    """Those of each charge by itself, where the battery can: a full one takes nothing, an empty one gives nothing."""
    study = robust_study()
    c, s = study.converter, scenarios(study, 4.0, 2.0).take(np.array([0, 5, 20]))
    battery = {"R_i": 0.1 * c.V_dc**2 / c.S_rated, "i_max": 2.0 * c.S_rated / c.V_dc, "capacity_Ah": 10}
    link = {"source": "battery", "C": 1e-3 * c.S_rated / c.V_dc**2 * 4.0, "compensation": "none"}

    def at(charge: float) -> Any:
        return study.with_changes(dc=link | {"battery": battery | {"charge": charge}})

    estimated = s.R_hat - study.filter.R_2, s.X_hat / c.omega_n - study.filter.L_2
    gains = schedule_of(study, controller(study)).gains_measured(*estimated, s.P, s.Q, s.V_rms)
    found = full_order_figures(at(0.5), gains, s, SETTLING)
    each = []
    for charge in (0.0, 0.5, 1.0):
        model = linearise_full_order(at(charge), verification._cells(study, gains, s))
        growth = np.full(3, -np.inf)
        growth[model.index] = np.log(np.abs(np.linalg.eigvals(model.A)).max(axis=1)) / model.T_s
        each.append(growth)
    np.testing.assert_allclose(found.abscissa, np.max(each, axis=0), rtol=1e-9)
    assert np.isinf(each[0]).any() or np.isinf(each[2]).any()
    assert (found.abscissa > each[1]).any()
    assert range_of_link(study, (0.0,)) is None
    assert "at 0, 50 and 100 % of its charge" in link_text({"link": range_of_link(at(0.5), (0.0,))})
    assert range_of_link(at(0.5), (0.0,)) == {
        "charges": [0.0, 0.5, 1.0],
        "v_dc": pytest.approx([0.94 * c.V_dc, 1.06 * c.V_dc]),
    }
