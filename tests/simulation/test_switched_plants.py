"""Switched bridges in plants, against matrix exponentials from edge to edge on equations that are written by hand.

The edges are those of pulses that are centred on the valleys of each unit's carrier, and the controllers those of
:mod:`tests.oracles.emt_controller`. Tolerance: 1e-8 of rated.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from tests.oracles.emt_controller import SampledController, State, bridge_pieces
from tests.simulation.test_dc_link import BATTERY
from tests.simulation.test_plants import (
    GAINS,
    OMEGA,
    T_S,
    TOLERANCE,
    Slope,
    errors_pu,
    plant_of,
    plant_study,
    run,
    star,
)
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.units import plant_timeline
from vsgdesign.study.parameters import Study

PWM = '"20 ms"\nbridge = "pwm"'


def rates(slope: Slope, size: int, units: int) -> np.ndarray:
    """dz/dt = M z of the states, the bridges' voltages and the source, which turns."""
    width = size + units + 1
    M = np.zeros((width, width), dtype=complex)
    for k, one in enumerate(np.eye(width)):
        M[:size, k] = slope(0.0, one[:size] + 0j, one[size : size + units] + 0j, complex(one[-1]))
    M[-1, -1] = 1j * OMEGA
    return M


def solved(study: Study, jump: tuple[float, float]) -> np.ndarray:
    """The states at every sampling period, complex, from a cold start; ``jump`` (s, rad) of the source's phase."""
    plant, c = plant_of(study), study.converter
    count, size, periods = len(plant.units), 3 * len(plant.units), round(study.simulation.duration / T_S)
    M = rates(star(study), size, count)
    controllers = [SampledController(study) for _ in plant.units]
    states = [State(-math.pi / 2.0, OMEGA, c.V_rated_rms, 0j, 0j, 0j) for _ in plant.units]
    waiting, pieces = [0j] * count, [[(0.0, T_S, 0j)] for _ in plant.units]
    z = np.zeros(size + count + 1, dtype=complex)
    z[-1] = math.sqrt(2.0) * c.V_rated_rms * np.exp(-0.5j * math.pi)
    due = sorted((k * T_S + unit.offset, u, k) for u, unit in enumerate(plant.units) for k in range(periods))
    marks = sorted({*(round(t, 12) for t, _, _ in due), *(k * T_S for k in range(periods + 1)), jump[0]})
    marks = [t for k, t in enumerate(marks) if k == 0 or t - marks[k - 1] > 1e-11]
    found = []
    for begin, end in itertools.pairwise(marks):
        if begin == jump[0]:
            z[-1] *= np.exp(1j * jump[1])
        if abs(begin / T_S - round(begin / T_S)) < 1e-7:
            found.append(z[:size].copy())
        for t, u, k in due:
            if abs(t - begin) < 1e-11:
                i_s, v_c, i_g = (complex(z[m * count + u]) for m in range(3))
                v = v_c + study.filter.R_c * (i_s - i_g)
                states[u], asked, _ = controllers[u].step(states[u], v, i_s, i_g, (2000.0, 500.0), GAINS)
                pieces[u] = [(t + a, t + b, v_b) for a, b, v_b in bridge_pieces(waiting[u], study, k, True, [])]
                waiting[u] = asked
        edges = {a for some in pieces for a, _, _ in some if begin + 1e-13 < a < end - 1e-13}
        for one, other in itertools.pairwise(sorted({begin, end, *edges})):
            middle = 0.5 * (one + other)
            z[size : size + count] = [next(v for a, b, v in some if a <= middle <= b) for some in pieces]
            z = expm(M * (other - one)) @ z
    return np.array(found)


@pytest.mark.parametrize(("sampling", "samples"), [("together", 2), ("spread", 1), ("spread", 2), ("together", 3)])
def test_two_units(sampling: str, samples: int) -> None:
    """Two units whose carriers are those of their samples, over a jump of the source's phase between two samples."""
    event = '[[events]]\ntime = "2.013 ms"\nphase_jump = "20 deg"\n'
    text = f'[plant]\nunits = 2\nreactance = 0.06\nresistance = 0.01\nsampling = "{sampling}"\n{event}'
    own = {"samples_per_carrier": str(samples), "f_sw": f'"{1e-3 / T_S / samples} kHz"'}
    study = plant_study(text, duration='"4 ms"\nbridge = "pwm"', **own)
    expected = solved(study, (2.013e-3, math.radians(20.0)))
    assert errors_pu(study, run(study), expected) < TOLERANCE
    averaged = run(replace(study, simulation=replace(study.simulation, bridge="averaged")))
    assert errors_pu(study, averaged, expected) > 1e-3


def test_one_unit_is_a_converter() -> None:
    """A plant of one unit runs as one converter does that is not in a plant, over a step of the grid and a jump between
    two samples."""
    events = (
        '[[events]]\ntime = "10.01 ms"\ngrid = { scr = 2 }\n[[events]]\ntime = "15.037 ms"\nphase_jump = "10 deg"\n'
    )
    study = plant_study(f"[plant]\nunits = 1\nreactance = 0.06\n{events}", duration=PWM, start='"steady_state"')
    alone = plant_timeline(study).units[0]
    expected, found = simulate(alone, [GainChange(0.0, GAINS)]), run(study).units[0]
    c = study.converter
    rated = [c.I_rated_pk] * 2 + [math.sqrt(2.0) * c.V_rated_rms] * 2 + [c.I_rated_pk] * 2
    assert np.abs((expected.log - found.log)[:, :6] / rated).max() < 1e-10


def test_what_cannot_be_switched_is_told() -> None:
    stiff = plant_study("[plant]\nunits = 2\nreactance = 0.06\n", duration=PWM, R_c='"140 ohm"', L_1='"20 uH"')
    with pytest.raises(InfeasibleStudyError, match="too stiff to switch"):
        run(stiff)
    fed = plant_study(f"[plant]\nunits = 2\nreactance = 0.06\n{BATTERY}", duration=PWM)
    with pytest.raises(
        InfeasibleStudyError, match="unit unit1: a dc link that moves has an averaged bridge in a plant"
    ):
        run(fed)
