"""Four public grid-following converters on a ring: network, modes, and the least short-circuit power.

Nothing is known of the sampling and the delay in the EMT program of its authors. With continuous controllers the limit
is 10.3 GVA and 14.4 Hz. With samples at 10 kHz that act one sample later, as our converters have them, it is 14.4 GVA
and 15.4 Hz, and at 5 kHz 19.9 GVA: the published 16 to 17.7 GVA and 16 Hz lie between.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.simulation.four_converters import CONVERTERS, K_PP, KIND, OMEGA, VOLTAGES, study_of, voltage_at
from tests.simulation.four_converters_continuous import Continuous, admittance
from vsgdesign.linear.operating_point.rest_of_units import rest_of_units
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.simulation.units import plant_timeline, simulate_plant
from vsgdesign.simulation.units.start import situation_at
from vsgdesign.study.parameters.inverter_kinds import INVERTER_KINDS


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    forget = INVERTER_KINDS.register(KIND)
    yield
    forget()
    assert KIND.name not in INVERTER_KINDS


def modes(S_sc: float, f_s: str, circuits: int, delay: int = 0) -> np.ndarray:
    """Of the package's full-order model, 1/s."""
    study = study_of(S_sc, f_s, circuits, delay)
    timeline = plant_timeline(study)
    rest = rest_of_units(situation_at(study, timeline, timeline.segments[0], [], []))
    return to_continuous(np.linalg.eigvals(rest.A), rest.model.clock.period)


def oscillation(modes: np.ndarray) -> complex:
    """The least damped mode of 5 to 30 Hz, 1/s."""
    turns = np.imag(modes) / (2.0 * math.pi)
    within = modes[(turns > 5.0) & (turns < 30.0)]
    return complex(within[np.real(within).argmax()])


def test_the_network_is_that_of_the_published_load_flow() -> None:
    """The voltages of its file and these branches give the powers of its converters, to 0.2 of 2,400 MVA."""
    v = np.array([voltage_at(bus) for bus in VOLTAGES])
    S = v * np.conj(admittance(2, 1e4) @ v)
    S[list(VOLTAGES).index("C")] -= 400.0 * np.conj(1e4 / 1j / 400.0**2 * 400.0)  # of the source
    for bus, found in zip(VOLTAGES, S, strict=True):
        expected = sum(c.P + 1j * c.Q for c in CONVERTERS if c.bus == bus)
        assert abs(found - expected) < 0.2


def test_with_phasors_the_limit_is_the_published_one() -> None:
    """5.5 GVA and 8 Hz, within 6 and 2 %. The gain K_pp of its data file (33.3) is needed for it; with the one that its
    presentation defines (0.0333) the limit is 2.7 GVA."""
    weak, strong = (oscillation(Continuous(S, 1, 33.3, phasors=True).modes()) for S in (0.94 * 5500.0, 5500.0))
    assert strong.real < 0.0 < weak.real
    assert strong.imag == pytest.approx(2.0 * math.pi * 8.0, rel=0.02)


def test_the_modes_are_those_of_the_continuous_equations() -> None:
    """Sampled at 1 MHz, all modes slower than 500 1/s."""
    found, expected = modes(12000.0, "1 MHz", 1), Continuous(12000.0, 1, K_PP, phasors=False).modes()
    slow = expected[np.abs(expected) < 500.0]
    assert len(slow) > 20
    assert max(np.abs(found - one).min() / abs(one) for one in slow) < 1e-3


def test_the_limit_is_near_the_published_one() -> None:
    """16 GVA and 16 Hz, within 20 % and 6 %."""
    weak, strong = (oscillation(modes(S, "10 kHz", 1, delay=1)) for S in (0.8 * 16000.0, 1.2 * 16000.0))
    assert weak.real > 2.0
    assert strong.real < -2.0
    share = weak.real / (weak.real - strong.real)
    assert weak.imag + share * (strong.imag - weak.imag) == pytest.approx(2.0 * math.pi * 16.0, rel=0.06)


@pytest.mark.parametrize("S_sc", [12800.0, 17700.0])
def test_the_circuit_opens_in_emt(S_sc: float) -> None:
    """The voltage of WP2 swings with the mode of the network without the circuit, and grows or decays as it does. What
    opens leaves 50 Hz in the frame of the source, which the reactors without resistance keep. Within 0.5 1/s: in the
    run the capacitance of the open circuit stays."""
    found = simulate_plant(study_of(S_sc, "10 kHz", 2, delay=1, opens=True), [])
    after = found.t_s > 0.3
    t_s, V = found.t_s[after] - 0.3, found.inverters[1].column("V_rms")[after]
    expected = oscillation(modes(S_sc, "10 kHz", 1, delay=1))

    def missed(parts: np.ndarray) -> np.ndarray:
        lines = (complex(*parts), 1j * OMEGA)
        waves = [np.exp(one * t_s) for one in lines]
        columns = [np.ones_like(t_s), *(part for one in waves for part in (np.real(one), np.imag(one)))]
        basis = np.array(columns).T
        return basis @ np.linalg.lstsq(basis, V, rcond=None)[0] - V

    best = least_squares(missed, [0.0, 2.0 * math.pi * 16.0], x_scale=[1.0, 10.0])
    assert abs(complex(*best.x) - expected) < 0.5
