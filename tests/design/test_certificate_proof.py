"""What the proof on boxes encloses, against samples, and that it refuses what is not true."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from vsgdesign.design.certificate import Certificate, Region, certify
from vsgdesign.design.certificate.certify import Motion
from vsgdesign.design.certificate.enclosure import enclose, estimate_box
from vsgdesign.design.certificate.lyapunov import residual
from vsgdesign.design.certificate.proof import Boxes, bound_on, prove
from vsgdesign.design.certificate.region import System, point_of, random_points
from vsgdesign.design.certificate.taylor_form import TaylorForm, box_variables
from vsgdesign.parameters import ControllerSpec, Study, load_study
from vsgdesign.runtime import closed_form_schedule

STUDY = replace(load_study("studies/structures/study.toml"), scr_basis="impedance")
POWERS = {"P": (-4500.0, 4500.0), "Q": (-2000.0, 2000.0)}


def controller(name: str, **target: float) -> ControllerSpec:
    spec = next(spec for spec in STUDY.controllers if spec.name == name)
    return replace(spec, target=replace(spec.target, **target))


def system(name: str, study: Study = STUDY, **target: float) -> System:
    return System(study, closed_form_schedule(study, controller(name, **target).target))


def value_at(form: TaylorForm, t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The polynomial of a form (of one box) at places t (M, d), and the bound on what is left."""
    i, j = np.triu_indices(t.shape[1])
    return form.centre + t @ form.linear[:, 0] + (t[:, i] * t[:, j]) @ form.square[:, 0], form.rest.sum(axis=0)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(0.3, 3.0), min_size=3, max_size=3),
    st.lists(st.floats(0.01, 0.25) | st.just(0.0), min_size=3, max_size=3).filter(any),
    st.integers(0, 2**31),
)
def test_forms_hold_every_value(middle: list[float], radius: list[float], seed: int) -> None:
    def formula(x: Any, y: Any, z: Any) -> Any:
        return (x * y - z) / (x * x + z + 1.0) + np.sqrt(x + y) * np.sin(z) - np.cos(x * z) + (y - 2.0) * x

    c, r = np.array(middle), np.array(radius) * np.array(middle)
    moving = r > 0.0
    t = np.random.default_rng(seed).uniform(-1.0, 1.0, (100, 3))
    t[:8] = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    form = formula(*box_variables((c - r)[None], (c + r)[None]))
    polynomial, rest = value_at(form, t[:, moving])
    exact = formula(*(c + r * t).T)
    # 1e-12: rounding, which forms do not enclose.
    assert np.all(np.abs(exact - polynomial) <= rest + 1e-12)
    low, high = form.limits
    assert np.all((exact >= low - 1e-12) & (exact <= high + 1e-12))


def test_what_is_left_shrinks_with_the_cube_of_the_box() -> None:
    def rest(width: float) -> float:
        x, y = box_variables(np.array([[1.0 - width, 2.0 - width]]), np.array([[1.0 + width, 2.0 + width]]))
        return float((np.sin(x * y) / y).rest.sum())

    assert rest(0.05) / rest(0.1) == pytest.approx(1.0 / 8.0, rel=0.2)


def test_a_function_outside_its_domain_is_never_a_proof() -> None:
    (x,) = box_variables(np.array([[-0.1]]), np.array([[0.2]]))
    with np.errstate(invalid="ignore"):
        low, high = (1.0 / x).limits
    assert not (np.isfinite(low) & np.isfinite(high)).any()


@pytest.mark.parametrize("name", ["angle_damped", "decoupled", "published"])
@pytest.mark.parametrize("basis", ["impedance", "reactance"])
def test_an_enclosure_of_a_point_is_the_state_matrix(name: str, basis: str) -> None:
    """Two writings of the same loops: the schedule's own gains, and the form about an exact estimate."""
    s = system(name, replace(STUDY, scr_basis=basis))
    ratio = (1.0, 20.0) if name == "published" else (0.3, 20.0)
    region = Region((2.0, 20.0), ratio, **POWERS, error=0.2)
    points, A = s.matrices(random_points(region, 60, np.random.default_rng(0)))
    estimates = estimate_of(s, points)
    found = enclose(s, region, estimates - 1e-10, estimates + 1e-10)
    assert not found.empty.any()
    np.testing.assert_allclose(found.weakness.centre, points[:, 0], rtol=1e-9)
    for rows in found.corners:
        for i, row in enumerate(rows):
            for j, value in enumerate(row):
                centre = value.centre if isinstance(value, TaylorForm) else value
                # The box is 1e-10 wide; the published law divides by an A that can be small.
                np.testing.assert_allclose(centre, A[:, i, j], atol=1e-6)


def estimate_of(s: System, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of the region as points of the proof's boxes."""
    size = points[:, 0] / (np.sin(points[:, 1]) if s.study.scr_basis == "reactance" else 1.0)
    R = size * np.cos(points[:, 1]) * (1.0 + points[:, 4])
    X = size * np.sin(points[:, 1]) * (1.0 + points[:, 5])
    S = s.study.converter.S_rated
    return np.stack([np.hypot(R, X), np.arctan2(X, R), points[:, 2] / S, points[:, 3] / S, *points[:, 4:].T], axis=1)


@pytest.mark.parametrize("rate", [np.inf, 1.0])
def test_the_bound_on_a_box_is_above_every_point_in_it(rate: float) -> None:
    s = system("angle_damped", Q_droop=0.5)
    region = Region((2.0, 20.0), (0.3, 20.0), **POWERS, error=0.2, rate=rate)
    motion = Motion(region, bool(np.isfinite(rate)))
    P = np.stack([np.diag([3.0, 1.0, 2.0]), 0.2 * np.ones((3, 3)), np.diag([0.1, -0.2, 0.1])])
    P = P if motion.moving else P[:1]
    points, A = s.matrices(random_points(region, 4000, np.random.default_rng(2)))
    worst = residual(A, motion.family(points), P, 1.0)
    estimates = estimate_of(s, points)
    width = np.array([0.02, 0.05, 0.1, 0.1, 0.1, 0.1])
    chosen = estimates[:40]
    bound, _, empty = bound_on(s, region, motion.weights, P, 1.0, Boxes(chosen - width, chosen + width))
    assert not empty.any()
    met = 0
    for k, centre in enumerate(chosen):
        inside = (np.abs(estimates - centre) <= width).all(axis=1)
        if rate == np.inf:
            # The bound is relative to the P at the middle of the box, which is the only one here.
            assert not worst[inside].max() > bound[k]
        else:
            assert not (bound[k] < 0.0 < worst[inside].max())
        met += int(np.isfinite(bound[k]))
    assert met > 20


def test_gap_free_where_it_can_be_and_refused_where_it_is_false() -> None:
    region = Region((4.0, 5.0), (1.0, 1.3), (500.0, 1000.0), (-200.0, 200.0), 0.1)
    spec = controller("angle_damped", Q_droop=0.5)
    found = certify(STUDY, spec, region, nodes_per_axis=5, fresh=2000, budget=4000)
    assert isinstance(found, Certificate)
    assert found.proof == "gap-free"
    assert found.gap.share == 0.0
    assert 2.0 < found.decay <= found.sampled
    assert found.boxes > 0
    # The same P at a decay that some points of the region miss, and another P: boxes are left.
    s, motion = system("angle_damped", Q_droop=0.5), Motion(region, False)
    low, high = estimate_box(region, s)
    whole = Boxes(low[None], high[None])
    assert len(prove(s, region, motion.weights, found.P, [1.2 * found.sampled], whole, 300).left) > 0
    assert len(prove(s, region, motion.weights, np.eye(3)[None], [found.decay], whole, 300).left) > 0


def test_a_function_that_follows_the_grid_falls_along_a_bounded_ramp() -> None:
    """xᵀP(ρ)x of the published loops while SCR and X/R move at the full rate."""
    rate = 0.5
    region = Region((2.0, 20.0), (1.0, 20.0), **POWERS, rate=rate)
    spec = controller("published")
    found = certify(STUDY, spec, region, nodes_per_axis=7, fresh=1000, budget=0)
    common = certify(STUDY, spec, replace(region, rate=np.inf), nodes_per_axis=7, fresh=1000, budget=0)
    assert isinstance(found, Certificate)
    assert isinstance(common, Certificate)
    assert found.decay > common.decay
    assert found.P.shape == (3, 3, 3)
    s, motion = system("published"), Motion(region, True)
    rng, dt = np.random.default_rng(3), 0.01

    def level(point: NDArray[np.float64], x: NDArray[np.float64]) -> float:
        return float(x @ np.tensordot(motion.family(point[None]).weights[0], found.P, 1) @ x)

    for scr, ratio, up in ((2.1, 1.1, 1.0), (19.0, 19.0, -1.0), (2.1, 19.0, 1.0)):
        x = rng.normal(size=3)
        before: float | None = None
        for step in range(120):
            grid = np.array([[scr, ratio]]) * np.exp(
                up * rate * dt * step * np.array([[1.0, 1.0 if ratio < 10 else -1.0]])
            )
            point = point_of(np.concatenate([grid, [[1500.0, 500.0, 0.0, 0.0]]], axis=1))
            _, A = s.matrices(point)
            now = level(point[0], x)
            # The grid is held for 10 ms and then moves: 1e-3 for what that differs from moving all the time.
            assert before is None or now <= before * np.exp(-2.0 * found.decay * dt) * (1.0 + 1e-3)
            before = now
            x = expm(A[0] * dt) @ x
