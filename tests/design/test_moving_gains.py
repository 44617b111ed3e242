"""Gains that change on a grid that rests: the proof's forms against the sampled model's own matrices, and what a
function promises against sequences of gains."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.design.full_order_problems import ALPHA, closed_form, laboratory
from tests.design.test_full_order_proof import _at, determinants
from vsgdesign.artifacts.certificate_record import CertificateCell
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.boxes import Part
from vsgdesign.certificate.full_order.cells import GOOD, Arcs, cells_of
from vsgdesign.certificate.full_order.kernel import enclosed
from vsgdesign.certificate.full_order.looking import CellGroup
from vsgdesign.certificate.full_order.points import at_rest, rests_at
from vsgdesign.certificate.full_order.programs import DIMENSIONS
from vsgdesign.certificate.full_order.search import Found, Problem, beginning, search
from vsgdesign.certificate.moving import statement
from vsgdesign.certificate.moving.levels import StepsAtPlaces, common_function, dwell_time, level_set, modal, shortfall
from vsgdesign.certificate.moving.looking import MovingProblem, MovingPrograms, with_middle
from vsgdesign.certificate.moving.places import (
    DROOPS,
    ball_of,
    estimates,
    feeds,
    kind_of,
    loops_at,
    middle_error,
    powers_of,
    with_estimates,
)
from vsgdesign.certificate.moving.statement import MovingProof, Sampled, prove_moving
from vsgdesign.certificate.proof import arrays
from vsgdesign.certificate.region import Region
from vsgdesign.certificate.taylor_kernel import rows
from vsgdesign.equations.frames import rms_to_peak, rotate_back
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.equations.inner_loops import current_loop, voltage_loop
from vsgdesign.equations.limiter_interface import GridEstimate, LimiterView
from vsgdesign.equations.limiters.projection import ProjectionMemory, projection_limit
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.full_order import pack
from vsgdesign.report.gain_table.full_order import moving_text
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.pipeline.one_unit import as_unit


@functools.cache
def units_apart() -> Any:
    """Equal units against each other with gains in closed form."""
    region = Region((2.0, 20.0), (1.0, 20.0), (-11.25e3, 11.25e3), (-3.75e3, 3.75e3), 0.2)
    study, spec = _units()
    system, _ = prepared(study, spec, region, NOTHING, None, None)
    study, system = study.with_limit_of(spec), replace(system, apart=True)
    return study, Problem.of(study, system, region, ALPHA)


def _units() -> Any:
    """A unit of the plant, and its controller with gains in closed form."""
    study = replace(as_unit(load_study("studies/plant/study.toml"), "a test"), scr_basis="impedance")
    return study, replace(study.controllers[-1], schedule="closed_form")


PLACES = {
    laboratory: np.array([[0.25, np.arctan(3.0), 5e3, 1e3], [0.45, np.arctan(2.5), 6e3, 0.4e3]]),
    closed_form: np.array([[0.2, np.arctan(2.0), 3e3, 1e3], [0.5, np.arctan(6.0), -2e3, 0.5e3]]),
    units_apart: np.array([[0.2, np.arctan(5.0), 5e3, 1e3], [0.12, np.arctan(2.0), -4e3, -1e3]]),
}
MADE = {"published law": laboratory, "angle-damped": closed_form, "units against each other": units_apart}


def moving(made: Any, alpha: float = ALPHA) -> tuple[Any, MovingProblem]:
    """The problem of changing gains, with weights for the two places."""
    study, problem = made()
    problem = Problem.of(study, problem.system, problem.region, alpha)
    ball = ball_of(study, problem.system, problem.region, PLACES[made], alpha)
    return study, MovingProblem.about(problem, MovingPrograms.of(problem.system, problem.region), ball)


@pytest.mark.parametrize("made", MADE.values(), ids=list(MADE))
def test_gains_act_on_two_powers_and_three_states_alone(made: Any) -> None:
    """What another estimate changes of A is −T_s times what it changes of the feeds, times the two powers; with droops
    that stay the same the powers hold them, else what they hold of them is the same for all gains."""
    study, problem = made()
    errors = np.vstack([np.zeros((1, 2)), estimates(problem.region, 1.2, 3)])
    loops = loops_at(study, problem.system, with_estimates(PLACES[made][:1], errors))
    G, T_s, n = feeds(loops.at.gains), study.converter.T_s, len(loops.states)
    assert n == {laboratory: 15, closed_form: 17, units_apart: 19}[made]
    powers = powers_of(loops, T_s)[0]
    if kind_of(problem.system) != DROOPS:
        gains = loops.at.gains
        powers[0, loops.states.index("omega_r")] -= gains.D_p[0]
        powers[1, loops.states.index("V")] -= gains.D_q[0]
    acts = np.zeros((n, 3))
    acts[loops.moved, range(3)] = T_s
    wanted = loops.A[0] - acts @ (G - G[0]) @ powers
    scale = np.abs(loops.A).max(axis=0)
    assert (np.abs(loops.A - wanted) <= 1e-9 * scale + 1e-15).all()
    assert np.abs((loops.A[1] - loops.A[0])[loops.moved]).max() > 1e-9


def _at_middle(study: Any, problem: MovingProblem, place: Any) -> Any:
    """The loops of the middle and of a lattice of estimates at a place, the unit of power, and V."""
    errors = np.vstack([np.full((1, 2), middle_error(problem.region)), estimates(problem.region, float(place[1]), 7)])
    loops = loops_at(study, problem.system, with_estimates(place[None], errors))
    V = loops.at.V_rms[0]
    return loops, V**2 / (place[0] * study.converter.Z_base), V


def true_ball(study: Any, problem: MovingProblem, place: Any) -> float:
    """The largest Δ of a lattice of estimates at a place, from the product's gains."""
    loops, unit, V = _at_middle(study, problem, place)
    own = np.array([1.0, 1.0, 1.0 / V])[:, None]
    off = ((feeds(loops.at.gains) - feeds(loops.at.gains)[0]) * unit * own)[1:, problem.ball.first :]
    inside = np.linalg.inv(problem.ball.left) @ off @ np.linalg.inv(problem.ball.right)
    return float(np.linalg.norm(inside, 2, axis=(1, 2)).max())


def true_gain(study: Any, problem: MovingProblem, place: Any, z: Any, reach: float) -> Any:
    """f (n,) and the difference of :eq:`moving-difference` at z (n,), from the product's matrices alone."""
    loops, unit, V = _at_middle(study, problem, place)
    middle, count, T_s = loops.points[:1], len(z), study.converter.T_s
    gains = type(loops.at.gains)(*(np.repeat(value[:1], count) for value in loops.at.gains))
    f = determinants(study, problem, np.repeat(middle, count, 0), gains, np.full(count, V), z)
    n = len(loops.states)
    acts = np.zeros((n, 3))
    acts[loops.moved, range(3)] = T_s * np.array([1.0, 1.0, V])
    powers = powers_of(loops, T_s)[0] / unit
    if kind_of(problem.system) != DROOPS:
        powers[0, loops.states.index("omega_r")] -= loops.at.gains.D_p[0] / unit
        powers[1, loops.states.index("V")] -= loops.at.gains.D_q[0] / unit
    answers = [powers @ np.linalg.solve(at * np.eye(n) - loops.A[0], acts + 0j) for at in z]
    sizes = np.array([np.linalg.norm(problem.ball.right @ one @ problem.ball.columns) for one in answers])
    return f, np.abs(f) ** 2 * (1.0 - (reach * sizes) ** 2)


@pytest.mark.parametrize("made", MADE.values(), ids=list(MADE))
def test_forms_hold_the_small_gain_of_the_model(made: Any) -> None:
    """|f|² − β²|n|² on small boxes and arcs holds the value of the product's matrices, and β all estimates."""
    study, problem = moving(made)
    rng, c, d, region = np.random.default_rng(8), study.converter, DIMENSIONS, problem.region
    error, T_s = middle_error(region), c.T_s
    for place in PLACES[made]:
        middle = with_estimates(place[None], np.full((1, 2), error))
        rest = at_rest(study, problem.system, middle)
        Z, V = place[0] * c.Z_base, rest.V_rms[0]
        x = np.array([place[0], place[1], error, error, place[2] * Z / V**2, place[3] * Z / V**2])
        width, t = np.array([0.005, 0.005, 0.0, 0.0, 0.01, 0.01]), rng.uniform(-1.0, 1.0, d)
        low, high = x - width * (1.0 + t[:6]), x + width * (1.0 - t[:6])
        (cell,) = cells_of(problem.tapes, low[None, :2], high[None, :2], [Arcs.coarsest(T_s)])
        assert cell.state == GOOD
        group = CellGroup.of([cell])
        part = Part(low[None], high[None], np.zeros(1, int), np.zeros(1, int), np.array([2.0]), np.ones(1))
        piece = np.argmax(problem._pieces(group, part.low, part.high, part), axis=0)
        reach, _ = problem.reach(group, part, piece)
        most = true_ball(study, problem, place)
        assert most <= reach[0] < 1.3 * most
        numbers, program = problem.moving.gains[piece[0]]
        gains = problem._forms((numbers, program), group, part.low, part.high, part)
        given = np.zeros((1, 1, rows(d)))
        given[0, 0, 0] = reach[0] ** 2
        arcs = np.array([0, 3, 9, 14, 20])
        forms = np.zeros((len(arcs), 2, rows(d)))
        many = [np.repeat(value, len(arcs), axis=0) for value in (low[None], high[None])]
        every = np.repeat(np.concatenate([gains, given], axis=1), len(arcs), axis=0)
        enclosed(tuple(many), every, group.functions, arcs, arrays(problem.arcs[piece[0]]), d, forms)
        edges = cell.edges
        omega = 0.5 * (edges[arcs] + edges[arcs + 1]) + 0.5 * (edges[arcs + 1] - edges[arcs]) * t[6]
        z = np.exp((-problem.loop.alpha + 1j * omega) * T_s)
        f, wanted = true_gain(study, problem, place, z, float(reach[0]))
        for k, truth in enumerate(wanted):
            value, radius = _at(forms[k, 0], t, d)
            assert abs(value - truth) <= radius
            assert radius < 0.5 * abs(f[k]) ** 2


def test_cells_are_proved_and_a_rate_beyond_the_decay_is_not() -> None:
    """The laboratory: at half of the decay all of a cell is proved, beyond that of its slowest estimate nothing is."""
    for alpha, proved in ((1.0, True), (3.5, False)):
        _, problem = moving(laboratory, alpha)
        one = next(one for one in beginning(problem) if one.low[0] > 1 / 4.3)
        waiting = [replace(one, boxes=with_middle(one.boxes, middle_error(problem.region)))]
        found = Found()
        left = search(problem, waiting, found, most_looks=60)
        if proved:
            assert not left
            assert not found.left
        else:
            assert found.proved == 0.0


def test_a_function_falls_under_every_sequence_of_gains() -> None:
    """One function for a place of the angle-damped loop: 60 random sequences of its gains, estimates that no matrix of
    the search has, and dwell times of two grids that take turns."""
    study, problem = closed_form()
    rng, T_s, functions = np.random.default_rng(2), study.converter.T_s, []
    for place in PLACES[closed_form]:
        errors = np.vstack([np.zeros((1, 2)), estimates(problem.region, float(place[1]), 5)])
        A = loops_at(study, problem.system, with_estimates(place[None], errors)).A
        decay = 0.5 * float(-np.log(np.abs(np.linalg.eigvals(A)).max())) / T_s
        rho = float(np.exp(-decay * T_s))
        P = common_function(A, rho)
        assert P is not None
        functions.append((P, decay))
        others = rng.uniform(-problem.region.error, problem.region.error, (30, 2))
        every = loops_at(study, problem.system, with_estimates(place[None], others)).A
        assert shortfall(every, P, rho) < 0.0
        turn = np.linalg.cholesky(P).T
        x = np.linalg.solve(turn, rng.normal(size=(len(turn), 60)))
        before = np.linalg.norm(turn @ x, axis=0)
        for k in rng.integers(len(every), size=200):
            x = every[k] @ x
            after = np.linalg.norm(turn @ x, axis=0)
            assert (after <= rho * before * (1.0 + 1e-9)).all()
            before = after
    (P, one), (Q, other) = functions
    assert dwell_time(P, 7.0 * P, one) == pytest.approx(0.0, abs=1e-6)
    assert dwell_time(P, Q, min(one, other)) == pytest.approx(dwell_time(5.0 * P, Q, min(one, other)), rel=1e-6)
    assert dwell_time(P, Q, min(one, other)) > 0.01


def test_the_semidefinite_program_finds_what_the_modes_do_not() -> None:
    """Two oscillators whose modes are no common ones, and two that have no function in common: turns of 90° in opposite
    directions of unequal axes grow together."""
    slow = np.array([[0.0, 0.6], [-0.9, 0.0]])
    A = np.stack([slow, slow.T])
    assert shortfall(A, modal(A[0]), 0.95) > 0.0
    P = common_function(A, 0.95)
    assert P is not None
    assert shortfall(A, P, 0.95) < 0.0
    fast = np.array([[0.0, 2.0], [-0.4, 0.0]])
    assert np.abs(np.linalg.eigvals(fast)).max() < 0.95 < np.abs(np.linalg.eigvals(fast @ fast.T)).max()
    assert common_function(np.stack([fast, fast.T]), 0.95) is None


@pytest.mark.parametrize("limiter", ["circular", "projection"])
def test_a_level_set_keeps_every_limit_away(limiter: str) -> None:
    """At a place of the laboratory: on the edge of the set, the current that the voltage loop asks for, the voltage
    that the current loop sets and, for a projection, the test current are below their limits, by the equations of the
    loops and finite differences alone. A projection's own law then finds nothing to limit."""
    study, problem = laboratory()
    study = replace(study, current_limiter=limiter)
    place = PLACES[laboratory][0]
    level = level_set(study, problem.system, problem.region, place)
    assert level is not None
    assert (level.sizes > 0.01).all()
    errors = np.random.default_rng(4).uniform(-0.2, 0.2, (20, 2))
    points = with_estimates(place[None], np.vstack([np.zeros((1, 2)), errors]))
    loops, T_s = loops_at(study, problem.system, points), study.converter.T_s
    assert loops.states == level.states
    assert shortfall(loops.A, level.P, float(np.exp(-level.decay * T_s))) < 0.0
    _, states, _ = rests_at(study, problem.system, points[:1])
    names = [name for name in level.states if name != "omega_r"]
    rest = dict(zip(names, pack(names, states)[0], strict=True))

    def shares(x: Any) -> Any:
        return _of_limits(study, {**rest, **{k: rest.get(k, 0.0) + v for k, v in zip(level.states, x, strict=True)}})

    n, inverse = len(level.states), np.linalg.inv(level.P)
    assert (shares(np.zeros(n)) < 1.0).all()
    size = np.sqrt(np.diag(inverse))
    slopes = np.array([(shares(1e-6 * unit) - shares(-1e-6 * unit)) / 2e-6 for unit in np.diag(size)]) / size[:, None]
    far = [inverse @ slope / np.sqrt(slope @ inverse @ slope) for slope in slopes.T]
    rng, half = np.random.default_rng(6), np.linalg.cholesky(inverse)
    others = [half @ (y / np.linalg.norm(y)) for y in rng.normal(size=(100, n))]
    # The statement is linear: a hundredth of the way there may use a hundredth of the room.
    base = shares(np.zeros(n))
    found = np.array([(shares(0.01 * x) - base) / (0.01 * (1.0 - base)) for x in (*far, *others)])
    assert 0.9 < found.max() < 1.001  # the set is as large as one of the limits lets it be
    if limiter == "projection":
        for x in (*far, *others):
            near = {**rest, **{k: rest.get(k, 0.0) + 0.9 * v for k, v in zip(level.states, x, strict=True)}}
            assert _limited(study, near, points[1:], loops) == 0.0
        far_off = {**rest, **{k: rest.get(k, 0.0) + 20.0 * v for k, v in zip(level.states, far[2], strict=True)}}
        assert _limited(study, far_off, points[1:], loops) == 1.0


def _limited(study: Any, at: dict[str, Any], points: Any, loops: Any) -> float:
    """Whether a projection whose low-passes are at rest limits anything in one sample, with any of some estimates."""
    settings, found = study.controller_settings(), 0.0
    _, view = _asked(study, at)
    v, i_g = view["v"], view["i_g"]
    omega = study.converter.omega_n
    measured: Any = (*v, *view["i_s"], *i_g, 0.0, 0.0, *view["i_want"])
    rest: Any = (at["V"], omega, 0.0, 0.0, 1.0, 0.0)
    refs = References(0.0, 0.0, omega, study.converter.V_rated_rms)
    seen = LimiterView(*measured, *rest)
    at_rest_, gains = loops.at, PowerLoopGains(0.0, 0.0, 0.0, 0.0)
    for errors in points[:, 4:]:
        grid = GridEstimate(at_rest_.R_g[0] * (1.0 + errors[0]), at_rest_.L_g[0] * (1.0 + errors[1]))
        R, X = grid.R_g + settings.limiter.R_2, refs.omega_0 * (grid.L_g + settings.limiter.L_2)
        i_w = i_g[0] + 1j * i_g[1] + 1j * settings.omega_C * (v[0] + 1j * v[1])
        i_w += (rms_to_peak(at["V"]) - v[0] - 1j * v[1]) / settings.limiter.Z_v * abs(R + 1j * X) / (R + 1j * X)
        memory = ProjectionMemory(i_w.real, i_w.imag, v[0], v[1], refs.omega_0, 0.0)
        found = max(found, float(projection_limit(memory, seen, grid, refs, gains, settings).limited))
    return found


def _of_limits(study: Any, at: dict[str, Any]) -> Any:
    """The shares of their limits that the wanted current and the bridge voltage are at; and the test current of a
    projection with an exact estimate."""
    shares, view = _asked(study, at)
    if study.current_limiter != "projection":
        return shares
    v, i_g = (view[name][0] + 1j * view[name][1] for name in ("v", "i_g"))
    settings = study.controller_settings()
    turn = np.exp(1j * np.arctan(3.0))  # the grid of the place: its X/R is that of the path, with little behind it
    i_w = i_g + 1j * settings.omega_C * v + (rms_to_peak(at["V"]) - v) / (settings.limiter.Z_v * turn)
    return np.append(shares, abs(i_w) / settings.limiter.i_soft_pk)


def _asked(study: Any, at: dict[str, Any]) -> Any:
    """The shares of their limits that the wanted current and the bridge voltage are at, and what was measured."""
    settings, circuit = study.controller_settings(), study.circuit()
    turn: Any = np.cos(at["delta"]), np.sin(at["delta"])
    at_node: Any = [(at[f"i_s_{axis}"], at[f"v_c_{axis}"], at[f"i_g_{axis}"], circuit) for axis in "dq"]
    pairs: Any = [tuple(capacitor_node_voltage(*own) for own in at_node)]
    pairs += [(at[f"{name}_d"], at[f"{name}_q"]) for name in ("i_s", "i_g", "pending")]
    rotated: Any = [rotate_back(*pair, *turn) for pair in pairs]
    v, i_s, i_g, u = rotated
    u = rotate_back(u[0], u[1], settings.half_cos, settings.half_sin)
    own = study.inner_gains
    asked: Any = (rms_to_peak(at["V"]), 0.0, 0.0, *v, *i_g, at["xi_vd"], at["xi_vq"], own, settings.omega_C)
    _, _, *i = voltage_loop(*asked)
    numbers = settings.omega_L, settings.T_over_L, 1e9, settings.T_s
    asked = (*i, *i_s, *v, *u, at["xi_id"], at["xi_iq"], own, *numbers)
    v_b = current_loop(*asked)
    shares = np.array([np.hypot(*i) / settings.i_max_pk, np.hypot(*v_b[:2]) / settings.v_max_pk])
    return shares, {"v": v, "i_s": i_s, "i_g": i_g, "i_want": i}


def test_a_limiter_that_looks_at_something_else_is_refused() -> None:
    study, problem = closed_form()
    other = replace(study, current_limiter="saturation")
    with pytest.raises(InfeasibleStudyError, match=r'"saturation": what it looks at is not known.*circular'):
        level_set(other, problem.system, problem.region, PLACES[closed_form][0])


def test_without_time_everything_is_named_as_not_looked_at() -> None:
    study = load_study("studies/laboratory/study.toml")
    region = Region((3.0, 4.0), (3.0, 3.0001), (4e3, 6e3), (0.0, 1e3), 0.1)
    (spec,) = (spec for spec in study.controllers if spec.name == "scheduled")
    found = prove_moving(study, spec, region, workers=1, seconds=0.0)
    assert not found.complete
    assert found.proved == 0.0
    assert sum(part.share for part in found.left) == pytest.approx(1.0)
    assert {part.reason for part in found.left} == {"time"}
    text = moving_text(found)
    assert "Not proved anywhere" in text
    assert "0 of 0 places" in text
    assert "Steps after which no limit acts are not known" in text


def test_units_against_each_other_are_looked_at_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without time for the proof, and with a decay in place of that of a search: both parts are said."""
    decays = iter((4.0, 2.0))
    monkeypatch.setattr(statement, "least_decay", lambda *_: SimpleNamespace(decay=next(decays)))
    study, spec = _units()
    region = Region((4.0, 5.0), (5.0, 5.0001), (4e3, 5e3), (0.0, 1e3), 0.1)
    found = prove_moving(study, spec, region, workers=1, seconds=0.0, pair=True)
    assert found.differential is not None
    assert not found.complete
    assert sum(part.share for part in found.differential.left) == pytest.approx(1.0)
    text = moving_text(found)
    assert "all units together: All units have the gains of one estimate. Not proved anywhere" in text
    assert "units against each other: Not proved anywhere" in text
    assert "a step of one unit moves all of them" in text
    assert found.as_document()["differential"]["certified"] is False


def test_what_was_found_is_said_with_its_limits() -> None:
    """Shares, places without a function, dwell times with the rate that follows from them, and the least steps."""
    place = CertificateCell(scr=2.0, x_over_r=3.0, P=4e3, Q=1e3, error_R=0.0, error_L=0.0, decay=3.0)
    region = Region((2.0, 4.0), (3.0, 4.0), (4e3, 6e3), (0.0, 1e3), 0.2)
    sampled = Sampled(
        places=40, without=(place,), decay=(0.5, 1.5), ratio=1.2, near=(0.3, 0.5), far=(0.9, 2.0), lines=(3, 4)
    )
    found = MovingProof(
        controller="scheduled", region=region, proved=1.0, left=(), decay=(0.5, 1.25), cells=3, boxes=12, values=99,
        why_not=None, sampled=sampled, steps=StepsAtPlaces(5, (0.2, 0.3, 0.05, 0.06, 0.25), (0.2,) * 5, 0),
        slowest=place,
    )  # fmt: skip
    assert found.complete
    text = moving_text(found)
    for words in (
        "Proved everywhere", "at 0.5 1/s or more, at 1.25 1/s on the fastest grids (12 boxes in 3 cells)",
        "39 of 40 places of a lattice have such a function, on 3 of its 4 lines of one X/R, P and Q in the time",
        "none found at SCR 2, X/R 3, P 4 kW, Q 1 kvar (least decay 3 1/s)",
        "0.3 s (median; at most 0.5 s) where their SCR differ by 20 %",
        "SCR may move by 36 % a second",  # ln 1.2 in half a second
        "P_ref by 0.2 pu, of Q_ref by 0.3 pu, of the phase by 2.9°, of V_g by 6 % or of ω_g by 0.25 rad/s",
    ):  # fmt: skip
        assert words in text
    document = found.as_document()
    assert document["certified"] is True
    assert document["sampled"]["without"][0]["scr"] == 2.0
    nothing = replace(found, why_not="the gains are those of a table", decay=None, steps="no level set was found")
    assert not nothing.complete
    assert "Nothing is proved between points: the gains are those of a table." in moving_text(nothing)
    assert "not known: no level set was found." in moving_text(nothing)
