"""A source with a negative sequence and harmonics in a whole scenario: what is judged, and what the converter does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.studies import lc_study
from vsgdesign.linear.operating_point.plant import plant_step, state_matrices
from vsgdesign.report.drawing.quantities import number
from vsgdesign.report.page.terminal import print_terminal
from vsgdesign.report.scenario.page import limits_of_validity, terminal_blocks
from vsgdesign.simulation.background import Background, Interval
from vsgdesign.simulation.circuits import Connection
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.timeline import SourceSegment
from vsgdesign.study.parameters.grid import SourceComponent

STEP = """
[[events]]
time = "1 s"
P_ref = "2.5 kW"
"""
V2 = "[grid]\ncomponents = [{ order = -1, amplitude_pu = 0.02, phase = 0.4 }]\n"


def test_its_targets_are_judged_on_cycle_means(capsys: pytest.CaptureFixture[str]) -> None:
    clean, distorted = (run_scenario(lc_study("8 s", STEP, sections)) for sections in ("", V2))
    a, b = clean.controllers[0], distorted.controllers[0]
    assert not a.ripples
    assert b.ripples
    # The instantaneous power never settles, its mean does, as without the negative sequence.
    (mean,) = (event.cycle_mean for event in b.events if event.signal == "P_pcc")
    (raw,) = (event.raw for event in a.events if event.signal == "P_pcc")
    assert mean.settling_time_s == pytest.approx(raw.settling_time_s, abs=0.02)
    assert [event.raw.settling_time_s for event in b.events if event.signal == "P_pcc"] == [None]
    # The terminal shows the figures that are judged.
    print_terminal(terminal_blocks(distorted))
    shown = capsys.readouterr().out
    assert "(one-cycle means)" in shown
    assert f"{number(mean.settling_time_s)} s" in shown
    said = "The grid source contains a negative sequence"
    assert any(item.startswith(said) for item in limits_of_validity(distorted))
    assert not any(item.startswith(said) for item in limits_of_validity(clean))


@pytest.mark.parametrize("order", [-1.0, -5.0, 13.0, 2.5])
def test_a_resting_phasor_stays_one(order: float) -> None:
    """(jnω − A) x = e v turns by nωT in every step, if the bridge makes no voltage: complex impedances know no more."""
    study = lc_study("1 s")
    circuit, T_s, omega = study.circuit(), study.converter.T_s, study.converter.omega_n
    A, _, e = state_matrices(circuit)
    v = 10.0 * np.exp(0.3j)
    x = np.linalg.solve(1j * order * omega * np.eye(3) - A, e * v)
    source = SourceSegment(0.0, 110.0, 0.0, omega, 0.0, 0.2)
    component = SourceComponent(order, 0.1, 0.3 - 0.2 * order)
    interval = Interval(T_s, Connection(study.grid), source, (component,))
    rows = Background(lambda _: circuit, 100.0).rows([interval], 0, 500, T_s)
    transition = plant_step(circuit, T_s, omega, edges=False).transition
    turns = np.exp(1j * order * omega * T_s * np.arange(501))
    np.testing.assert_allclose(rows[:, 6] + 1j * rows[:, 7], v * turns[:-1], rtol=1e-12)
    for row, turn in zip(rows, turns[1:], strict=True):
        now = transition @ (x * turn * np.exp(-1j * order * omega * T_s)) + row[0:6:2] + 1j * row[1:6:2]
        np.testing.assert_allclose(now, x * turn, rtol=1e-10)


def test_stretches_of_a_ramp_have_the_bits_of_one_after_the_other() -> None:
    study = lc_study("1 s")
    circuit, T_s = study.circuit(), study.converter.T_s
    ramp = SourceSegment(0.7, 110.0, -40.0, study.converter.omega_n, 9.0, 0.3)
    counts = [1, 200, 173, 1500, 200]
    begins = (7001 + np.cumsum([0, *counts[:-1]])).tolist()
    intervals = [Interval(T_s, Connection(study.grid), ramp.at(begin * T_s), ()) for begin in begins]
    apart = [
        Background(lambda _: circuit, 100.0).rows([one], 0, count, T_s)
        for one, count in zip(intervals, counts, strict=True)
    ]
    together = Background(lambda _: circuit, 100.0).of_ramp(intervals, counts, T_s)
    for one, other in zip(apart, together, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.ptp(together[3], axis=0).min() > 0.0
