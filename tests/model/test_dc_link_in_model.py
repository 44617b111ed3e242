"""The dc link in the full-order model: against closed forms, central differences and the EMT."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from tests.simulation.studies import GAINS, lcl_study
from vsgdesign.linear.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.linear.stability.loci import modes, shares_of
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.study.parameters import Study

SECTIONS: dict[str, dict[str, Any]] = {
    "battery": {"R_i": "2 ohm", "i_max": 30, "capacity_Ah": 50},
    "converter": {"p_max": "4 kW", "p_charge_max": "2 kW", "tau": "4 ms", "feed_forward": 0.6},
    "photovoltaic": {"modules": 8, "strings": 3},
}
P_0 = 1500.0


def on(source: str, events: str = "") -> Study:
    study = lcl_study("60 ms", events).with_changes(simulation={"P_ref": P_0})
    return study.with_changes(dc={"source": source, "C": "3 mF", "R_bleed": "8 kohm", source: SECTIONS[source]})


def model_of(study: Study) -> FullOrderModel:
    return linearise_full_order(study, [Cell(study.grid, GAINS, P_0, study.simulation.Q_ref)])


@pytest.mark.parametrize("source", SECTIONS)
def test_it_stands_beside_the_circuit(source: str) -> None:
    """The rows of the circuit and of the controller are those of an ideal link, to the bit, and do not see the link."""
    study = on(source)
    model, ideal = model_of(study), model_of(lcl_study("60 ms").with_changes(simulation={"P_ref": P_0}))
    n = len(ideal.states)
    assert model.states[:n] == ideal.states
    assert model.states[n : n + 2] == ("v_dc", "p_dc")
    np.testing.assert_array_equal(model.A[0, :n, :n], ideal.A[0])
    assert not model.A[0, :n, n:].any()
    assert np.abs(model.A[0, n:, :n]).max() > 0.0


@pytest.mark.parametrize("source", SECTIONS)
def test_entries_against_central_differences(source: str) -> None:
    """Of the step itself, by differences of fourth order in units of each state."""
    model = model_of(on(source))
    z, p = model.z[0], model.p[0]
    unit = np.maximum(np.abs(z), 1e-2)
    found = np.empty_like(model.A[0])
    for k in range(len(z)):
        d = np.zeros_like(z)
        d[k] = 1e-3 * unit[k]
        at = [np.array(model.map.step(z + j * d, p)[0]).ravel() for j in (-2, -1, 1, 2)]
        found[:, k] = (at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * d[k])
    link = slice(model.states.index("v_dc"), None)
    scaled = [(A * unit[None, :])[link] for A in (found, model.A[0])]
    largest = np.abs(scaled[1]).max(axis=1, keepdims=True)
    assert np.abs((scaled[0] - scaled[1]) / largest).max() <= 1e-9


def test_mode_of_a_battery_in_closed_form() -> None:
    """C dv/dt = (e − v)/R − v/R_b − p/v: one mode, −(1/R + 1/R_b − p/v²)/C, with the link's voltage alone in it."""
    study = on("battery")
    assert study.dc is not None
    model = model_of(study)
    v, p = model.z[0, model.states.index("v_dc")], model.z[0, model.states.index("p_dc")]
    expected = -(0.5 + 1.0 / 8000.0 - p / v**2) / study.dc.C
    found = [mode for mode in modes(model.states, model.A[0], model.T_s) if "voltage of the dc link" in shares_of(mode)]
    (mode,) = [one for one in found if shares_of(one)["voltage of the dc link"] > 0.9]
    assert mode.s.real == pytest.approx(expected, rel=1e-4)
    assert abs(mode.s.real) < 500.0


def test_modes_of_a_stage_by_a_second_writing() -> None:
    """Voltage and power of the source over a period with a target that is held, by scipy's expm."""
    study = on("converter")
    assert study.dc is not None
    model, T, C = model_of(study), study.converter.T_s, study.dc.C
    values = study.dc.values
    v, p = model.z[0, model.states.index("v_dc")], model.z[0, model.states.index("p_dc")]
    given = p + v * v / 8000.0
    # d/dt of (v, p_s, target): C v' = p_s/v − v/R_b − p_b/v around the rest, τ p_s' = target − p_s.
    rates = np.zeros((3, 3))
    rates[0, 0], rates[0, 1] = (-(given - p) / v**2 - 1.0 / 8000.0) / C, 1.0 / (C * v)
    rates[1, 1], rates[1, 2] = -1.0 / values["tau"], 1.0 / values["tau"]
    held = expm(rates * T)
    A = held[:2, :2] + np.outer(held[:2, 2], [-values["k_p"], 0.0])
    expected = np.sort_complex(np.log(np.linalg.eigvals(A)) / T)
    link = [model.states.index(name) for name in ("v_dc", "dc_p")]
    found = np.sort_complex(np.log(np.linalg.eigvals(model.A[0][np.ix_(link, link)])) / T)
    assert np.abs(found - expected).max() <= 1e-4 * np.abs(expected).max()
    assert np.abs(found).max() < 500.0


@pytest.mark.parametrize("source", SECTIONS)
def test_a_small_step_of_the_emt(source: str) -> None:
    """The voltage of the link after a step of P_ref by 0.5 % of the rating, against a run without it."""
    size, still = 25.0, on(source)
    model, T = model_of(still), still.converter.T_s
    v = []
    for study in (on(source, f"[[events]]\ntime = '5 ms'\nP_ref = {P_0 + size}\n"), still):
        run = simulate(study, [GainChange(0.0, GAINS)])
        assert run.dc_log is not None
        v.append(run.dc_log[round(5e-3 / T) :, dc_columns(study).index("v")])
    z, at, linear = np.zeros(len(model.states)), model.states.index("v_dc"), []
    for _ in v[0]:
        linear.append(z[at])
        z = model.A[0] @ z + model.B[0][:, 0] * size
    emt = v[0] - v[1]
    assert np.abs(emt).max() > 1e-3
    assert np.abs(emt - np.array(linear)).max() < 5e-3 * np.abs(emt).max()
