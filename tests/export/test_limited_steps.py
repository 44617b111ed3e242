"""One step of the exported controller from random states, limits acting or not, and from samples that are none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.export.conftest import built
from tests.export.exchange import written
from tests.export.random_states import compare_steps, memory_of
from vsgdesign.equations.controller_data import ControllerState, Measurement, flat_state
from vsgdesign.equations.integration import within_a_turn
from vsgdesign.equations.limiters import LIMITERS, Limiter
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.export import export_c_files
from vsgdesign.export.known_answers import known_steps
from vsgdesign.runtime import guarded_step, load_scheduler


@pytest.mark.parametrize("limiter", LIMITERS)
@pytest.mark.parametrize(("double", "tolerance"), [(True, 1e-12), (False, 2e-6)])
def test_c_is_python_while_it_limits(limiter: str, double: bool, tolerance: float, tmp_path: Path) -> None:
    """100,000 states of each limiter: ``python -m evidence exported_c``."""
    table_file, _ = written(tmp_path)
    compiled = built(export_c_files(table_file, tmp_path / "c", limiter=limiter).folder, double)
    far = compare_steps(load_scheduler(table_file), LIMITERS[limiter], compiled, 1000, seed=6)
    assert 0.3 < far.limited < 0.9
    assert far.decided == 0.0
    assert far.worst <= tolerance, far


NO_NUMBERS = (np.nan, np.inf, -np.inf, 1e30, -1e30)


@pytest.mark.parametrize("limiter", LIMITERS)
def test_a_sample_that_is_no_measurement_is_left_out(limiter: str, tmp_path: Path) -> None:
    """As Python leaves it out: the state is kept, and the bridge voltage goes on turning."""
    table_file, _ = written(tmp_path)
    law, scheduler = LIMITERS[limiter], load_scheduler(table_file)
    compiled = built(export_c_files(table_file, tmp_path / "c", limiter=limiter).folder, True)
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
            state, measured, known.grid, known.refs, known.gains[0], known.inner_gains, known.settings, law.law
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


def test_gains_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    table_file, _ = written(tmp_path)
    scheduler = load_scheduler(table_file)
    compiled = built(export_c_files(table_file, tmp_path / "c").folder, True)
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
