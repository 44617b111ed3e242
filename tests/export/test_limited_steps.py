"""One step of the exported controller from random states, limits acting or not, and from samples that are none."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compilers import require_compiler
from tests.export.exchange import written
from tests.export.random_states import compare_steps, memory_of
from vsgdesign.equations.controller_data import ControllerState, Measurement, flat_state
from vsgdesign.equations.integration import within_a_turn
from vsgdesign.equations.limiters import LIMITERS, Limiter
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.export import CompiledC, compile_c, export_c_files
from vsgdesign.export.known_answers import known_steps
from vsgdesign.runtime import guarded_step, load_scheduler


@pytest.fixture(scope="module")
def table_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("limited"))[0]


@pytest.fixture(scope="module")
def compiled_with(table_file: Path) -> Callable[[str, bool], CompiledC]:
    """The controller with a limiter, once for each precision."""

    @functools.cache
    def build(limiter: str, double: bool) -> CompiledC:
        require_compiler("cc")
        folder = export_c_files(table_file, table_file.with_name(f"{limiter}-{double}"), limiter=limiter).folder
        return compile_c(folder, double=double, flags=["-O0" if double else "-O1"])

    return build


@pytest.mark.parametrize(
    ("limiter", "double", "tolerance"), [*((name, True, 1e-12) for name in LIMITERS), ("projection", False, 5e-6)]
)
def test_c_is_python_while_it_limits(
    limiter: str, double: bool, tolerance: float, table_file: Path, compiled_with: Callable[[str, bool], CompiledC]
) -> None:
    """100,000 states of each limiter: ``python -m evidence exported_c``."""
    far = compare_steps(load_scheduler(table_file), LIMITERS[limiter], compiled_with(limiter, double), 1000, seed=6)
    assert 0.3 < far.limited < 0.9
    assert far.decided == 0.0
    assert far.worst <= tolerance, far


NO_NUMBERS = (np.nan, np.inf, -np.inf, 1e30, -1e30)


@pytest.mark.parametrize("limiter", ["circular", "projection"])
def test_a_sample_that_is_no_measurement_is_left_out(
    limiter: str, table_file: Path, compiled_with: Callable[[str, bool], CompiledC]
) -> None:
    """As Python leaves it out: the state is kept, and the bridge voltage goes on turning."""
    law, scheduler, compiled = LIMITERS[limiter], load_scheduler(table_file), compiled_with(limiter, True)
    known = known_steps(scheduler.lookup, scheduler.settings, law)
    control = compiled.control(known.gains[0], known.inner_gains, known.grid, known.refs, known.settings)
    state, rng, left_out = _state_of(control, law), np.random.default_rng(8), 0
    for k in range(200):
        measured = known.measured[k % len(known.measured)]
        if k % 3 == 2:  # also several of them in a row
            column = rng.choice(Measurement._fields)
            measured = measured._replace(**{column: rng.choice(NO_NUMBERS)})
        before = state
        state, output, used = guarded_step(
            state, measured, known.grid, known.refs, known.gains[0], known.inner_gains, known.settings, law
        )
        state = state._replace(theta=within_a_turn(state.theta))
        answer = control.step(measured)
        assert control.used == used == (k % 3 != 2)
        left_out += not used
        assert answer == pytest.approx(output, rel=1e-12, abs=1e-9)
        assert flat_state(_state_of(control, law)) == pytest.approx(flat_state(state), rel=1e-12, abs=1e-9)
        if not used:
            assert state[1:11] == before[1:11]
            assert np.hypot(answer.v_b_alpha, answer.v_b_beta) == pytest.approx(
                np.hypot(before.u_alpha, before.u_beta), rel=1e-12
            )
    assert left_out > 50


def test_integrators_that_are_far_beyond_begin_anew(
    table_file: Path, compiled_with: Callable[[str, bool], CompiledC]
) -> None:
    """Else every later step would be refused too: a latch-up, which a million fuzzed samples had found."""
    law, scheduler, compiled = LIMITERS["circular"], load_scheduler(table_file), compiled_with("circular", True)
    known = known_steps(scheduler.lookup, scheduler.settings, law)
    control = compiled.control(known.gains[0], known.inner_gains, known.grid, known.refs, known.settings)
    control.data.state.V, control.data.state.omega_i = -9.999 * known.refs.V_n, 3.0 * known.refs.omega_0
    control.data.gains.K_qp = 1e3  # pushes V outwards
    gains = known.gains[0]._replace(K_qp=1e3)
    state = _state_of(control, law)
    state, output, used = guarded_step(
        state, known.measured[0], known.grid, known.refs, gains, known.inner_gains, known.settings, law
    )
    answer = control.step(known.measured[0])
    assert control.used == used is False
    assert answer == pytest.approx(output, rel=1e-12, abs=1e-9)
    assert control.data.state.V == state.V == known.refs.V_n
    assert control.data.state.omega_i == pytest.approx(state.omega_i, rel=1e-12)
    assert (control.data.state.xi_vd, control.data.state.xi_iq) == (state.xi_vd, state.xi_iq) == (0.0, 0.0)


def test_gains_that_are_no_numbers_are_refused(
    table_file: Path, compiled_with: Callable[[str, bool], CompiledC]
) -> None:
    scheduler, compiled = load_scheduler(table_file), compiled_with("circular", True)
    known = known_steps(scheduler.lookup, scheduler.settings, LIMITERS["circular"])
    control = compiled.control(known.gains[0], known.inner_gains, known.grid, known.refs, known.settings)
    for name in PowerLoopGains._fields:
        for bad in NO_NUMBERS:
            control.retune(known.gains[1]._replace(**{name: bad}), known.grid)
            assert not control.used
            assert control.data.gains.K_ip == known.gains[0].K_ip
    control.retune(known.gains[1], known.grid._replace(R_g=np.nan))
    assert not control.used
    control.retune(known.gains[1], known.grid)
    assert control.used
    assert control.data.gains.K_ip == known.gains[1].K_ip


def _state_of(control: Any, limiter: Limiter) -> ControllerState:
    kind, data = memory_of(limiter), control.data.state
    remembered = kind(*(getattr(data.limiter, name) for name in kind._fields))
    numbers = {name: getattr(data, name) for name in ControllerState._fields[:-1]}
    return ControllerState(**numbers, limiter=remembered)
