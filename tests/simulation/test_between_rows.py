"""What is taken of the samples between two rows, against the samples themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.test_together import EVENTS, of, study_of
from vsgdesign.simulation.between_rows import RowsAsked, between_rows, taken_of_log
from vsgdesign.simulation.energy import dc_energy
from vsgdesign.simulation.loop import SEEN_COLUMNS
from vsgdesign.simulation.run import Simulation, simulated, simulated_together
from vsgdesign.simulation.run_asked import RunOf


@pytest.mark.parametrize("asked", [RowsAsked(20, 10), RowsAsked(0, 3)])
def test_rows_have_the_largest_currents_and_the_mean_power_since_the_row_before(asked: RowsAsked) -> None:
    study = study_of(EVENTS["jump between samples"], 0.4)
    run = simulated(of(study))
    rows, taken = run.log[asked.first :: asked.every], taken_of_log(study, run.log, asked)
    length, phase, power = between_rows(study, rows, taken, asked)
    every, T_s = asked.every, study.converter.T_s
    alpha, beta = run.log[:, 0], run.log[:, 1]
    phases = np.abs([alpha * np.cos(turn) + beta * np.sin(turn) for turn in 2.0 * np.pi / 3.0 * np.arange(3)])
    energy = dc_energy(run, study)
    for row in range(1, len(length)):
        some = slice(asked.first + (row - 1) * every + 1, asked.first + row * every + 1)
        assert length[row] == pytest.approx(np.hypot(alpha[some], beta[some]).max(), rel=1e-14)
        assert phase[row] == pytest.approx(phases[:, some].max(), rel=1e-13)
        taken = (energy[some.stop - 1] - energy[some.start - 1]) / (every * T_s)
        assert power[row] == pytest.approx(taken, abs=1e-8)  # 1 kJ rounds by 1e-13 J, over 0.15 ms at least
    assert (length[0], phase[0]) == pytest.approx(
        (np.hypot(alpha, beta)[asked.first], phases[:, asked.first].max()), rel=1e-13
    )
    assert power[0] == power[1]


def test_runs_side_by_side_have_the_rows_of_their_logs() -> None:
    """A run that finds an instant and one that is cut are among them."""
    asked = RowsAsked(100, 10)
    studies = [study_of(event, 0.13 + 0.01 * k) for k, event in enumerate(EVENTS.values())]
    for study in studies:
        assert of(study).rows is None
    runs = [RunOf(study, of(study).schedule, finds=study.controllers[0], rows=asked) for study in studies]
    for number, run in simulated_together(runs):
        assert isinstance(run, Simulation)
        assert run.between is not None
        taken = taken_of_log(studies[number], run.log, asked)
        np.testing.assert_array_equal(run.between[10 : len(taken)], taken[10:])  # before the first row nothing is asked


@pytest.mark.parametrize("alone", [True, False])
def test_a_thin_log_has_rows_and_samples_of_the_whole_one(alone: bool) -> None:
    """To the bit, with instants that the run finds, and beside others as alone."""
    studies = [study_of(event, 0.13) for event in EVENTS.values()]
    whole = [RunOf(study, of(study).schedule, finds=study.controllers[0]) for study in studies]
    thin = [replace(one, rows=RowsAsked(100, 10, thin=True)) for one in whole]
    found = [*enumerate(map(simulated, thin))] if alone else list(simulated_together(thin))
    assert len(found) == len(whole) > 1
    for number, run in found:
        assert isinstance(run, Simulation)
        other = simulated(whole[number])
        np.testing.assert_array_equal(run.log, other.log[::10])
        np.testing.assert_array_equal(run.t_s, other.t_s[::10])
        np.testing.assert_array_equal(run.each_s, other.t_s)
        for name in SEEN_COLUMNS:
            np.testing.assert_array_equal(run.each(name), other.each(name))
