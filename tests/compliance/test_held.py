"""A converter that its limiter holds has survived only if it does there what its current allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.compliance.bench_studies import subject, suite_test
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.metrics.survival import ExpectedRest
from vsgdesign.simulation.survival.cases import held_fault
from vsgdesign.study.parameters.event import Event

SLOW_RAMP = Event.of_pu(0.0, df_hz=-0.6, over_s=0.3)
"""The droop of 5 % asks for 0.24 pu more."""


def test_a_start_near_the_limit_is_judged() -> None:
    """A rest at 1.11 of 1.2 pu before the test was refused as "rest over limit", and the row failed for it."""
    jump = Event.of_pu(0.0, phase_deg=10.0)
    found = run_test(subject(), suite_test(jump, scr=20.0, x_over_r=10.0, P_pu=1.1)).survival
    assert found.status == "survived"
    assert found.reason is not None
    assert "1.11 pu, more than 90 % of the limit" in found.reason


def test_a_converter_that_its_limiter_holds_must_carry_what_it_can() -> None:
    run = run_test(subject(), suite_test(SLOW_RAMP, scr=10.0, x_over_r=10.0, P_pu=1.05))
    assert run.survival.status == "survived"
    assert run.survival.limited_at_end is not None
    assert run.survival.limited_at_end > 0.5
    assert run.simulation is not None
    simulation, S = run.simulation, run.study.converter.S_rated
    asked = ExpectedRest(P=1.29 * S, Q=0.0, delta=0.1, i_s_pu=1.3)
    assert held_fault(run.study, simulation, asked) is None

    def with_end(name: str, pu: float, base: float) -> str:
        """The same run with another mean at its end."""
        assert simulation.seen is not None
        column = simulation.seen[name].copy()
        column[-2000:] = pu * base
        found = held_fault(run.study, replace(simulation, seen={**simulation.seen, name: column}), asked)
        assert found is not None
        return found

    wound_up = with_end("V_rms", 1.69, run.study.converter.V_rated_rms)
    assert wound_up == "held by its limiter with a voltage reference of 1.69 pu, outside of 0.85 to 1.25 pu"
    said = with_end("P", 0.64, S)
    assert said.startswith("held by its limiter at P = 0.64 pu: 1.29 pu is asked for, and the grid carries 1.2 pu")
    assert with_end("P", -1.1, S).startswith("held by its limiter at P = -1.1 pu")
    backwards = held_fault(run.study, simulation, replace(asked, P=-1.29 * S))
    assert backwards is not None
    R = run.study.path_to_grid(simulation.timeline.grid_at(1.0), run.study.converter.omega_n)[0]
    most = 1.2 - R / run.study.converter.Z_base * 1.2**2
    assert f"the grid carries {most:.3g} pu" in backwards


def test_a_converter_without_a_limit_is_not_held() -> None:
    run = run_test(subject("fixed"), suite_test(SLOW_RAMP, P_pu=0.5))
    assert run.simulation is not None
    assert held_fault(run.study, run.simulation, ExpectedRest.none("no rest")) is None
    assert np.isfinite(run.simulation.log).all()
