"""The proof of the sampled full-order loop against what knows nothing of it: numbers at points, and the determinant of
the matrix that the product linearises."""

from __future__ import annotations

import functools
import hashlib
import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.design.full_order_problems import ALPHA, closed_form, laboratory, problem_of, units_apart, with_table
from vsgdesign.artifacts.ready import Ready
from vsgdesign.certificate import box_check, region_of, taylor_kernel, tracing
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order import points as search_of_points
from vsgdesign.certificate.full_order import statement
from vsgdesign.certificate.full_order.boxes import Part, Pieces, whole
from vsgdesign.certificate.full_order.cells import GOOD, INNER_UNSTABLE, Arcs, cells_of
from vsgdesign.certificate.full_order.forms import ARC, EXPONENTS, GRID, ROWS, Tape, Values
from vsgdesign.certificate.full_order.higher import gains_of, tables
from vsgdesign.certificate.full_order.kernel import KERNEL, enclosed, survey
from vsgdesign.certificate.full_order.looking import CellGroup
from vsgdesign.certificate.full_order.points import at_rest, decays_at, least_decay
from vsgdesign.certificate.full_order.programs import DIMENSIONS
from vsgdesign.certificate.full_order.record import arrays_of
from vsgdesign.certificate.full_order.search import Found, Problem, _halved, beginning, search
from vsgdesign.certificate.full_order.tape import program_of, run
from vsgdesign.certificate.proof import arrays
from vsgdesign.certificate.region import Region, random_points
from vsgdesign.certificate.taylor_kernel import rows
from vsgdesign.certificate.tracing import Tracer
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.report.gain_table.full_order import full_order_text
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.grid import Grid


def test_operations_hold_every_point() -> None:
    """Sums, products, quotients and conjugates of forms with random coefficients, at random points and radii."""
    rng = np.random.default_rng(3)
    tape = Tape()
    a, b, c = tape.given(GRID), tape.given(ARC), tape.given(GRID)
    ab = a * b
    results = [a + b, a - c, ab * (a - b), (ab + 3.0).reciprocal(), (a * c).conjugate() * 2j, 1.0 / (b + 4.0) - a]
    program = program_of(tape, results)
    count = 20
    given = []
    for kind in (GRID, ARC, GRID):
        own = rng.normal(size=(2, len(ROWS[kind]), count)) * 0.004
        own[:, 0] = rng.uniform(-0.8, 0.8, (2, count))
        given.append(Values(own[0], own[1], np.full(count, 1e-3), kind))
    found = run(program, given, count)
    exponents = np.array(EXPONENTS)
    outside = 0
    for column, _ in itertools.product(range(count), range(20)):
        t = rng.uniform(-1.0, 1.0, 3)
        powers = (t**exponents).prod(axis=1)
        turns = np.exp(2j * np.pi * rng.random(3)) * 1e-3

        def value(form: Values, powers: Any = powers, column: int = column) -> complex:
            of = form.re[:, column] + 1j * form.im[:, column]
            return complex(of @ powers[ROWS[form.kind]])

        x, y, z = (value(form) + turn for form, turn in zip(given, turns, strict=True))
        truth = [x + y, x - z, x * y * (x - y), 1.0 / (x * y + 3.0), 2j * np.conj(x * z), 1.0 / (y + 4.0) - x]
        for form, wanted in zip(found, truth, strict=True):
            outside += abs(value(form) - wanted) > form.radius[column]
    assert outside == 0
    assert max(float(form.radius.max()) for form in found) < 0.05  # and the bounds say something


def test_programs_of_third_order_hold_every_point() -> None:
    """Every kind of instruction on random boxes, a cell's rest with a random form, and parameters: at random places of
    the box, with the rest anywhere in its radius."""
    rng = np.random.default_rng(8)
    number = 70  # more than go through at once

    def results(x: Any, rest: Any, blend: Any, root: Any) -> list[Any]:
        a = x[0] * x[2] + x[1] * 0.5 - x[4] * rest[0] + 2.0
        b = blend(x[3], x[5]) * a + rest[3] * x[5] + 3.0
        alone = [1.0 / (x[0] + 1.2), root(x[1] + 1.2), np.sin(3.0 * x[2]), np.cos(3.0 * x[2])]
        return [*alone, a * b, (a + 1.0) / b, np.cos(b) * np.sin(a * x[5]), root(a * a + b) * rest[1] - x[3] / a]

    tracer = Tracer(10)
    symbols = tracer.symbols()
    outputs = results(symbols[:6], symbols[6:], lambda *v: tracer.blend((0, 1), v), lambda v: v.sqrt(0.5))
    program = tracing.program_of(tracer, outputs)
    low = rng.uniform(-0.6, 0.3, (number, 6))
    high = low + rng.uniform(0.0, 0.3, (number, 6))
    rest = rng.normal(size=(1, 2, 11)) * 0.1 + 1j * rng.normal(size=(1, 2, 11)) * 0.1
    rest[:, :, [3, 6, 8, 9]], rest[:, :, 10] = 0.0, 0.01  # it does not depend on the frequency
    parameters = rng.uniform(-1.0, 1.0, (2, number))
    found = np.zeros((number, len(outputs), rows(DIMENSIONS)))
    cell = np.zeros(number, dtype=np.int64)
    gains_of((low, high, cell), rest, parameters, arrays(program), tables(), found)
    for _ in range(30):
        t = rng.uniform(-1.0, 1.0, (number, 7)) * (1.0 if rng.random() < 0.5 else 1.0 / 1e-9)
        t = np.clip(t, -1.0, 1.0)  # half of them are corners
        x = (0.5 * (low + high) + 0.5 * (high - low) * t[:, :6]).T
        terms = np.array([np.ones(number), t[:, 0], t[:, 1], 0 * t[:, 0], t[:, 0] ** 2, t[:, 0] * t[:, 1], 0 * t[:, 0],
                          t[:, 1] ** 2, 0 * t[:, 0], 0 * t[:, 0]])  # fmt: skip
        off = rng.uniform(-0.01, 0.01, (4, number))
        parts = [part for form in rest[0, :, :10] for part in (form.real, form.imag)]
        own = [part @ terms + more for part, more in zip(parts, off, strict=True)]
        truth = results(x, own, lambda a, b: parameters[0] * a + parameters[1] * b, np.sqrt)
        for k, wanted in enumerate(truth):
            for n in range(number):
                value, radius = _at(found[n, k], t[n], DIMENSIONS)
                assert abs(value - wanted[n]) <= radius
    assert np.median(found[:, :, 36:43].sum(axis=2)) < 0.1  # and the bounds say something


def determinants(study: Any, problem: Problem, points: Any, gains: Any, V: Any, z: Any) -> Any:
    """f (N,) of :eq:`full-order-determinant` at points (N, 6) and z (N,), from the product's state matrices alone."""
    c, source = study.converter, study.grid_source
    Z = points[:, 0] * c.Z_base
    R, L = Z * np.cos(points[:, 1]), Z * np.sin(points[:, 1]) / c.omega_n
    cells = [
        Cell(
            Grid(R[k], L[k]),
            PowerLoopGains(*(float(value[k]) for value in gains)),
            points[k, 2],
            points[k, 3],
            omega_0=source.omega_g,
            V_n=V[k],
        )
        for k in range(len(points))
    ]
    model = linearise_full_order(study, cells)
    assert len(model.index) == len(points), model.faults
    matrices = model.A
    if problem.system.apart:  # the same rest, and nothing behind the units' own inductor
        p = model.p.copy()
        p[:, [FilterGrid._fields.index(name) for name in ("R_g", "L_g")]] = 0.0
        matrices = np.array([np.array(model.map.state_matrix(z, q)) for z, q in zip(model.z, p, strict=True)])
    own = [k for k, name in enumerate(model.states) if not name.startswith("limiter_")]
    loops = [k for k, n in enumerate(own) if model.states[n] in ("delta", "omega_i", "V", "P_f", "Q_f")]
    inner = [k for k in range(len(own)) if k not in loops]
    settings, T = study.controller_settings(), c.T_s
    found = []
    for k, at in enumerate(z):
        A = matrices[k][np.ix_(own, own)]
        whole_, alone = (np.linalg.slogdet(at * np.eye(len(X)) - X) for X in (A, A[np.ix_(inner, inner)]))
        filters = 1.0
        for name, smoothing in (("P_f", settings.smoothing_P), ("Q_f", settings.smoothing_Q)):
            filters *= at - 1.0 + smoothing if name in model.states else 1.0
        ratio = whole_[0] / alone[0] * np.exp(whole_[1] - alone[1])
        found.append(ratio / (T**3 * filters * ((at - 1.0) / T + problem.loop.divisor) ** 3))
    return np.array(found)


def of_table(problem: Problem, x: Any, basis: str = "impedance") -> tuple[Any, Any]:
    """The piece of each place (N, 6), by the definitions of SCR and X/R alone; −1 where there is none. Also how many
    nodes of the table lie before its estimate, (N, 2)."""
    pieces: Pieces = problem.pieces
    R, X = np.cos(x[:, 1]), np.sin(x[:, 1])
    w_R, w_X = (1.0, 1.0) if not problem.region.error_Z else problem.region.error_scales(x[:, 1])
    R, X = R * (1.0 + w_R * x[:, 2]), X * (1.0 + w_X * x[:, 3])
    first = x[:, 0] * (np.hypot(R, X) if basis == "impedance" else X / np.sin(x[:, 1]))
    every = np.stack([x[:, 1], first, R / X], axis=1)[:, None]
    low = np.stack([pieces.angle[:, 0], pieces.first[:, 0], pieces.slope[:, 0]], axis=1)
    high = np.stack([pieces.angle[:, 1], pieces.first[:, 1], pieces.slope[:, 1]], axis=1)
    within = ((every >= low) & (every <= high)).all(axis=2)
    axes = (1.0 / pieces.table.axes[0][::-1], pieces.table.axes[1]) if pieces.table is not None else ([], [])
    nodes = np.stack([np.searchsorted(axis, every[:, 0, k]) for k, axis in enumerate(axes, start=1)], axis=1)
    return np.where(within.any(axis=-1), within.argmax(axis=-1), -1), nodes


MADE = {
    "laboratory": laboratory,
    "closed form": closed_form,
    "table": with_table,
    "table, error of Z": functools.partial(with_table, 0.1),
    "units against each other": units_apart,
}


@dataclass
class Places:
    """24 boxes (start, end) of two cells that begin at ``low``, with the ``piece`` and the ``arc`` of each, its edges
    in rad/s, a place ``t`` in the box and the arc, and f there."""

    low: Any
    cells: Any
    start: Any
    end: Any
    cell: Any
    piece: Any
    arc: Any
    edges: Any
    t: Any
    f: Any
    nodes: Any
    """How many nodes of the table lie before its estimate, (24, 2)."""

    @property
    def x(self) -> Any:
        """The coordinates of the place, (24, 6)."""
        return 0.5 * (self.start + self.end) + 0.5 * (self.end - self.start) * self.t[:, :6]


def places(made: Any, seed: int = 5, count: int = 24, low: Any = None) -> Places:
    """24 random places, or up to ``count``, in random boxes and on random arcs of two cells that begin at ``low``, with
    the gains that the estimate leads to."""
    study, problem = made()
    rng = np.random.default_rng(seed)
    d, c = DIMENSIONS, study.converter
    if low is None:
        low = np.array([[1 / 4.0, np.arctan(2.5)], [1 / 9.0, np.arctan(9.0 if made is with_table else 3.0)]])
    cells = cells_of(problem.tapes, low, low * [1.02, 1.01], [Arcs.coarsest(c.T_s)] * 2)
    assert [cell.state for cell in cells] == [GOOD, GOOD]
    group = CellGroup.of(cells)
    number = max(3000, 10 * count)
    cell = rng.integers(0, 2, number)
    start = np.column_stack([low[cell], rng.uniform(-0.2, 0.18, (number, 2)), rng.uniform(-0.6, 0.6, (number, 2))])
    start[:, 4:] *= low[cell, :1] * 3.0
    end = start + np.array([0.0, 0.0, 0.02, 0.02, 0.02, 0.02])
    end[:, :2] = (low * [1.02, 1.01])[cell]
    arc = rng.integers(0, group.counts[cell])
    t = rng.uniform(-1.0, 1.0, (number, d))
    x = 0.5 * (start + end) + 0.5 * (end - start) * t[:, :6]
    # The rest of the place: V from y of the cell's own forms is not taken; it is solved with the product's circuit.
    errors = x[:, 2:4] * np.stack(problem.region.error_scales(x[:, 1]), axis=1)
    points = np.column_stack([x[:, 0], x[:, 1], x[:, 4], x[:, 5], errors])
    V = before = np.full(number, c.V_rated_rms)
    Z = x[:, 0] * c.Z_base
    for _ in range(30):
        points[:, 2], points[:, 3] = x[:, 4] * V**2 / Z, x[:, 5] * V**2 / Z
        before, V = V, 0.5 * (V + at_rest(study, problem.system, points).V_rms)
    with np.errstate(invalid="ignore"):
        good = (np.abs(V - before) < 1e-8 * V) & problem.system.within_limits(points)
    region = problem.region
    good &= (points[:, 2] >= region.P[0]) & (points[:, 2] <= region.P[1])
    good &= (points[:, 3] >= region.Q[0]) & (points[:, 3] <= region.Q[1])
    piece, nodes = of_table(problem, x)
    chosen = np.flatnonzero(good & (piece >= 0))[:count]
    assert len(chosen) >= 24
    start, end, t, points = start[chosen], end[chosen], t[chosen], points[chosen]
    cell, arc = cell[chosen], arc[chosen]
    rest = at_rest(study, problem.system, points)
    edges = np.array([[cells[k].edges[n], cells[k].edges[n + 1]] for k, n in zip(cell, arc, strict=True)])
    omega = edges.mean(axis=1) + 0.5 * (edges[:, 1] - edges[:, 0]) * t[:, 6]
    f = determinants(study, problem, points, rest.gains, rest.V_rms, np.exp((-ALPHA + 1j * omega) * c.T_s))
    return Places(low, cells, start, end, cell, piece[chosen], arc, edges, t, f, nodes[chosen])


@pytest.mark.parametrize("made", MADE.values(), ids=list(MADE))
def test_enclosures_hold_the_model_that_the_product_linearises(made: Any) -> None:
    at, (_, problem) = places(made), made()
    parts = np.unique(np.column_stack([at.piece, at.nodes]), axis=0)
    assert len(parts) >= (1 if problem.pieces.table is None else 4 - problem.system.apart)
    held, near, empty = compared(made, at)
    assert not empty.any()
    assert held.all()
    assert np.median(near) < 0.1  # the bounds are for the whole box; at a point there is room


def compared(made: Any, at: Places) -> tuple[Any, list[float], Any]:
    """Whether f of each place is held by the enclosure on its box and its arc, how far it is off over the radius, and
    whether the box counts as empty."""
    _, problem = made()
    start, end, cell, arc, t, f = at.start, at.end, at.cell, at.arc, at.t, at.f
    count = len(f)
    group, d = CellGroup.of(at.cells), DIMENSIONS
    part = Part(start, end, cell, at.piece, np.zeros(count), np.ones(count))
    programs = problem.programs
    empty, applies = np.zeros(count, dtype=np.bool_), np.zeros((len(programs.signs), count), dtype=np.bool_)
    columns = problem.pieces.parameters(start, end, part.piece)
    boxes = (start, end, cell, group.rest, columns)
    survey(boxes, arrays(programs.situation), programs.conditions, programs.signs, d, (empty, applies))
    held = np.zeros(count, dtype=np.bool_)
    near: list[float] = []
    for case, program in enumerate(programs.gains):
        gains = np.zeros((count, len(program.outputs), rows(d)))
        gains_of((start, end, cell), group.rest, columns, arrays(program), tables(), gains)
        forms = np.zeros((count, 2, rows(d)))
        where = group.first[cell] + arc
        enclosed((start, end), gains, group.functions, where, arrays(programs.arcs[case]), d, forms)
        for k in np.flatnonzero(applies[case]):
            value, radius = np.array([_at(form, t[k], d) for form in forms[k]]).T
            off = np.abs(value - [f[k].real, f[k].imag])
            held[k] |= bool((off <= radius).all())
            near.append(float((off / radius).min()))
    return held, near, empty


def _at(form: Any, t: Any, d: int) -> tuple[float, float]:
    """The value of a register at a point, and its radius."""
    i, j = np.triu_indices(d)
    last = 1 + d + d * (d + 1) // 2
    return float(form[0] + form[1 : 1 + d] @ t + form[1 + d : last] @ (t[i] * t[j])), float(form[last : last + d].sum())


def test_a_region_is_proved_and_a_point_that_is_too_slow_is_not() -> None:
    """Two cells of the laboratory. With a circle beyond the least decay in a cell, something is always left."""
    study, problem = laboratory()
    waiting = [one for one in beginning(problem) if one.low[0] > 1 / 2.4][:2]
    found = Found()
    assert search(problem, waiting, found) == []
    assert not found.left
    assert found.proved > 0.0
    # What is proved and what is empty is all there was.
    assert found.proved + found.empty == pytest.approx(sum(float(one.boxes.share.sum()) for one in waiting), rel=1e-9)
    low, high, _ = whole(problem.system, problem.region, problem.pieces)
    points = np.array([[0.5, np.arctan(3.0), 8e3, 0.0, -0.2, -0.2]])
    least = float(decays_at(study, problem.system, points)[0])
    assert ALPHA < least < 2.2
    _, faster = problem_of("laboratory", "scheduled", problem.region, alpha=least * 1.1)
    corner = [one for one in beginning(faster) if one.low[0] <= 0.5 <= one.high[0] and one.low[1] <= points[0, 1]]
    corner = [one for one in corner if points[0, 1] <= one.high[1]]
    found = Found()
    rest = search(faster, corner, found, most_looks=600)
    assert rest or found.left
    assert len(low) == len(high)


def test_a_decay_near_the_least_one_needs_shorter_arcs() -> None:
    """The slowest corner of utility decays with 0.593 1/s: f at 0.5 1/s is small near 0 rad/s, and an arc of 0.7 rad/s
    there is too long on any cell. The arcs that are halved are kept in the proof's file."""
    region = Region((1.5, 10.0), (3.0, 10.0), (3e5, 7e5), (0.0, 1e5), 0.2)
    _, problem = problem_of("utility", "scheduled", region)
    corner = [one for one in beginning(problem) if one.high[0] * 1.5 > 0.999][-1:]
    found = Found()
    assert search(problem, corner, found, most_looks=3000) == []
    assert not found.left
    coarse = Arcs.coarsest(problem.loop.T_s).edges
    assert min(float(edges[1]) for _, _, edges in found.cells) < 0.5 * coarse[1] * (1.0 + 1e-12)
    arrays = arrays_of(corner, problem.pieces, found, coarse)
    share = 0.5 ** arrays["arcs"].astype(float)
    assert share.sum() == pytest.approx(len(arrays["cells"]) * (len(coarse) - 1))


def test_what_is_left_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """With few looks and a decay near the least one: grids, powers and frequencies of each part, and what a search
    finds there."""
    monkeypatch.setattr(statement, "_MOST_LOOKS", 40)
    monkeypatch.setattr(statement, "_SEARCHED", 1)
    monkeypatch.setattr(
        statement, "least_decay", lambda one, two, three, *_: least_decay(one, two, three, 0, 200)
    )  # a small search will do
    monkeypatch.setattr(search_of_points, "_KEPT", 6)
    study = load_study("studies/laboratory/study.toml")
    spec, _ = region_of(study, "scheduled", None, None)
    region = Region((2.0, 2.2), (2.9, 3.0), (4e3, 8e3), (0.0, 2e3), 0.2)
    found = statement.prove_full_order(study, spec, region, decay=1.9, workers=1)
    assert not found.complete
    assert sum(part.share for part in found.left) == pytest.approx(1.0 - found.proved)
    for part in found.left:
        for (low, high), (least, most) in (
            (part.scr, region.scr), (part.x_over_r, region.x_over_r), (part.P, region.P), (part.Q, region.Q)
        ):  # fmt: skip
            assert least * (1.0 - 1e-9) <= low < high <= most * (1.0 + 1e-9)
        assert part.frequency is not None
        assert 0.0 < part.frequency[0] <= part.frequency[1] < 400.0
    first = found.left[0]
    assert first.least_decay is not None
    assert first.least_decay > found.decay
    # No other search finds a point there that decays more slowly, within what a search can miss.
    own = replace(region, scr=first.scr, x_over_r=first.x_over_r, P=first.P, Q=first.Q)
    system, _ = prepared(study, spec, own, Ready(), None, None)
    points = random_points(own, 500, np.random.default_rng(4))
    decays = decays_at(study.with_limit_of(spec), system, points[system.within_limits(points)])
    assert np.nanmin(decays) > first.least_decay * 0.999
    text = full_order_text(found)
    assert f"the least decay that a search found there is {first.least_decay:.3g} 1/s" in text
    assert f"P {first.P[0] / 1e3:.4g} to {first.P[1] / 1e3:.4g} kW" in text
    assert "rad/s" in text


def test_a_cell_is_not_cut_to_a_sliver() -> None:
    """Whatever its boxes ask for, its other coordinate is halved before the first one is a twentieth of it."""
    _, problem = laboratory()
    one = beginning(problem)[0]
    for _ in range(12):
        one = _halved(one, one.boxes, np.array([1.0, 0.1]))[0]
        half = 0.5 * (one.high - one.low)
        width = 1.5 * half[0] / (0.5 * (one.low[0] + one.high[0])), 2.0 * half[1]
        assert 0.05 < width[0] / width[1] < 20.0


def test_inner_loops_that_lose_the_network_are_named() -> None:
    """The published inner loops lose it on a strong grid without resistance (:eq:`generalised-nyquist`)."""
    region = Region((15.0, 20.0), (3.0, 20.0), (0.0, 4500.0), (0.0, 1e3), 0.1)
    study, problem = problem_of("published", "AVSG", region, basis="reactance")
    strong = np.array([[1 / 20.0, np.arctan(19.0)], [1 / 20.0, np.arctan(3.0)]])
    arcs = [Arcs.coarsest(study.converter.T_s)] * 2
    states = [cell.state for cell in cells_of(problem.tapes, strong, strong * (1.0 + 1e-6), arcs)]
    assert states == [INNER_UNSTABLE, GOOD]


def test_machine_code_is_made_again_when_a_kernel_changes() -> None:
    """Numba looks at the file of a function alone, not at those of what it calls: write the fingerprint again."""
    text = b"".join(Path(module.__file__ or "").read_bytes() for module in (taylor_kernel, box_check))
    assert hashlib.sha256(text).hexdigest()[:16] == KERNEL
