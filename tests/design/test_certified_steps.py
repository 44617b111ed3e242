"""Certified steps against the nonlinear rest, samples of the sublevel set, trajectories, and a plain search."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import fsolve

from tests.gain_tables import table
from vsgdesign.artifacts.certificate_record import StepStatement, step_statement
from vsgdesign.certificate import Certificate, Region, certified_steps, certify, step_proof
from vsgdesign.certificate.lyapunov import largest_level_set
from vsgdesign.certificate.region import System, nodes, random_points
from vsgdesign.certificate.step_proof import prove_steps
from vsgdesign.certificate.step_terms import (
    ActingLimits,
    LevelShape,
    acting_limits,
    rest_current_pu,
    rest_shift,
    step_sizes,
)
from vsgdesign.equations.power_flow import power_flow
from vsgdesign.equations.power_loops import PowerLoopGains, References, frequency_at_rest, power_loops
from vsgdesign.runtime import closed_form_schedule
from vsgdesign.runtime.table import table_schedule
from vsgdesign.study.parameters import ControllerSpec, Study, load_study

Array = NDArray[np.float64]
REGION = Region((3.0, 20.0), (1.0, 10.0), (-3500.0, 3500.0), (-1000.0, 1000.0), error=0.2)
LIMITS = ActingLimits(1.15, 0.7, 1.3, "projection", soft=True, clips_V=True)


@cache
def study() -> Study:
    study = replace(load_study("studies/structures/study.toml"), scr_basis="impedance")
    converter = replace(study.converter, current_limit_pu=1.2)
    return replace(study, converter=converter, current_limiter="projection")


def controller() -> ControllerSpec:
    spec = next(spec for spec in study().controllers if spec.name == "angle_damped")
    return replace(spec, target=replace(spec.target, Q_droop=0.5))


@cache
def system(tabled: bool = False) -> System:
    if not tabled:
        return System(study(), closed_form_schedule(study(), controller().target))
    scr, ratio = np.array([1.5, 4.2, 20.0]), np.array([0.3, 2.0, 10.0])
    slope = 1.0 + 0.1 * np.log(scr[:, None] / 3.0) - 0.05 * np.log(ratio[None, :])
    columns = {"k_1": 15.8 * slope, "d_1": 6.6 / slope, "k_2": 4.0 * slope, "share_Q": 0.9 * slope}
    return System(study(), table_schedule(table("angle_damped", "poles", scr, ratio, columns, D_q=9.09)))


@cache
def shape() -> LevelShape:
    rng = np.random.default_rng(0)
    _, A = system().matrices(np.concatenate([nodes(REGION, 5), random_points(REGION, 500, rng)]))
    P, _ = largest_level_set(A, 0.6, (0.85, 1.25), 0.5)
    assert P is not None
    return LevelShape.of(P, 0.85, 1.25)


V_N, OMEGA_0 = 110.0, 100.0 * np.pi


def at_rest(R: float, X: float, V: float, gains: PowerLoopGains, refs: References, V_g: float, omega_g: float) -> Array:
    """δ, ω_i and V at rest, by a root search on the nonlinear equations."""

    def errors(x: Array) -> Array:
        flow = power_flow(x[0], x[2] * V, V_g, R, X)
        omega, domega, dV = power_loops(x[1] * OMEGA_0, x[2] * V, *flow, refs, gains)
        return np.array([omega - omega_g, domega, dV])

    x: Any = fsolve(errors, [np.clip(refs.P_ref * X / 3.0 / V / V_g, -1.0, 1.0), 1.0, 1.0], xtol=1e-13)
    return x * np.array([1.0, OMEGA_0, V])


@pytest.mark.parametrize(("changed", "size"), [("P_ref", 1.0), ("Q_ref", 1.0), ("V_g", 1e-4), ("omega_g", 1e-3)])
def test_the_shift_of_the_rest_is_that_of_the_nonlinear_equations(changed: str, size: float) -> None:
    """The rest before and after is solved for, and ω_r right after the step comes from the ω_i that did not move."""
    cells = system().cells(random_points(REGION, 5, np.random.default_rng(1)))
    assert len(cells.points) > 2
    for k in range(len(cells.points)):
        gains = PowerLoopGains(*(float(np.broadcast_to(v, len(cells.points))[k]) for v in cells.gains))
        P, Q = cells.points[k, 2:4]
        V = cells.V_rms[k]
        before = References(P, Q + gains.D_q * (V - V_N), OMEGA_0, V_N)
        refs = before._replace(**{changed: getattr(before, changed) + size}) if changed in before._fields else before
        V_g = study().grid_source.V_g_rms
        path = cells.R[k], cells.X[k], V, gains
        old = at_rest(*path, before, V_g, OMEGA_0)
        new = at_rest(*path, refs, V_g * (1.0 + size * (changed == "V_g")), OMEGA_0 + size * (changed == "omega_g"))
        # ω_r − ω_0 by its definition, with the references after the step.
        omega_r = [
            (omega_i - frequency_at_rest(refs, gains)) / (1.0 - gains.k_P * gains.D_p) for omega_i in (old[1], new[1])
        ]
        expected = np.array([new[0] - old[0], omega_r[1] - omega_r[0], new[2] - old[2]])
        A, B, C, D = (float(value[k]) for value in cells.jacobian)
        found = np.array(rest_shift((A, B, C, D), P, Q, V, gains, **{changed: size}))
        scale = np.array([1.0, 4.0, V_N])
        assert np.linalg.norm((found - expected) / scale) < 2e-3 * np.linalg.norm(expected / scale)


def test_no_point_of_the_sublevel_set_is_beyond_a_limit() -> None:
    """Brute force, in SI: every state of the set in which a certified step begins, on its own grid."""
    rng = np.random.default_rng(2)
    cells = system().cells(random_points(REGION, 60, rng))
    sizes = step_sizes(system(), cells, shape(), LIMITS)
    c = study().converter
    root = np.linalg.inv(np.linalg.cholesky(shape().P)).T
    x = rng.normal(size=(20_000, 3))
    x = root @ (x / np.linalg.norm(x, axis=1)[:, None]).T  # xᵀPx = 1
    fullest = np.zeros(2)
    for k in range(len(cells.points)):
        level = sizes[2, k] * np.sqrt(shape().P[0, 0])  # a phase jump of that size begins at (φ, 0, 0)
        delta, _, dV = level * x
        V = cells.V_rms[k]
        v = (V + dV * c.V_rated_rms) + 1j * V * delta
        P, Q = cells.points[k, 2:4]
        Y = 1.0 / (cells.R[k] + 1j * cells.X[k]) + 1j * c.omega_n * study().filter.C
        i_0 = (P - 1j * Q) / (3.0 * V) + 1j * c.omega_n * study().filter.C * V
        i = np.abs(i_0 + Y * (v - V)) / (c.S_rated / 3.0 / c.V_rated_rms)
        V_pu = V / c.V_rated_rms + dV
        assert i.max() <= 1.15 * (1.0 + 1e-9)
        assert V_pu.max() <= 1.3 + 1e-9
        assert V_pu.min() >= 0.7 - 1e-9
        fullest = np.maximum(fullest, [i.max() / 1.15, max(abs(V_pu.max() / 1.3), 0.7 / V_pu.min())])
    assert fullest[0] > 0.99  # and the set is no smaller than it has to be


def test_the_largest_set_is_that_of_a_plain_search() -> None:
    """An oscillator with V beside it: of all N with AN + NAᵀ + 2αN ⪯ 0 and N_11 ≤ 1, two numbers on a fine grid."""
    k, d, decay = 15.8, 6.6, 0.5
    A = np.array([[0.0, 1.0, 0.0], [-k, -d, 0.0], [0.0, 0.0, -4.0]])
    P, _ = largest_level_set(A[None], decay, (1.0, 1.0), 0.25)
    assert P is not None
    cross, second = np.meshgrid(np.linspace(-3.0, 0.0, 301), np.linspace(0.1, 60.0, 3001))
    m11 = 2.0 * cross + 2.0 * decay
    m12 = second - k - d * cross + 2.0 * decay * cross
    m22 = -2.0 * k * cross - 2.0 * d * second + 2.0 * decay * second
    holds = (m11 <= 0.0) & (m22 <= 0.0) & (m11 * m22 >= m12**2)
    best = np.where(holds, second - cross**2, 0.0).max()
    found = np.linalg.inv(P)
    assert found[0, 0] == pytest.approx(1.0, abs=1e-4)
    assert found[2, 2] == pytest.approx(0.25, abs=1e-4)
    assert best <= np.linalg.det(found[:2, :2]) * (1.0 + 1e-6)
    assert np.linalg.det(found[:2, :2]) < 1.01 * best  # the grid's best is a little inside
    assert largest_level_set(A[None], 20.0, (1.0, 1.0), 0.25)[0] is None


@pytest.mark.parametrize(("tabled", "error_Z"), [(False, 0.0), (True, 0.0), (False, 0.06), (True, 0.06)])
def test_what_is_proved_on_boxes_holds_at_every_sample(tabled: bool, error_Z: float) -> None:
    ratio = (1.0, 3.0) if error_Z == 0.0 else (4.0, 10.0)
    part = replace(REGION, scr=(8.0, 20.0), x_over_r=ratio, error=0.1, error_Z=error_Z)
    here = replace(system(tabled), region=part)
    rng = np.random.default_rng(3)
    some = here.cells(random_points(part, 20, rng))
    sampled = step_sizes(here, some, shape(), LIMITS).min(axis=1)
    typical = float(rest_current_pu(here, some).max())
    proof = prove_steps(here, part, shape(), LIMITS, sampled, typical, 60_000)
    assert proof.whole
    fresh = here.cells(np.concatenate([nodes(part, 7), random_points(part, 20_000, rng)]))
    least = step_sizes(here, fresh, shape(), LIMITS).min(axis=1)
    assert (proof.sizes <= least).all()
    assert (proof.sizes >= 0.6 * least).all()
    # What few points allow is not proved where others allow less.
    assert (proof.sampled < sampled).all()


@pytest.mark.parametrize("kind", range(5))
def test_boxes_alone_refuse_a_step_that_is_too_large(monkeypatch: pytest.MonkeyPatch, kind: int) -> None:
    """Without the samples in undecided boxes: a size beyond what some cell allows is given up, not proved."""
    monkeypatch.setattr(step_proof, "_PLACES", 0)
    part = replace(REGION, scr=(10.0, 14.0), x_over_r=(2.0, 3.0), error=0.05)
    cells = system().cells(np.concatenate([nodes(part, 9), random_points(part, 20_000, np.random.default_rng(5))]))
    least = step_sizes(system(), cells, shape(), LIMITS).min(axis=1)
    asked = np.where(np.arange(5) == kind, 1.15, 0.5) * least
    proof = prove_steps(system(), part, shape(), LIMITS, asked, 0.8, 40_000)
    assert not proof.whole or proof.sizes[kind] <= least[kind]
    # 95 and 90 % of it are too much, 80 % of it is not.
    assert proof.sizes[kind] == pytest.approx(0.8 * asked[kind])
    assert proof.whole


def test_too_few_boxes_prove_nothing_and_a_limit_at_rest_leaves_no_step() -> None:
    part = replace(REGION, scr=(8.0, 20.0))
    ones = np.full(5, 0.1)
    assert not prove_steps(system(), part, shape(), LIMITS, ones, 0.8, 100).whole
    tight = replace(LIMITS, current_pu=0.5)
    assert not prove_steps(system(), part, shape(), tight, ones, 0.8, 10_000).sizes.any()


def test_a_trajectory_with_gains_that_jump_stays_within_the_limits() -> None:
    """The linear loops from a certified step on, with another estimate every 50 ms; five times the step does not."""
    rng = np.random.default_rng(4)
    s, c = system(), study().converter
    for factor, within in ((1.0, True), (5.0, False)):
        worst = 0.0
        for _ in range(12):
            points = np.repeat(random_points(REGION, 1, rng), 20, axis=0)
            points[:, 4:] = rng.uniform(-0.2, 0.2, (20, 2))
            cells = s.cells(points)
            if len(cells.points) == 0:
                continue
            size = step_sizes(s, cells, shape(), LIMITS)[4].min()
            A = s.matrices(points)[1]
            A_0, B_0, C_0, D_0 = (value[0] for value in cells.jacobian)
            gains = type(cells.gains)(*(float(np.broadcast_to(v, 20)[0]) for v in cells.gains))
            P, Q = points[0, 2:4]
            x = (
                -factor
                * size
                * np.array(rest_shift((A_0, B_0, C_0, D_0), P, Q, cells.V_rms[0], gains, omega_g=1.0))
                / s.scale
            )
            Y = 1.0 / (cells.R[0] + 1j * cells.X[0]) + 1j * c.omega_n * study().filter.C
            V = cells.V_rms[0]
            i_0 = (P - 1j * Q) / (3.0 * V) + 1j * c.omega_n * study().filter.C * V
            for matrix in A:
                step = expm(matrix * 2e-3)
                for _ in range(25):
                    x = step @ x
                    i = i_0 + Y * (x[2] * c.V_rated_rms + 1j * V * x[0])
                    worst = max(worst, abs(i) / (c.S_rated / 3.0 / c.V_rated_rms))
        assert (worst <= 1.15) == within


def test_the_limits_of_each_limiter() -> None:
    found = acting_limits(study())
    assert (found.current_pu, found.V_low_pu, found.V_high_pu) == (
        pytest.approx(1.15),
        pytest.approx(0.7),
        pytest.approx(1.3),
    )
    circular = acting_limits(replace(study(), current_limiter="circular"))
    assert (circular.current_pu, circular.V_low_pu, circular.soft) == (pytest.approx(1.2), None, False)
    none = acting_limits(replace(study(), converter=replace(study().converter, current_limit_pu=None)))
    assert (none.current_pu, none.V_high_pu) == (None, pytest.approx(1.3))


@cache
def stated() -> tuple[Certificate, StepStatement]:
    spec = controller()
    found = certify(study(), spec, REGION, budget=0, nodes_per_axis=5, fresh=2000)
    assert isinstance(found, Certificate)
    return found, certified_steps(study(), spec, found, budget=3_000)


def test_a_statement_and_its_document() -> None:
    certificate, found = stated()
    assert step_statement(found.as_document()) == found
    assert len(found.rows) == 9
    assert found.reason is None
    assert found.decay == pytest.approx(0.25 * certificate.decay)
    by_load = [[row for row in found.rows if row.P[1] == P] for P in (1750.0, 2625.0, 3500.0)]
    for light, heavy in zip(by_load[0], by_load[2], strict=True):
        assert light.scr == heavy.scr
        assert (heavy.phase or 0.0) < (light.phase or 0.0)  # less room is left
    record = replace(certificate, steps=found).as_record()
    assert record.steps == found
    spoiled = found.as_document() | {"rows": [{"scr": [1, 2]}]}
    with pytest.raises(ValueError, match="is not what certify writes"):
        step_statement(spoiled)
