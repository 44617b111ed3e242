"""Gains for two impedances: the modes of two units on one network are those of one unit on either."""

from __future__ import annotations

import signal
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.design.robust_studies import robust_study, scenarios, specification, textbook
from vsgdesign.certificate import Certificate, Region, certify
from vsgdesign.certificate.region import AtDesignPoint
from vsgdesign.design import record
from vsgdesign.design.box import scenarios_of_estimate
from vsgdesign.design.cell import design_cell
from vsgdesign.design.evaluation import between_units, law_of, model_in, shortfalls
from vsgdesign.design.nlp import robust_program, slow_determinant
from vsgdesign.design.record import CellRecord
from vsgdesign.design.verification import full_order_figures
from vsgdesign.equations.power_flow import Lags, operating_point, power_flow
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.runtime.of_study import schedule_of
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.grid import Place

Array = NDArray[np.float64]

LAGS = Lags(0.0, 0.0, 0.3, 1.2, 40.0)
OMEGA, V_N = 100.0 * np.pi, 110.0


def units_rates(x: Array, count: int, own: complex, grid: complex, V_g: float, gains: PowerLoopGains) -> Array:
    """Rates of equal units on one node in complex phasors of the source's frame: per unit δ, ω_i, V and i_f."""
    delta, omega_i, V, i_d, i_q = x.reshape(count, 5).T
    Z_t, turn, i_f = complex(LAGS.R_t, LAGS.X_t), np.exp(1j * delta), i_d + 1j * i_q
    # Behind Z_t and its own path each unit is a voltage; all currents flow through the grid.
    behind = (V + Z_t * i_f) * turn
    i = np.linalg.solve((own + Z_t) * np.eye(count) + grid, behind - V_g)
    v = behind - Z_t * i
    S, change = 3.0 * v * np.conj(i), LAGS.omega_t * (i / turn - i_f)
    omega = omega_i - gains.k_P * S.real - gains.k_Q * (S.imag + gains.D_q * V)
    e_P, e_Q = -S.real - gains.D_p * omega, -S.imag - gains.D_q * V
    rates = omega, gains.K_ip * e_P + gains.K_pq * e_Q, gains.K_qp * e_P + gains.K_iq * e_Q, change.real, change.imag
    return np.stack(rates, axis=1).ravel()


@pytest.mark.parametrize("count", [2, 4])
def test_the_spectrum_of_equal_units_is_that_of_one_on_two_impedances(count: int) -> None:
    own, grid = 0.1 + 0.5j, 0.2 + 0.9j
    gains = PowerLoopGains(0.004, 900.0, 0.05, 9.0, 0.0005, 0.01, 1e-3, -2e-4)
    common = own + count * grid
    delta, V, V_g = 0.3, 112.0, V_N
    i = (V - V_g * np.exp(-1j * delta)) / common
    x = np.tile([delta, 0.0, V, i.real, i.imag], count)
    size, A = np.tile([1.0, 1.0, V_N, 30.0, 30.0], count), np.empty((5 * count, 5 * count))
    for k in range(5 * count):
        h = np.zeros(5 * count)
        h[k] = 1e-5 * size[k]
        up, down = (units_rates(x + sign * h, count, own, grid, V_g, gains) for sign in (1.0, -1.0))
        A[:, k] = (up - down) / (2.0 * h[k])
    P, Q = (np.array([value]) for value in power_flow(delta, V, V_g, common.real, common.imag))
    s = scenarios(robust_study(), 3.0, 1.0).take(np.array([0]))
    one = np.ones(1)
    s = replace(s, R=common.real * one, X=common.imag * one, V_g_rms=V_g * one, omega_g=OMEGA * one)
    s = replace(s, P=P, Q=Q, V_rms=V * one, delta=delta * one)
    apart = between_units(s, own.real, own.imag / OMEGA)
    assert float(power_flow(apart.delta, V, apart.V_g_rms, apart.R, apart.X)[0][0]) == pytest.approx(float(P[0]))
    modes = [np.linalg.eigvals(model_in(gains, at, LAGS).A[0]) for at in (s, *([apart] * (count - 1)))]
    left = list(np.linalg.eigvals(A))
    for mode in np.concatenate(modes):
        k = int(np.argmin(np.abs(np.array(left) - mode)))
        # Equal modes part by the root of the differences' rounding.
        assert abs(left.pop(k) - mode) < 3e-3 * max(abs(mode), 1.0)


def paired(decay: float) -> Study:
    """The 12.5 kVA converter with a transformer of 0.03 pu and a transient reactance of 0.3 pu above 5.5 Hz."""
    study = load_study("studies/survival/laboratory.toml")
    f, Z = study.filter, study.converter.Z_base
    spec = specification(study)
    return replace(
        study,
        filter=replace(f, L_2=f.L_2 + 0.03 * Z / study.converter.omega_n),
        inner_gains=study.inner_gains._replace(R_t=0.0, X_t=0.3 * Z),
        omega_t=2.0 * np.pi * 5.5,
        specification=replace(spec, differential_decay=decay, scr=(1.5, 20.0), x_over_r=(1.0, 5.0)),
    )


def test_a_node_keeps_the_decay_on_both_impedances() -> None:
    """Of some scenarios of a node: the decay that is asked for is kept with the impedance between the units, in the
    coupled model and in the sampled one of one unit there, and missed by name where nothing reaches it."""
    study = paired(3.0)
    spec, target = specification(study), study.controllers[-1].target
    rule = law_of(study, target, spec.aim)
    assert rule.apart == (study.filter.R_2, study.filter.L_2)
    every = scenarios_of_estimate(study, spec, 3.0, 5.0, target.P, target.Q)
    s = every.take(np.arange(0, len(every), 40))
    found = design_cell(rule, spec, s, textbook(robust_study()))
    assert found.figures.differential_decay >= 3.0
    gains = rule.gains(NormalisedGains(*(np.array([value]) for value in found.normalised)), s)
    whole = full_order_figures(study, gains, s, spec.settling_time, rule.apart)
    assert whole.worst().differential_decay == pytest.approx(found.figures.differential_decay, rel=0.03)
    missed = shortfalls(replace(spec, differential_decay=50.0), found.figures, found.inertia)
    assert missed["differential_decay"] == found.figures.differential_decay
    assert "differential_decay" not in shortfalls(spec, found.figures, found.inertia)


def test_an_interrupt_ends_more_than_one_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """The solver would take an interrupt for its own and return: the design would go on."""
    study = paired(3.0)
    spec, target = specification(study), study.controllers[-1].target
    rule = law_of(study, target, spec.aim)
    program = robust_program(rule, spec)
    s = scenarios_of_estimate(study, spec, 3.0, 5.0, target.P, target.Q).take(np.arange(3))
    ended = []

    def solver(**_: object) -> dict[str, ca.DM]:
        signal.raise_signal(signal.SIGINT)
        ended.append(True)
        return {"x": ca.DM(12 * [np.nan]), "lam_g": ca.DM([0.0])}

    monkeypatch.setattr(program, "_solver", solver)
    v, middle = program.variables, textbook(robust_study())
    with pytest.raises(KeyboardInterrupt):
        program.solve(middle, middle, s, 0.0, 1.0, v.high)
    assert ended


@pytest.mark.parametrize("slower", [0, 1, 2])
def test_the_program_tells_the_sides_of_a_decay_apart(slower: int) -> None:
    """The determinant of the slow states, with fast ones behind them, has the sign of the number of real modes that are
    slower than asked: by the eigenvalues and the determinants of NumPy."""
    rng = np.random.default_rng(slower)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    A = np.zeros((7, 7))
    A[:3, :3] = turn @ np.diag([*([0.4] * slower), *([-2.0] * (3 - slower))]) @ turn.T
    A[:3, 3:], A[3:, :3] = 0.1 * rng.standard_normal((3, 4)), rng.standard_normal((4, 3))
    A[3:, 3:] = np.diag([-200.0, -190.0, -60.0, -50.0]) + rng.standard_normal((4, 4))
    found = float(slow_determinant(ca.SX(ca.DM(A))))
    assert np.sum(np.linalg.eigvals(A).real > 0.0) == slower
    assert found == pytest.approx(-np.linalg.det(A) / np.linalg.det(A[3:, 3:]), rel=1e-9)
    assert (found > 0.0) == (slower % 2 == 0)


def test_the_units_against_each_other_are_proved_apart() -> None:
    """The function that is proved on boxes decays at random places of the region, by the coupled model of one unit
    between the units, which the proof does not use."""
    study = replace(paired(3.0), specification=None)
    spec = next(one for one in study.controllers if one.name == "angle_damped")
    region = Region((2.9, 3.1), (4.5, 5.5), (-5e3, 5e3), (-2e3, 2e3), 0.0)
    proved = certify(study, spec, region, apart=True, nodes_per_axis=3, fresh=200, budget=40_000)
    assert isinstance(proved, Certificate)
    assert proved.proof == "gap-free"
    schedule, c, f = schedule_of(study, spec), study.converter, study.filter
    rng = np.random.default_rng(5)
    for _ in range(20):
        scr, ratio = rng.uniform(2.9, 3.1), rng.uniform(4.5, 5.5)
        P, Q = np.array([rng.uniform(-5e3, 5e3)]), np.array([rng.uniform(-2e3, 2e3)])
        grid = Place(scr, ratio, study.scr_basis).grid(c)
        R, X = f.R_2 + grid.R_g, c.omega_n * (f.L_2 + grid.L_g)
        V, _ = operating_point(P, Q, c.V_rated_rms, R, X)
        gains = AtDesignPoint(schedule).gains_measured(grid.R_g, grid.L_g, P, Q, V)
        s = replace(
            scenarios(robust_study(), 3.0, 1.0).take(np.array([0])), P=P, Q=Q, V_rms=V, omega_g=np.array([OMEGA])
        )
        lags = study.power_lags._replace(tau_P=0.0, tau_Q=0.0)
        one = PowerLoopGains(*(np.full(1, value) for value in gains))
        A = model_in(one, between_units(s, f.R_2, f.L_2), lags).A[0]
        assert np.linalg.eigvals(A).real.max() < -proved.decay


def test_units_that_grow_against_each_other_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of designs with less and less bandwidth, the first one whose units decay against each other, late as it settles;
    without a pair the search ends where it did."""
    spec = replace(specification(robust_study()), settling_time=1.3, differential_decay=3.0)
    settles = {1.0: 1.4, 0.75: 1.5, 0.55: 1.9, 0.4: 2.6, 0.3: 3.6}
    apart = {1.0: -3.1, 0.75: -1.3, 0.55: 0.1, 0.4: 1.2, 0.3: 0.9}
    asked: list[float] = []

    def designs(task: Any, law: Any, s: Any, shares: Any = ()) -> Any:
        del task, law, s
        for share in (1.0, *shares):
            asked.append(share)
            yield SimpleNamespace(share=share, shortfalls={})

    def judged(pair: bool) -> Any:
        def of(task: Any, law: Any, s: Any, design: Any) -> CellRecord:
            del task, law, s
            missed = {"settling_time": settles[design.share]}
            missed |= {"differential_decay": apart[design.share]} if pair else {}
            whole: Any = SimpleNamespace(share=design.share, shortfalls=missed)
            return CellRecord(1.5, 5.0, whole, whole, None)

        return of

    monkeypatch.setattr(record, "designs_of", designs)
    for pair, kept, tried in ((True, 0.4, [1.0, 0.75, 0.55, 0.4]), (False, 1.0, [1.0, 0.75, 0.55])):
        asked.clear()
        monkeypatch.setattr(record, "with_full_order", judged(pair))
        task: Any = SimpleNamespace(spec=spec)
        nothing: Any = None
        best: Any = record._best(task, nothing, nothing).design
        assert (best.share, asked) == (kept, tried)
