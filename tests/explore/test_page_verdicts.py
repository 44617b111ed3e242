"""What a page without a server judges its runs with: its functions in a host of WebAssembly, and the rest after an
event."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.codegen.wasm_host import wasm_loop
from tests.equations.test_sampled_path import CASES, drawn, of_source
from vsgdesign.codegen.llvm import empty_rows
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.sampled_path import sampled_rest, source_response
from vsgdesign.linear.operating_point.many import (
    CURRENT,
    LIMITER_ACTS,
    LIMITER_PULLS,
    many_steady_states,
    powers_at_pcc,
)
from vsgdesign.metrics.protection import first_trip
from vsgdesign.metrics.survival import LATCHED, NOT_AT_REST, NOT_KNOWN, SLIPPED, STATUSES, SURVIVED
from vsgdesign.report.explore.page_verdicts import guards_of, verdict_loops
from vsgdesign.simulation.circuit_sample import PlantState
from vsgdesign.simulation.seen_sample import (
    FrequencyGuard,
    GuardedFrequency,
    GuardedVoltage,
    VoltageGuard,
    seen_frequency,
    seen_voltage,
)
from vsgdesign.study.parameters.specification import ProtectionLimits


def answered(name: str, **given: float) -> list[float]:
    """What a function of the page says in a host of WebAssembly."""
    spec = verdict_loops()[name]
    rows = empty_rows(spec, 1)
    for at, row in enumerate(spec.rows):
        rows[0, at, 0] = given[row]
    log = np.empty((1, 1, len(spec.logged), 1))
    wasm_loop(spec)(0, 1, rows, np.zeros(0), log=log, every=1)
    return log[0, 0, :, 0].tolist()


VERDICTS = {
    SURVIVED: (0.0, 0.0, 0.0, 1.0, 2.2, 0.9),
    NOT_AT_REST: (0.0, 0.0, 0.0, 2.3, 2.2, 0.9),
    LATCHED: (0.0, 0.0, 0.0, math.inf, 2.2, 0.6),
    SLIPPED: (0.0, 1.0, 1.0, math.inf, 2.2, 0.6),
    NOT_KNOWN: (0.0, 0.0, 1.0, 1.0, 2.2, 0.0),
    "diverged": (1.0, 1.0, 1.0, math.inf, 2.2, 0.0),
}


def test_the_order_in_which_a_verdict_is_found() -> None:
    names = "diverged", "slipped", "too_short", "recovery_s", "deadline_s", "limited_at_end"
    for status, values in VERDICTS.items():
        (place,) = answered("place", **dict(zip(names, values, strict=True)))
        assert STATUSES[int(place)] == status


def test_a_turn_is_a_slip_and_half_of_one_is_not() -> None:
    turn = 2.0 * math.pi
    for last, far, slipped in ((0.4, 2.0, 0.0), (0.4 + turn, 2.0, 1.0)):
        given = {"first": 0.5, "least": -1.6, "most": 1.2, "last": last, "rest": 0.4, "final": 1.0}
        assert answered("swung", **given) == [pytest.approx(far, abs=1e-15), slipped]


def test_the_last_entry_is_interpolated() -> None:
    entry = {"entry.last_out": 100.0, "entry.error_out": 0.03, "entry.error_in": 0.01, "entry.was_out": 0.0}
    (time,) = answered("entered_s", **entry, band=0.02, T_s=1e-3, since_s=0.05)
    assert time == pytest.approx(0.0505, abs=1e-15)
    assert answered("entered_s", **(entry | {"entry.was_out": 1.0}), band=0.02, T_s=1e-3, since_s=0.05) == [math.inf]


def test_a_protection_trips_as_in_the_judge_of_whole_records() -> None:
    """Sample by sample on drawn voltages and frequencies, with limits that are not, just, and long exceeded."""
    study, _ = drawn(CASES[0])
    T_s, circuit, c = study.converter.T_s, study.circuit(), study.converter
    rng, begin, said = np.random.default_rng(29), 450, []
    for _ in range(60):
        t_s = np.array([k * T_s for k in range(900)])
        v_pu = 1.0 + np.cumsum(rng.normal(0.0, 0.01, len(t_s)))
        f_hz = 50.0 + np.cumsum(rng.normal(0.0, 0.004, len(t_s)))
        limits = ProtectionLimits(
            **{name: None if rng.random() < 0.3 else float(rng.uniform(*ends)) for name, ends in DRAWN_LIMITS.items()},
            rocof_window=0.02, V_high_time=float(rng.uniform(0.0, 0.03)), V_low_time=float(rng.uniform(0.0, 0.03)),
        )  # fmt: skip
        expected = first_trip(t_s, f_hz, v_pu, limits, begin * T_s, 2.0 * math.pi / c.omega_n)
        own = replace(study, survival=replace(study.survival, protection=limits))
        voltage, frequency = GuardedVoltage(0.0, 0.0, 0.0, 0.0, 0.0), GuardedFrequency(0.0, 0.0)
        trips = []
        for guard in guards_of(own):
            at, ago = max(begin, guard["ago"]) if guard["whole"] else begin, guard["ago"]
            of = {name.removeprefix("guard_of."): value for name, value in guard["of"].items()}
            for k in range(len(t_s)):
                of["on"] = float(k >= at)
                if guard["loop"] == "seen_voltage":
                    V = v_pu * rms_to_peak(c.V_rated_rms)
                    x = PlantState(0.0, 0.0, V[k], 0.0, 0.0, 0.0)
                    V_ago = V[k - ago] if k >= ago else 0.0
                    voltage, _ = seen_voltage(voltage, VoltageGuard(**of), x, circuit, V_ago, k)
                else:
                    omega = 2.0 * math.pi * f_hz
                    before = omega[k - ago] if k >= ago else 0.0
                    frequency, _ = seen_frequency(frequency, FrequencyGuard(**of), omega[k], before, k)
            found = voltage._asdict() | frequency._asdict()
            for name, text in guard["said"].items():
                if found[name]:
                    trips.append((t_s[int(found[name]) - 1], text.format(frequency.rate)))
        assert min(trips, default=None) == expected
        said.append("" if expected is None else expected.reason.split(" ", 3)[1])
    assert min(said.count(one) for one in ("", "frequency", "voltage")) >= 5


DRAWN_LIMITS = {"rocof": (1.0, 12.0), "V_high_pu": (1.05, 1.6), "V_low_pu": (0.4, 0.95)}


@pytest.mark.parametrize("case", CASES[:2])
def test_the_rest_of_the_page_is_the_steady_state(case: str) -> None:
    """Against the model that finds steady states with matrices."""
    study, lanes = drawn(case)
    gains = PowerLoopGains(*[0.0] * len(PowerLoopGains._fields))
    states = many_steady_states(study, lanes, gains)
    good = np.flatnonzero(np.isin(states.fault, (0, CURRENT, LIMITER_ACTS, LIMITER_PULLS)))
    assert len(good) > 10
    transition, circuit, steps = of_source(study, lanes)
    of_constant, _, _, turn = source_response(transition, circuit, study.converter.T_s, lanes.omega_g)
    b_1, b_2, b_3 = steps.bridge.T
    found = sampled_rest(transition, b_1, b_2, b_3, of_constant, turn, circuit, lanes.V_g_rms, states.V, states.delta)
    pcc = powers_at_pcc(study, states, lanes)
    expected = {"P": states.P, "Q": states.Q, "i_s_pk": states.i_s_pk, "v_b_pk": states.v_b_pk}
    expected |= {"P_pcc": pcc[0], "Q_pcc": pcc[1]}
    for name, values in expected.items():
        scale = np.abs(values[good]).max()
        np.testing.assert_allclose(getattr(found, name)[good], values[good], rtol=0.0, atol=1e-8 * scale, err_msg=name)
