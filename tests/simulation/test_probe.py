"""A probe: nothing where it is nothing, the voltage that was asked for where it is something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation import (
    FixedGains,
    GainChange,
    Probe,
    Recorder,
    Simulation,
    build_timeline,
    gain_changes,
    simulate,
)
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study

PUBLISHED = "studies/published_averaged/study.toml"


def short(duration: float = 0.2) -> tuple[Study, GainChange]:
    study = load_study(PUBLISHED)
    study = replace(study, events=(), simulation=replace(study.simulation, duration=duration, start="steady_state"))
    return study, gain_changes(study, study.controllers[-1], build_timeline(study))[0]


def run(probe: Probe | None, duration: float = 0.2) -> Simulation:
    study, change = short(duration)
    return simulate(study, [change], probe=probe)


def test_a_probe_of_nothing_changes_nothing() -> None:
    """Cutting the run differently is exact but for the source's rotation, which is begun anew at every cut."""
    silent = run(Probe(np.zeros(3, dtype=complex), 1e-3))
    assert np.abs(silent.log - run(None).log).max() < 1e-8 * np.abs(silent.log).max()


def test_the_added_voltage_is_the_one_asked_for() -> None:
    """1 % on the q axis turns the logged angle by atan(0.01·V_n/V) and leaves |V| but for second order."""
    study, _ = short()
    relative = 0.01
    probed = run(Probe(np.array([1j * relative]), 1e-3), 1e-3)
    plain = run(None, 1e-3)
    V = plain.column("V_rms")[0]
    angle = probed.column("theta")[0] - plain.column("theta")[0]
    assert angle == pytest.approx(np.arctan(relative * study.converter.V_rated_rms / V), rel=1e-9)
    assert probed.column("V_rms")[0] == pytest.approx(np.hypot(V, relative * study.converter.V_rated_rms), rel=1e-12)


def test_the_power_loops_are_left_as_they_were() -> None:
    """The probe is taken away again: a constant one does not run away with the integrators."""
    study, change = short(0.5)
    probed = simulate(study, FixedGains(change.gains), probe=Probe(np.array([0.001, -0.001], dtype=complex), 1e-3))
    plain = simulate(study, [change])
    V, V_plain = probed.final_state.V, plain.final_state.V
    assert pytest.approx(V_plain, rel=1e-4) == V
    assert probed.final_state.omega_i == pytest.approx(plain.final_state.omega_i, rel=1e-5)


def test_the_grid_answers_with_its_impedance() -> None:
    """75 Hz, averaged bridge: V/I of two cycles is R_g + j2π75·L_g but for what the power still creeps."""
    frequency, hold = 25.0, 200e-6
    steps = round(1.0 / frequency / hold)
    turn = 2.0 * np.pi * frequency * hold
    study, change = short(0.6)
    case = replace(study, simulation=replace(study.simulation, bridge="averaged"))
    scheduler = FixedGains(change.gains, 0.04, hold)
    recorder = Recorder(scheduler)
    turning = np.array(0.005 * np.exp(1j * turn * np.arange(steps)), dtype=np.complex128)
    simulate(case, recorder, probe=Probe(turning, hold))
    window = recorder.windows[-1]
    e = np.exp(-2j * np.pi * 75.0 * hold * np.arange(steps))
    v, i = (np.mean((x[:, 0] + 1j * x[:, 1]) * e) for x in (window.v_pcc, window.i_pcc))
    Z = study.grid.R_g + 2j * np.pi * 75.0 * study.grid.L_g
    assert abs(v / i - Z) < 0.01 * abs(Z)


def test_a_hold_that_does_not_fit_is_refused() -> None:
    with pytest.raises(InfeasibleStudyError, match="whole multiple"):
        run(Probe(np.array([0.01 + 0j]), 70e-6))


class _Asking(FixedGains):
    """A scheduler that asks for a probe of another hold than it said."""

    probe_hold = 1e-3

    def wanted(self) -> Probe:
        return Probe(np.array([0.001 + 0j]), 2e-3)


def test_a_probe_is_held_as_long_as_was_said() -> None:
    study, change = short()
    with pytest.raises(InfeasibleStudyError, match=r"1 values of 0\.002 s are asked for .* for 0\.001 s"):
        simulate(study, _Asking(change.gains))
