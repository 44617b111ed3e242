"""The compiled C against Python: gains, places and every status, in both precisions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.artifacts.networks import random_weights
from tests.equations.test_fourth_structure import DIAGONAL
from tests.export.conftest import FIT, built
from tests.export.exchange import KINDS, compare, exported, random_calls, windows, written
from tests.gain_tables import PUBLISHED_BASE
from tests.simulation.test_limiters import LEANING
from vsgdesign.equations.controller import ControllerState, Measurement, controller_step
from vsgdesign.equations.integration import TURN, within_a_turn
from vsgdesign.equations.limiters import CIRCULAR, LIMITERS
from vsgdesign.equations.power_loops import (
    NO_NOTCH,
    NotchConstants,
    PowerLoopGains,
    References,
    frequency_at_rest,
    gain_transfer,
    notch_constants,
)
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.export import CompiledC, export_c, export_c_files
from vsgdesign.export.c_content import Origin
from vsgdesign.export.known_answers import gain_sizes, known_steps
from vsgdesign.runtime import (
    ClosedFormSchedule,
    PowerController,
    Scheduler,
    box_settings,
    closed_form_scheduler,
    load_scheduler,
    neural_estimator,
)
from vsgdesign.runtime.scheduler import SAID

TOLERANCE = {True: 1e-12, False: 2e-6}

GAINS = {True: 1e-14, False: 2e-6}
"""Of gains and places. With this C library double precision has Python's bits; another one's hypot may differ in its
last bit, which gains near the limit of a grid multiply by some."""


@pytest.mark.parametrize(("structure", "law"), KINDS)
@pytest.mark.parametrize("double", [True, False])
def test_gains_places_and_statuses(structure: str, law: str, double: bool, tmp_path: Path) -> None:
    """Each with its own state all the way. 100,000 calls of each kind: ``python -m bench --only runtime``."""
    table_file, _ = written(tmp_path, structure, law)
    compiled = built(exported(tmp_path, structure, law), double, "-O0" if double else "-O2")
    scheduler = load_scheduler(table_file)
    calls = random_calls(scheduler, 3000, seed=11)
    difference = compare(scheduler, compiled, calls)
    assert difference.statuses == 0
    assert difference.fresh > 1000
    assert difference.doubtful > 100
    assert difference.partly > 200
    assert difference.gains <= GAINS[double]
    assert difference.place <= GAINS[double]


@pytest.mark.parametrize("double", [True, False])
def test_other_basis_inductor_and_undesigned_cells(double: bool, tmp_path: Path) -> None:
    base = replace(PUBLISHED_BASE, scr_basis="reactance", L_2=5e-4, R_2=0.02)
    status = np.full((12, 10), "met", dtype="<U8")
    status[:3, :4] = status[4, 5] = "outside"
    changes = {"base": base, "status": status}
    table_file, _ = written(tmp_path, **changes)
    compiled = built(exported(tmp_path, **changes), double)
    scheduler = load_scheduler(table_file)
    difference = compare(scheduler, compiled, random_calls(scheduler, 3000, seed=12))
    assert difference.statuses == 0
    assert difference.fresh > 1000
    assert difference.gains <= GAINS[double]


def test_the_network(compiled: CompiledC) -> None:
    """Relative to the trained range: the sums of 200 products cancel, so nothing else would mean anything."""
    estimator = neural_estimator(random_weights(5), **FIT)
    size = np.subtract(estimator.largest, estimator.least)
    seen = set()
    for v, i in windows(400, 3):
        R_g, L_g, status = estimator.estimate(v, i)[:3]
        got = compiled.estimate(v, i)
        assert got[2] == SAID[status]
        assert np.all(np.abs(np.subtract(got[:2], (R_g, L_g))) <= TOLERANCE[compiled.double] * size)
        seen.add(status)
    assert "ok" in seen


def test_windows_to_gains(compiled: CompiledC, scheduler: Scheduler) -> None:
    for k, (v, i) in enumerate(windows(200, 4)):
        if k == 50:
            v[3] = np.nan
        if k == 51:
            i[99] = -np.inf
        if k == 52:
            i[0] = 1e9
        answer = scheduler.update(v, i, 3e3, 500.0, 112.0, ticks=20_000 * k)
        got = compiled.update(v, i, 3e3, 500.0, 112.0, 20_000 * k)
        if k == 52:  # only the export has limits of the sensors
            assert got.status & 32
            continue
        assert (got.status, got.reason) == (answer.status, answer.reason)
        for a, b, size in zip(answer.gains, got.gains, gain_sizes(answer.gains), strict=True):
            assert abs(a - b) <= TOLERANCE[compiled.double] * size


REFS = References(2e3, 500.0, 100.0 * np.pi, 110.0)
SOFT = PowerLoopGains(2e-3, 318.3, 0.05, 90.9, -4e-4, 6e-3, 8e-4, -3e-4)
FIRM = PowerLoopGains(5e-3, 2087.0, 0.115, 0.687)


SINGLE_NOTCH = NotchConstants(*(float(np.float32(x)) for x in notch_constants(200.0 * np.pi, 0.5, 1e-4)))


@pytest.mark.parametrize("before", [NO_NOTCH, SINGLE_NOTCH], ids=["low_pass", "notch"])
def test_the_power_loops(compiled: CompiledC, before: NotchConstants) -> None:
    """Closed over a grid of A, B, C, D, with two retunings, for 2 s: rounding must not pile up in the integrators."""
    A, B, C, D = 8000.0, 60.0, -4500.0, 70.0
    loops = [made(FIRM, REFS, 1e-4, 0.02, 0.02, before) for made in (PowerController, compiled.power)]
    delta = [0.0, 0.0]
    worst = np.zeros(3)
    following = delta[0]
    for k in range(20_000):
        got = []
        for j, loop in enumerate(loops):
            # Both see the Python loop's powers: what is compared is the loops, not a feedback of their rounding.
            P = float(np.float32(2.3e3 + A * delta[0] + B * (V_now(k) - 110.0)))
            Q = float(np.float32(400.0 + C * delta[0] + D * (V_now(k) - 110.0)))
            got.append(loop.step(P, Q))
            if k in (7000, 14_000):
                loop.retune(SOFT if k == 7000 else FIRM)
            if j == 0:
                following = delta[0] + 1e-4 * (got[0][0] - REFS.omega_0)
        delta[0] = following
        turn = (got[0][2] - got[1][2] + np.pi) % (2.0 * np.pi) - np.pi
        worst = np.maximum(worst, np.abs([(got[1][0] - got[0][0]) / 314.0, (got[1][1] - got[0][1]) / 110.0, turn]))
    # The angle integrates the rounding of ω itself: 6e-8 of 628 rad in single precision.
    limits = np.zeros(3) if compiled.double else np.array([1.0, 1.0, 50.0]) * TOLERANCE[False]
    assert np.all(worst <= limits), worst  # in double precision the bits of Python


def test_the_whole_controller(compiled: CompiledC, scheduler: Scheduler) -> None:
    """From its start over 2,000 samples with a change of gains: Python's numbers, the last bit of cos and sin apart.

    Both see the same measurements, so that no difference can hide behind a loop that is closed. In single precision
    the inner integrators take up what their inputs' rounding leaves, so it is compared over the first samples alone;
    in closed loop it is in test_closed_loop.
    """
    known = known_steps(scheduler.lookup, scheduler.settings, CIRCULAR)
    rng, (first, second) = np.random.default_rng(5), known.gains
    got = compiled.control(first, known.inner_gains, known.grid, known.refs, known.settings)
    refs = known.refs
    state = ControllerState(
        theta=0.0, omega_i=frequency_at_rest(refs, first), V=refs.V_n, P_f=refs.P_ref, Q_f=refs.Q_ref, xi_vd=0.0,
        xi_vq=0.0, xi_id=0.0, xi_iq=0.0, mean_P=refs.P_ref, mean_Q=refs.Q_ref,
    )  # fmt: skip
    samples = 2000 if compiled.double else 20
    gains, worst, turns = first, 0.0, 0
    for k in range(samples):
        if k == samples // 2:
            omega_i = gain_transfer(state.omega_i, refs, gains, second)
            state, gains = state._replace(omega_i=omega_i), second
            got.retune(second, known.grid)
        measured = known.measured[k % len(known.measured)]
        scatter = rng.uniform(0.9, 1.1, 6).astype(np.float32)
        measured = Measurement(*(float(np.float32(x * s)) for x, s in zip(measured, scatter, strict=True)))
        state, output = controller_step(
            state, measured, known.grid, refs, gains, known.inner_gains, known.settings, CIRCULAR.law
        )
        turns += state.theta > TURN
        state = state._replace(theta=within_a_turn(state.theta))
        answer = got.step(measured)
        worst = max(worst, *(abs(a - b) / size for a, b, size in zip(answer, output, known.size, strict=True)))
    assert turns >= (9 if compiled.double else 0)
    assert worst <= (1e-12 if compiled.double else 2e-6)
    if compiled.double:
        for name in ControllerState._fields[:-1]:
            assert getattr(got.data.state, name) == pytest.approx(getattr(state, name), rel=1e-10, abs=1e-9)


def V_now(k: int) -> float:
    return 110.0 + 0.5 * np.sin(1e-3 * k)


def test_starts_where_python_starts(compiled: CompiledC, scheduler: Scheduler) -> None:
    for R, L, good in ((1.3, 4e-3, True), (0.01, 1e-5, False), (np.nan, 4e-3, False), (1.0, -1e-3, False)):
        assert compiled.start(R, L) is good
        if good:
            gains = scheduler.start(R, L)
            np.testing.assert_allclose(compiled.gains, gains, rtol=TOLERANCE[compiled.double])


def test_known_answers_hold(compiled: CompiledC) -> None:
    assert compiled.selftest() == 0


@pytest.mark.parametrize("double", [True, False])
def test_the_closed_form_without_a_table(double: bool, tmp_path: Path) -> None:
    """A table of one node."""
    schedule = ClosedFormSchedule(
        P=4500.0,
        Q=1000.0,
        V_g_rms=110.0,
        omega=PUBLISHED_BASE.omega_n,
        settling_time=1.0,
        damping_ratio=1.0,
        droop_ratio=0.01,
    )
    limits = box_settings(
        scr=(1.5, 20.0),
        r_over_x=(0.1, 2.0),
        P=(-4500.0, 4500.0),
        Q=(-2e3, 2e3),
        V_rms=(93.5, 137.5),
        S_rated=5e3,
        V_rated_rms=110.0,
        omega=PUBLISHED_BASE.omega_n,
    )
    scheduler = closed_form_scheduler(schedule, limits, V_n_rms=110.0, S_rated=5e3)
    made = export_c(scheduler, Origin("closed form", "0" * 64, "published", "0" * 64), tmp_path / "c")
    compiled = built(made.folder, double)
    assert compiled.selftest() == 0
    difference = compare(scheduler, compiled, random_calls(scheduler, 2000, seed=13))
    assert difference.statuses == 0
    assert difference.fresh > 500
    assert difference.gains <= GAINS[double]


def test_a_limiter_with_a_memory_has_its_c(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another limiter, with a memory, constants and notes of its own, without a change of the export."""
    monkeypatch.setitem(LIMITERS, LEANING.name, LEANING)
    table_file, _ = written(tmp_path)
    folder = export_c_files(table_file, tmp_path / "c", limiter=LEANING.name).folder
    assert "vsg_memory_t limiter;" in (folder / "vsg.h").read_text(encoding="utf-8")
    for double in (True, False):
        compiled = built(folder, double)
        assert compiled.selftest() == 0
    with pytest.raises(ValueError, match=r'current_limiter = "none such": must be one of circular, .*leaning'):
        export_c_files(table_file, tmp_path / "d", limiter="none such")


@pytest.mark.parametrize("name", [name for name in LIMITERS if name != CIRCULAR.name])
def test_every_limiter_has_its_c(name: str, tmp_path: Path) -> None:
    """The self-test carries a controller through both limits of its current, against Python."""
    table_file, _ = written(tmp_path)
    folder = export_c_files(table_file, tmp_path / "c", limiter=name).folder
    assert built(folder, double=False).selftest() == 0


def test_a_structure_that_was_added_has_its_c(tmp_path: Path) -> None:
    """Its gains are translated from the function that its object names."""
    forget = STRUCTURES.register(DIAGONAL)
    try:
        table_file, _ = written(tmp_path, DIAGONAL.name)
        compiled = built(export_c_files(table_file, tmp_path / "c").folder, True)
        assert "vsg_diagonal_gains(" in (tmp_path / "c" / "vsg_laws.h").read_text(encoding="utf-8")
        assert compiled.selftest() == 0
        scheduler = load_scheduler(table_file)
        difference = compare(scheduler, compiled, random_calls(scheduler, 500, seed=14))
    finally:
        forget()
    assert difference.statuses == 0
    assert difference.fresh > 100
    assert difference.gains <= GAINS[True]
