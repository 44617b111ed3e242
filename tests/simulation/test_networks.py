"""Load, fault and breaker in the EMT, against the oracle in phases a, b and c that DOP853 integrates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from tests.oracles.emt_reference import run_reference
from tests.simulation.studies import GAINS, lc_study, lcl_study
from tests.simulation.test_emt_against_dop853 import EVERYTHING, SENSORS, errors_pu, library_start, random_numbers
from vsgdesign.equations.frames import clarke, clarke_inverse
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.network import network_circuit, states_of_networks
from vsgdesign.linear.operating_point.plant import plant_step
from vsgdesign.report.scenario.page import limits_of_validity
from vsgdesign.simulation import GainChange, gain_changes, simulate
from vsgdesign.simulation.every_sample import AtPcc, pcc_vectors
from vsgdesign.simulation.scenario import derive_series, run_scenario
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.grid import PHASE_TO_PHASE, PLAIN, Fault, Load, Network
from vsgdesign.study.parameters.study import Event

CHANGES = [GainChange(0.0, GAINS)]
TOLERANCE = 1e-8
"""Of rated."""


def with_networks(study: Study, *changes: tuple[float, Network]) -> Study:
    """The study with networks from instants on, besides its own events."""
    return replace(
        study, events=(*study.events, *(Event(t_s=t_s, name="network", network=one) for t_s, one in changes))
    )


def check(study: Study, bridge: str, gains: Sequence[GainChange] = CHANGES) -> None:
    """Every quantity at every sample against the oracle, and the run goes somewhere."""
    run = simulate(study, gains, bridge=bridge, log_states=10**9)
    assert run.divergence is None
    reference = run_reference(study, gains, bridge == "pwm", library_start(study, gains), **random_numbers(study))
    errors = errors_pu(study, run, reference)
    print(f"{bridge}: worst {max(errors.values()):.1e} pu;", {name: f"{e:.1e}" for name, e in errors.items()})
    assert max(errors.values()) < TOLERANCE, errors
    assert np.ptp(np.abs(reference.plant[:, 2])) > 0.2 * study.converter.I_rated_pk


FAULTS = (
    Fault(),
    Fault(R=0.2),
    Fault(at=0.3),
    Fault(at=0.6, R=0.5),
    Fault(kind=PHASE_TO_PHASE, phases="bc"),
    Fault(kind=PHASE_TO_PHASE, phases="ca", at=0.4, R=0.3),
    Fault(kind=PHASE_TO_PHASE, phases="ab", R=0.7),
)


def one_by_one(networks: Iterable[Network], each: float, between: Network = PLAIN) -> list[tuple[float, Network]]:
    """Each of the networks for a while and then another one, at instants between two samples and on a sample."""
    found, t_s = [], 0.5123e-3
    for network in networks:
        found += [(t_s, network), (round((t_s + each) / 50e-6) * 50e-6, between)]
        t_s += each + 0.4071e-3
    return found


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_faults_and_their_clearing(build: Callable[..., Study], bridge: str) -> None:
    """One fault after the other, so that a run has three places of faults inside the grid."""
    changes = one_by_one([Network(fault=fault) for fault in FAULTS], 0.6e-3)
    check(with_networks(build("8 ms"), *changes), bridge)


LOADS = (
    Load(R_parallel=12.0),
    Load(R_series=9.0, L_series=15e-3),
    Load(R_parallel=20.0, L_parallel=50e-3, C_parallel=40e-6),
    Load(R_series=30.0, C_series=200e-6),
    Load(R_parallel=15.0, R_series=4.0, L_series=8e-3, C_series=60e-6),
    Load(C_series=30e-6),
)


def bare(duration: str) -> Study:
    """An LCL filter without a damping resistor."""
    return lcl_study(duration, R_c='"0 ohm"')


@pytest.mark.parametrize(("build", "bridge"), [(lc_study, "averaged"), (lcl_study, "pwm"), (bare, "averaged")])
def test_loads_that_are_switched_on_changed_and_off(build: Callable[..., Study], bridge: str) -> None:
    changes = []
    for k, load in enumerate(LOADS):
        other = replace(load, R_parallel=25.0)
        on, off = 0.3123e-3 + k * 1.2e-3, 1.2e-3 + k * 1.2e-3
        changes += [(on, Network(load=load)), (on + 0.5e-3, Network(load=other)), (off, PLAIN)]
    check(with_networks(build("7.5 ms"), *changes), bridge)


@pytest.mark.parametrize(("build", "bridge"), [(lc_study, "pwm"), (lcl_study, "averaged"), (bare, "pwm")])
def test_islands_that_are_connected_again(build: Callable[..., Study], bridge: str) -> None:
    """Out of phase, because the source turns by 140° before the last one; without any load, too."""
    study = build("7.5 ms")
    jump = Event(t_s=5.5e-3, name="jump", phase_jump=np.deg2rad(140.0))
    islands = [Network(load=load, connected=False) for load in (None, *LOADS[:3])]
    check(with_networks(replace(study, events=(jump,)), *one_by_one(islands, 1.2e-3)), bridge)


def test_two_changes_within_a_sampling_period() -> None:
    """A fault that lasts a third of a sampling period, while the source jumps and the grid changes."""
    study = lcl_study("3 ms", '[[events]]\ntime = "1.02 ms"\nphase_jump = "20 deg"\ngrid = { scr = 5 }\n')
    check(with_networks(study, (1.0123e-3, Network(fault=Fault(at=0.5))), (1.0301e-3, Network(load=LOADS[0]))), "pwm")


def test_a_megawatt_at_sixty_hertz() -> None:
    """480 V, an LCL filter and one sample of delay: a fault on a load, and an island."""
    text = f"""
base = "case:utility_1mva_60hz"
[simulation]
duration = "25 ms"
P_ref = "500 kW"
Q_ref = 0
log_interval = {1.0 / 6000.0!r}
[[controllers]]
name = "fixed"
kind = "fixed"
"""
    study = study_from_text(text)
    gains = gain_changes(study, study.controllers[0], build_timeline(study))
    load = Load(R_parallel=1.0, R_series=0.4, L_series=0.5e-3)
    changes = [
        (3.01e-3, Network(load=load)),
        (6.03e-3, Network(load=load, fault=Fault(kind=PHASE_TO_PHASE, at=0.5, R=2e-3))),
        (11.2e-3, Network(load=load)),
        (15.3e-3, Network(load=load, connected=False)),
        (20.2e-3, PLAIN),
    ]
    check(with_networks(study, *changes), "pwm", gains)


@pytest.mark.parametrize("load", LOADS, ids=str)
@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_a_start_with_a_load_is_steady(build: Callable[..., Study], load: Load) -> None:
    """Nothing moves for a cycle."""
    study = replace(build("20 ms"), network=Network(load=load))
    run = simulate(study, CHANGES)
    i_g = np.hypot(*run.log[:, 4:6].T)
    assert np.ptp(i_g) < 1e-10 * study.converter.I_rated_pk
    assert np.ptp(run.column("P")) < 1e-10 * study.converter.S_rated
    assert np.ptp(run.column("omega")) < 1e-10 * study.converter.omega_n
    # The load draws something: without it the converter's current is another one.
    alone = simulate(replace(study, network=PLAIN), CHANGES)
    assert abs(i_g[0] - np.hypot(*alone.log[0, 4:6])) > 1e-3 * study.converter.I_rated_pk


def test_a_start_that_cannot_be_says_why() -> None:
    study = lc_study("5 ms")
    for network, why in (
        (Network(connected=False), "behind an open breaker"),
        (Network(fault=Fault(R=1.0)), "a fault is there"),
        (Network(load=Load(C_parallel=5e-3)), "capacitive together"),
    ):
        with pytest.raises(InfeasibleStudyError, match=f"the start: .*{why}"):
            simulate(replace(study, network=network), CHANGES)
    cold = lc_study("5 ms", simulation='start = "cold"')
    assert simulate(replace(cold, network=Network(connected=False)), CHANGES).divergence is None


def test_wrong_networks_are_told_with_all_faults() -> None:
    wrong = Network(fault=Fault(kind="earth", at=1.0, R=-1.0, phases="ba"), load=Load(R_parallel=0.0, L_series=-1e-3))
    with pytest.raises(InfeasibleStudyError) as said:
        simulate(with_networks(lc_study("5 ms"), (1e-3, wrong)), CHANGES)
    for part in ("fault.kind = 'earth'", "fault.at = 1 ", "fault.R = -1", "fault.phases = 'ba'"):
        assert part in str(said.value)
    for part in ("load.R_parallel = 0 ", "load.L_series = -0.001 "):
        assert part in str(said.value)


def test_currents_that_nothing_says_are_refused() -> None:
    """A bolted fault beside a series branch of no ohms."""
    both = Network(fault=Fault(), load=Load(R_series=0.0))
    with pytest.raises(InfeasibleStudyError, match=r"side by side.*Give fault\.R or load\.R_series a value"):
        simulate(with_networks(lc_study("5 ms"), (1e-3, both)), CHANGES)


def test_the_page_says_what_is_near() -> None:
    study = lc_study("30 ms")
    said = "; no other converter or load is near."
    assert any(item.endswith(said) for item in limits_of_validity(run_scenario(study)))
    loaded = limits_of_validity(run_scenario(with_networks(study, (20e-3, Network(load=LOADS[0])))))
    assert not any(item.endswith(said) for item in loaded)
    assert any("ends phase by phase at the zeros of its currents" in item for item in loaded)


def test_another_circuit_meets_no_network() -> None:
    study = with_networks(lc_study("5 ms"), (1e-3, Network(fault=Fault())))
    with pytest.raises(InfeasibleStudyError, match="Leave circuit out"):
        simulate(study, CHANGES, circuit=study.circuit)


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_the_voltage_at_the_pcc(build: Callable[..., Study]) -> None:
    """What a fault and a load say of it by Ohm's law, and the plain formula where there is nothing but the grid."""
    R, load = 0.4, Load(R_parallel=11.0)
    changes = [
        (2e-3, Network(fault=Fault())),
        (4e-3, Network(fault=Fault(kind=PHASE_TO_PHASE, phases="ab"))),
        (6e-3, Network(fault=Fault(R=R), connected=False)),
        (8e-3, Network(load=load, connected=False)),
        (10e-3, Network(fault=Fault(at=0.5))),
        (14e-3, PLAIN),
    ]
    study = with_networks(build("18 ms"), *changes)
    run = simulate(study, CHANGES)
    v, i = AtPcc(study, run.timeline).rows(run.t_s, run.log, run.circuit_log)
    V_pk, t = study.converter.v_max_pk, np.round(run.t_s * 1e3, 6)

    def within(begin: float, end: float) -> np.ndarray:
        return (t > begin) & (t < end)

    bolted = within(2.0, 4.0)
    assert np.abs(v[bolted]).max() < 1e-9 * V_pk
    a, b, _ = clarke_inverse(*v[within(4.0, 6.0)].T)
    assert np.abs(a - b).max() < 1e-9 * V_pk
    assert np.abs(a).max() > 0.05 * V_pk
    for begin, ohms in ((6.0, R), (8.0, 11.0)):
        some = within(begin, begin + 2.0)
        np.testing.assert_allclose(v[some], ohms * i[some], atol=1e-9 * V_pk)
    # Behind half of the grid's impedance: an R and an L with the current into them, seen as a difference quotient.
    some = np.flatnonzero(within(10.5, 14.0))
    slope = (i[some[2:]] - i[some[:-2]]) / (2.0 * study.converter.T_s)
    half = 0.5 * study.grid.R_g * i[some[1:-1]] + 0.5 * study.grid.L_g * slope
    assert np.abs(v[some[1:-1]] - half).max() < 0.02 * V_pk
    plain = np.flatnonzero(within(14.0, 18.0))
    np.testing.assert_allclose(v[plain], pcc_vectors(run.log[plain], study.circuit())[0], atol=1e-9 * V_pk)
    # A page is given the same.
    series = derive_series(study, run)
    np.testing.assert_array_equal(clarke(*(series[f"v_pcc_{phase}"] for phase in "abc"))[0][bolted], v[bolted, 0])


COMPONENTS = """
[[events]]
time = "0.5 ms"
components = [{ order = -1, amplitude_pu = 0.2, phase = "-20 deg" }, { order = 5, amplitude_pu = 0.02 }]
[[events]]
time = "2 ms"
f_g = "50.15 Hz"
over = "4 ms"
[[events]]
time = "2.4 ms"
V_g_pu = 0.7
over = "2 ms"
"""


@pytest.mark.parametrize(
    ("build", "bridge", "network"),
    [
        (lc_study, "averaged", Network(load=Load(R_series=9.0, L_series=15e-3, C_parallel=20e-6))),
        (lcl_study, "pwm", Network(fault=Fault(kind=PHASE_TO_PHASE, at=0.5, phases="ca"))),
    ],
)
def test_a_distorted_source_that_ramps(build: Callable[..., Study], bridge: str, network: Network) -> None:
    """A negative sequence and a harmonic, ramps of frequency and voltage, and a line that is switched out."""
    study = build("5 ms", COMPONENTS + '[[events]]\ntime = "3.0333 ms"\ngrid = { scr = 2, x_over_r = 5 }\n')
    check(with_networks(study, (1.0123e-3, network), (4.2e-3, PLAIN)), bridge)


def test_networks_in_a_restless_grid_with_sensors() -> None:
    study = with_networks(lcl_study("4 ms", EVERYTHING + SENSORS), (1.0123e-3, Network(fault=Fault(at=0.4, R=0.5))))
    check(with_networks(study, (2.07e-3, Network(load=LOADS[2]))), "averaged")


def exponential(M: np.ndarray) -> np.ndarray:
    """e^M in extended precision, by a Taylor series of M/2^k that is squared k times."""
    M = M.astype(np.longdouble)
    k = max(int(np.ceil(np.log2(float(np.abs(M).sum(axis=0).max())))), 0) + 2
    term = total = np.eye(len(M), dtype=np.longdouble)
    for n in range(1, 25):
        term = term @ M / (n * np.longdouble(2.0) ** k)
        total = total + term
    for _ in range(k):
        total = total @ total
    return total.astype(float)


@pytest.mark.skipif(bool(np.finfo(np.longdouble).eps > 1e-18), reason="this processor has no longer numbers")
@pytest.mark.parametrize(
    ("build", "network", "stiff"),
    [(lc_study, Network(fault=Fault(R=1e-3)), 1e3), (lcl_study, Network(load=Load(R_parallel=1e4)), 1e3)],
)
def test_a_stiff_network_keeps_the_digits_of_its_slow_modes(
    build: Callable[..., Study], network: Network, stiff: float
) -> None:
    """What a fault of 1 mΩ across a capacitor does; in per unit of each state."""
    study = build("1 ms")
    states = states_of_networks([network])
    circuit, h = network_circuit(study.filter, study.grid, network, states), study.converter.T_s
    assert np.abs(np.linalg.eigvals(circuit.A)).max() * h > 0.9 * stiff
    n, step = len(circuit.A), plant_step(circuit, h, 314.0, edges=False)
    M = np.zeros((n + 4, n + 4))
    M[:n] = np.hstack([circuit.A, circuit.B, circuit.E]) * h
    M[n + 2 :, n + 2 :] = np.array([[0.0, -314.0], [314.0, 0.0]]) * h
    exact = exponential(M)
    rated = [study.converter.I_rated_pk if name.startswith("i") else study.converter.v_max_pk for name in states.names]
    scale = np.repeat(rated, 2)
    errors = [
        (step.transition - exact[:n, :n] @ np.asarray(circuit.onto)) * scale,
        (step.bridge - exact[:n, n : n + 2]) * study.converter.v_max_pk,
        (step.source[0] - exact[:n, n + 2 :]) * study.converter.v_max_pk,
    ]
    assert max(np.abs(error / scale[:, None]).max() for error in errors) < 3e-11


def test_networks_that_are_too_stiff_are_refused() -> None:
    """Where rounding would show; and, sooner, for a bridge that switches. No warning of NumPy besides."""
    study = with_networks(lc_study("5 ms"), (1e-3, Network(fault=Fault(R=1e-7))))
    with pytest.raises(InfeasibleStudyError, match=r"^three-phase fault at the PCC, 100 nohm: .*zero \(bolted\)"):
        simulate(study, CHANGES)
    study = with_networks(lcl_study("5 ms"), (1e-3, Network(load=Load(R_parallel=5e6))))
    assert simulate(study, CHANGES, bridge="averaged").divergence is None
    with pytest.raises(InfeasibleStudyError, match=r"too stiff to switch: .*or a load larger"):
        simulate(study, CHANGES, bridge="pwm")


def jumped(study: Study, before: Network, after: Network, **given: complex) -> dict[str, complex]:
    """The states just after a change of the network, from some just before it; the others are zero."""
    states = states_of_networks([before, after])
    x = np.array([given.get(name, 0j) for name in states.names])
    circuit = network_circuit(study.filter, study.grid, after, states)
    found = (np.asarray(circuit.onto) @ np.column_stack([np.real(x), np.imag(x)]).ravel()).reshape(-1, 2)
    return dict(zip(states.names, found[:, 0] + 1j * found[:, 1], strict=True))


def test_jumps_by_hand() -> None:
    """Fluxes and charges, one kind of change after the other."""
    lc, lcl, a, b = lc_study("1 ms"), lcl_study("1 ms"), 7.0 + 2.0j, -3.0 + 5.0j
    L_2, L_g = lcl.filter.L_2, lcl.grid.L_g
    # A fault at the PCC ends: both inductances keep their flux together.
    found = jumped(lcl, Network(fault=Fault()), PLAIN, i_g=a, i_grid_0=b)
    assert found["i_g"] == pytest.approx((L_2 * a + L_g * b) / (L_2 + L_g), rel=1e-12)
    assert found["i_grid_0"] == pytest.approx(found["i_g"], rel=1e-12)
    # One behind 30 % of the grid's impedance ends.
    found = jumped(lcl, Network(fault=Fault(at=0.3)), PLAIN, i_g=a, i_grid_0=a, i_grid_1=b)
    assert found["i_grid_1"] == pytest.approx(((L_2 + 0.3 * L_g) * a + 0.7 * L_g * b) / (L_2 + L_g), rel=1e-12)
    # The breaker opens: nothing flows, unless a load takes the filter's current.
    assert abs(jumped(lcl, PLAIN, Network(connected=False), i_g=a, i_grid_0=a)["i_g"]) < 1e-12
    island = Network(load=Load(R_parallel=5.0), connected=False)
    found = jumped(lcl, Network(load=island.load), island, i_g=a, i_grid_0=b)
    assert found["i_g"] == pytest.approx(a, rel=1e-12)
    assert abs(found["i_grid_0"]) < 1e-12
    # An empty capacitor beside a full one without any resistance between them: they share the charge.
    bank = 3.0 * lc.filter.C
    bare_lc = replace(lc, filter=replace(lc.filter, R_c=0.0))
    found = jumped(bare_lc, PLAIN, Network(load=Load(C_parallel=bank)), v_c=100.0 + 0j, i_s=a, i_g=a, i_grid_0=a)
    assert found["v_c"] == pytest.approx(25.0, rel=1e-12)
    assert found["v_bank"] == pytest.approx(25.0, rel=1e-12)
    # A bolted fault between b and c empties it in the direction of β, and leaves α as it is.
    found = jumped(bare_lc, PLAIN, Network(fault=Fault(kind=PHASE_TO_PHASE)), v_c=80.0 + 60.0j)
    assert found["v_c"] == pytest.approx(80.0, rel=1e-12)


def test_a_resistive_fault_on_an_lc_filter_by_hand() -> None:
    """The current into the PCC has no inductance there: i_2 = (v_c + R i_g)/R. The oracle integrates i_2 and drifts by
    some 1e-8 of rated in 10 ms; three equations written by hand and SciPy's exponential do not."""
    study = lc_study("1 ms")
    f, g, R, h = study.filter, study.grid, 0.2, study.converter.T_s
    assert f.L_2 == f.R_2 == f.R_c == 0.0
    circuit = network_circuit(f, g, Network(fault=Fault(R=R)), states_of_networks([Network(fault=Fault(R=R))]))
    A = np.array(
        [
            [-f.R_1 / f.L_1, -1.0 / f.L_1, 0.0],
            [1.0 / f.C, -1.0 / (R * f.C), -1.0 / f.C],
            [0.0, 1.0 / g.L_g, -g.R_g / g.L_g],
        ]
    )
    over = expm(h * A)
    transition = plant_step(circuit, h, study.converter.omega_n).transition
    by_hand, x = np.array([20.0, 100.0, 30.0]), np.zeros(len(transition))
    x[[0, 2, 6]], x[4] = by_hand, by_hand[1] / R + by_hand[2]
    for _ in range(200):
        by_hand, x = over @ by_hand, transition @ x
    np.testing.assert_allclose(x[[0, 2, 6, 4]], [*by_hand, by_hand[1] / R + by_hand[2]], atol=1e-12)
