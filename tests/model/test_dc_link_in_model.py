"""The dc link in the full-order model: against closed forms, central differences and the EMT."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from tests.oracles.emt_controller import State
from tests.oracles.emt_dc import WithLink
from tests.oracles.emt_reference import Start, run_reference
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


def on(source: str, events: str = "", compensation: str = "measured", share: float | None = None) -> Study:
    """On a source; ``share``: with a droop of the link's voltage."""
    study = lcl_study("60 ms", events).with_changes(simulation={"P_ref": P_0})
    link = {"source": source, "C": "3 mF", "R_bleed": "8 kohm", "compensation": compensation}
    droop: dict[str, Any] = {"control": "voltage_droop", "voltage_droop": {"share": share}}
    return study.with_changes(dc=link | {source: SECTIONS[source]} | ({} if share is None else droop))


DROOPS = (("battery", "measured", 0.1), ("converter", "measured", 1.0), ("photovoltaic", "measured", 0.05))
EACH = (*((source, "measured", None) for source in SECTIONS), *DROOPS, ("converter", "none", 0.1))


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


@pytest.mark.parametrize(("source", "compensation", "share"), [*EACH, ("battery", "none", None)])
def test_entries_against_central_differences(source: str, compensation: str, share: float | None) -> None:
    """Of the step itself, by differences of fourth order in units of each state."""
    model = model_of(on(source, compensation=compensation, share=share))
    z, p = model.z[0], model.p[0]
    unit = np.maximum(np.abs(z), 1e-2)
    found = np.empty_like(model.A[0])
    for k in range(len(z)):
        d = np.zeros_like(z)
        d[k] = 1e-3 * unit[k]
        at = [np.array(model.map.step(z + j * d, p)[0]).ravel() for j in (-2, -1, 1, 2)]
        found[:, k] = (at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * d[k])
    link, delta = model.states.index("v_dc"), model.states.index("delta")
    assert share is None or model.A[0][delta, link] > 0.0
    rows = [*range(link if compensation == "measured" else 0, len(z)), *([] if share is None else [delta])]
    scaled = [(A * unit[None, :])[rows] for A in (found, model.A[0])]
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


class OnePeriod(WithLink):
    """What an independent integration of one period says of the link and of the voltage that waits."""

    def __init__(self, study: Study, v: float, p: float, memory: list[float]) -> None:
        super().__init__(study, v, p, memory)
        self.samples: list[tuple[complex, float, float, float]] = []

    def acting(self, asked: complex) -> complex:
        self.samples.append((asked, self.v, self.p_b, self.source.s))
        return super().acting(asked)


@pytest.mark.parametrize("source", SECTIONS)
def test_a_link_without_compensation_against_an_independent_integration(source: str) -> None:
    """All of the matrix by differences of DOP853 with a controller of its own, and its modes slower than 500 1/s."""
    study = on(source, compensation="none")
    study = replace(study, simulation=replace(study.simulation, duration=2.0 * study.converter.T_s))
    model, T = model_of(study), study.converter.T_s
    assert study.dc is not None
    names, z = model.states, model.z[0]
    memory = list(study.dc.at_rest(z[names.index("p_dc")], study.converter, study.filter).memory)
    begin, turn = cmath.exp(-0.5j * math.pi), study.grid_source.omega_g * T

    def after(z: NDArray[np.float64]) -> NDArray[np.float64]:
        of = dict(zip(names, z.tolist(), strict=True))

        def pair(name: str, d: str = "_d", q: str = "_q") -> complex:
            return complex(of[f"{name}{d}"], of[f"{name}{q}"])

        xi_v, xi_i = (pair(name, "d", "q") for name in ("xi_v", "xi_i"))
        state = State(of["delta"] - 0.5 * math.pi, of["omega_i"], of["V"], 0j, xi_v, xi_i)
        plant = np.array([pair(name) for name in ("i_s", "v_c", "i_g")]) * begin
        link = OnePeriod(study, of["v_dc"], of["p_dc"], [of["dc_p"], *memory[1:]] if "dc_p" in of else memory)
        start = Start(plant, state, pair("pending") * begin)
        trace = run_reference(study, [GainChange(0.0, GAINS)], False, start, circuits=link)
        back = cmath.exp(-1j * turn) / begin
        waits, *own = link.samples[1]
        found = dict(zip(("v_dc", "p_dc", "dc_p"), own, strict=True))
        found |= {"delta": trace.theta[1] + 0.5 * math.pi - turn, "omega_i": trace.omega[1], "V": trace.V[1]}
        vectors = dict(zip(("i_s_", "v_c_", "i_g_"), trace.plant[1] * back, strict=True)) | {"pending_": waits * back}
        for name, one in (vectors | {"xi_v": trace.xi_v[1], "xi_i": trace.xi_i[1]}).items():
            found |= {f"{name}d": one.real, f"{name}q": one.imag}
        return np.array([found[name] for name in names])

    unit = 0.1 * np.maximum(np.abs(z), 1.0)
    found = np.empty_like(model.A[0])
    for k in range(len(z)):
        d = np.zeros_like(z)
        d[k] = 0.1 * unit[k]
        at = [after(z + j * d) for j in (-2, -1, 1, 2)]
        found[:, k] = (at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * d[k])
    assert np.abs((found - model.A[0]) * unit[None, :] / unit[:, None]).max() < 1e-6
    with np.errstate(divide="ignore", invalid="ignore"):
        of_both = [np.log(np.linalg.eigvals(A).astype(complex)) / T for A in (found, model.A[0])]
    slow = [s for s in of_both[1] if abs(s) < 500.0]
    assert len(slow) >= 6
    for s in slow:
        assert np.nanmin(np.abs(of_both[0] - s)) < 1e-4


@pytest.mark.parametrize(("source", "compensation", "share"), DROOPS)
def test_a_rest_with_a_droop_of_the_voltage(source: str, compensation: str, share: float) -> None:
    """P = P_ref + D_p s ω_n (v − V_dc)/V_dc (:eq:`dc-droop-rest`), and the run stays there."""
    study = on(source, compensation=compensation, share=share)
    assert study.dc is not None
    run, c = simulate(study, [GainChange(0.0, GAINS)]), study.converter
    assert run.dc_log is not None
    v, P = run.dc_log[:, dc_columns(study).index("v")], run.column("P")
    assert abs(v[0] / c.V_dc - 1.0) > 5e-4
    expected = P_0 + GAINS.D_p * share * c.omega_n * (v[0] / c.V_dc - 1.0)
    assert P[0] == pytest.approx(expected, abs=1e-6 * c.S_rated)
    assert np.ptp(P) < 1e-4 * c.S_rated
    assert run.column("omega") == pytest.approx(c.omega_n, abs=1e-4)


def test_no_share_of_the_droop_changes_no_bit() -> None:
    events = f"[[events]]\ntime = '5 ms'\nP_ref = {P_0 + 500.0}\n"
    runs = [simulate(on("battery", events, share=share), [GainChange(0.0, GAINS)]) for share in (None, 0.0)]
    np.testing.assert_array_equal(runs[0].log, runs[1].log)


@pytest.mark.parametrize(("source", "compensation", "share"), [*EACH, ("converter", "none", None)])
def test_a_small_step_of_the_emt(source: str, compensation: str, share: float | None) -> None:
    """The voltage of the link after a step of P_ref by 0.5 % of the rating, against a run without it."""
    size, still = 25.0, on(source, compensation=compensation, share=share)
    model, T = model_of(still), still.converter.T_s
    v = []
    for study in (on(source, f"[[events]]\ntime = '5 ms'\nP_ref = {P_0 + size}\n", compensation, share), still):
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
