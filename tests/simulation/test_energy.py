"""The energy of the dc link against a circuit that is integrated with known bridge voltages, and against a balance."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import simpson, solve_ivp

from tests.simulation.studies import GAINS, lc_study, lcl_study
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation import GainChange, Simulation, simulate
from vsgdesign.simulation.energy import dc_energy, dc_power
from vsgdesign.simulation.loop import LOG_COLUMNS
from vsgdesign.study.parameters import Study

CHANGES = [GainChange(0.0, GAINS)]
STEP = '[[events]]\ntime = "20 ms"\nP_ref = "3 kW"\n[[events]]\ntime = "40 ms"\nV_g_pu = 0.7\n'
FAULT = """
[[events]]
time = "10 ms"
load = { series = { R_pu = 1.2, X_L_pu = 0.5 } }
[[events]]
time = "20 ms"
fault = { kind = "phase_to_phase", R = "20 ohm" }
[[events]]
time = "35 ms"
fault = "cleared"
[[events]]
time = "40 ms"
breaker = "open"
"""


def logged(study: Study, states: np.ndarray) -> Simulation:
    """A run with these states at the samples, (n, 3) complex: i_s, v_c, i_g."""
    run = simulate(study, CHANGES)
    log = np.zeros((len(states), len(LOG_COLUMNS)))
    log[:, 0:6] = np.stack([part for x in states.T for part in (x.real, x.imag)], axis=1)
    return replace(run, log=log, t_s=np.arange(len(states)) * study.converter.T_s)


@pytest.mark.parametrize(
    ("study", "switched", "tolerance"),
    [
        (lc_study("2 ms"), False, 3e-6),
        (lcl_study("2 ms"), False, 3e-6),
        (lcl_study("2 ms", log="200 us", f_sw='"2.5 kHz"'), False, 1e-3),  # ωT_s = 1 at the resonance
        (lcl_study("2 ms"), True, 1e-3),
    ],
)
def test_each_sample_is_that_of_an_integrated_circuit(study: Study, switched: bool, tolerance: float) -> None:
    """Bridge voltages that nobody has in the log, behind a filter that ends in a resistance and a source.

    The switched bridge has the same voltage only in the middle half of each sample, twice as large.
    """
    f, T_s = study.filter, study.converter.T_s
    L_2, R_load, rng = f.L_2 + 1e-3, 5.0, np.random.default_rng(7)

    def slope(t: float, x: np.ndarray, v_b: complex) -> list[complex]:
        i_s, v_c, i_g, _ = x
        v = v_c + f.R_c * (i_s - i_g)
        v_g = 150.0 * np.exp(1j * 314.0 * t)
        rates = (v_b - f.R_1 * i_s - v) / f.L_1, (i_s - i_g) / f.C, (v - R_load * i_g - v_g) / L_2
        return [*rates, 1.5 * (v_b * i_s.conjugate()).real]

    x = np.array([5.0 + 2.0j, 150.0 + 0j, 4.0 + 1.0j, 0.0 + 0j])
    states, energy = [x[:3]], [0.0]
    for k in range(60):
        mean = 170.0 * np.exp(1j * (314.0 * (k + 0.5) * T_s + 0.1)) + 8.0 * (rng.normal() + 1j * rng.normal())
        parts = [(1.0, mean)] if not switched else [(0.25, 0.0), (0.5, 2.0 * mean), (0.25, 0.0)]
        at = k * T_s
        for share, v_b in parts:
            done = solve_ivp(slope, (at, at + share * T_s), x, "DOP853", rtol=1e-11, atol=1e-11, args=(v_b,))
            x, at = done.y[:, -1], at + share * T_s
        states.append(x[:3])
        energy.append(x[3].real)
    run = logged(study, np.array(states))
    found = dc_energy(run, study, bridge="pwm" if switched else "averaged")
    scale = study.converter.S_rated * T_s
    assert np.abs(np.diff(found) - np.diff(energy)).max() < tolerance * scale
    np.testing.assert_allclose(dc_power(run, study)[1:].sum() * T_s, dc_energy(run, study)[-1], rtol=1e-12)


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
@pytest.mark.parametrize("events", [STEP, FAULT])
@pytest.mark.parametrize("make", [lc_study, lcl_study])
def test_energy_is_delivered_lost_or_stored(make: object, events: str, bridge: str) -> None:
    """Over a run: what the dc link gives is what leaves the filter, what its resistances take and what it holds at the
    end more than at the beginning. The integrals here are Simpson's, from event to event. The grid's current jumps at
    an event, and the log has the value before it; the one after it is that of a parabola. The slope of i_s jumps at
    every sample, and with it that of the voltage of R_c. Both limit how exact the balance is."""
    study = make("60 ms", events)  # type: ignore[operator]
    run = simulate(study, CHANGES, bridge=bridge)
    f, T_s = study.filter, study.converter.T_s
    i_s, v_c, i_g = (run.column(f"{name}_alpha") + 1j * run.column(f"{name}_beta") for name in ("i_s", "v_c", "i_g"))
    v = v_c + f.R_c * (i_s - i_g)
    flow = 1.5 * ((v * i_g.conj()).real + f.R_1 * np.abs(i_s) ** 2 + f.R_c * np.abs(i_s - i_g) ** 2)
    stored = 0.75 * (f.L_1 * np.abs(i_s) ** 2 + f.C * np.abs(v_c) ** 2)
    edges = [0, *(round(event.t_s / T_s) for event in study.events), len(flow) - 1]
    balance = stored[-1] - stored[0]
    for begin, end in itertools.pairwise(edges):
        after = 3.0 * (flow[begin + 1] - flow[begin + 2]) + flow[begin + 3]
        balance += simpson([flow[0] if begin == 0 else after, *flow[begin + 1 : end + 1]], dx=T_s)
    energy = dc_energy(run, study, bridge=bridge)[-1]
    assert abs(energy) > 0.01 * study.converter.S_rated * 0.06
    tolerance = (2e-3 if bridge == "pwm" else 2e-4) * study.converter.S_rated * 0.06
    assert energy == pytest.approx(balance, abs=tolerance)


def test_every_sample_is_needed() -> None:
    study = lc_study("10 ms", log="200 us")
    with pytest.raises(InfeasibleStudyError, match=r"log_interval = 0.0002 s.*Use log_interval = 5e-05"):
        dc_energy(simulate(study, CHANGES), study)
