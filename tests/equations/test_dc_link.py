"""The dc link as machine code and in plain Python: the same bits; and its step against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.codegen.twins import twin
from tests.oracles.simplus_battery import C_DC, K_I_DC, K_P_DC, V_DC, step_of_power
from tests.simulation.studies import lcl_study
from vsgdesign.codegen.flat import flat_block
from vsgdesign.codegen.llvm import LoopSpec, compiled_loop, empty_rows
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.dc_link import (
    ActingVoltage,
    BridgePower,
    DcSettings,
    DcState,
    FilterSide,
    dc_step,
    link_step,
)
from vsgdesign.equations.dc_source_interface import DcRatings, decay_of
from vsgdesign.equations.dc_sources import DC_SOURCES
from vsgdesign.simulation.dc_parts import dc_kind

SECTIONS: dict[str, dict[str, Any]] = {
    "battery": {"R_i": "0.3 ohm", "i_max": 20, "capacity_Ah": 0.1},
    "converter": {"p_max": "4 kW", "p_charge_max": "2 kW", "ramp": 1e6},
    "photovoltaic": {"modules": 8, "strings": 3},
}
STEPS = 200


def link(source: str, **given: Any) -> Any:
    own = SECTIONS[source] | given
    study = lcl_study("40 ms").with_changes(dc={"source": source, "C": "300 uF", "R_bleed": "10 kohm", source: own})
    assert study.dc is not None
    return study, study.dc


@pytest.mark.parametrize("source", SECTIONS)
def test_a_strict_loop_has_the_bits_of_python(source: str) -> None:
    study, dc = link(source)
    kind = dc_kind(dc)
    assert kind is not None
    block = flat_block(dc_step, fixed={"source": kind.law}, kinds=kind.records)
    state = [name for name in block.inputs if name.startswith("state.")]
    fed = tuple(name for name in block.inputs if name.startswith(("x.", "after.", "v_b.", "asked.")))
    settings = tuple(name for name in block.inputs if name.startswith("dc."))
    pairs = tuple((name, name.replace("state.", "dc_state.", 1)) for name in state)
    spec = LoopSpec((block,), pairs, settings, fed=fed, logged=tuple(state), strict=True)
    constants, begin = dc.settings(study.converter, study.filter), dc.at_rest(1500.0, study.converter, study.filter)
    rows = empty_rows(spec, 1)
    rows[0, :, 0] = [*numbers_of(begin), *numbers_of(constants)]
    rng = np.random.default_rng(3)
    given = rng.uniform(-30.0, 30.0, (STEPS, len(fed)))
    log = np.zeros((1, STEPS, len(state), 1))
    compiled_loop(spec, quickly=True)(0, STEPS, rows, np.zeros(0), fed=given[None, :, :, None], log=log, every=1)
    run, law, now = twin(dc_step), twin(kind.law), begin
    for k, numbers in enumerate(given.tolist()):
        assert log[0, k, :, 0].tolist() == numbers_of(now)
        x, after = FilterSide(*numbers[:6]), FilterSide(*numbers[6:12])
        now = run(now, x, after, ActingVoltage(*numbers[12:14]), ActingVoltage(*numbers[14:]), constants, law)
    assert np.ptp(log[0, :, 0, 0]) > 0.01


def test_a_battery_of_any_resistance_is_moved_exactly() -> None:
    """No power is taken: the link follows its battery with the exponential of R C, however short that is."""
    for R in ("0.05 ohm", "0.5 ohm", "50 ohm"):
        study, dc = link("battery", R_i=R, capacity_Ah=1e5, i_max=1e5)
        settings = dc.settings(study.converter, study.filter)
        state = dc.at_rest(0.0, study.converter, study.filter)
        rest, ohms = state.v, dc.values["R_i"]
        state = state._replace(v=rest - 8.0)
        rate = (1.0 / ohms + 1e-4) / 300e-6
        for k in range(1, 6):
            state = link_step(state, BridgePower(0.0, 0.0, 0.0, 0.0), 0.0, settings, dc.kind.law)
            assert rest - state.v == pytest.approx(8.0 * math.exp(-rate * k * study.converter.T_s), abs=2e-9 * rest)


def test_the_numbers_of_a_decay() -> None:
    """Against Runge and Kutta's weights without a rate, and against each other where the two ways to them meet."""
    T = 1e-4
    plain = decay_of(0.0, T)
    assert [plain.half, plain.whole] == [1.0, 1.0]
    assert [plain.half_time, plain.first, plain.middle, plain.last] == pytest.approx([T / 2, T / 6, T / 3, T / 6])
    below, above = decay_of(0.9999999 / T, T), decay_of(1.0000001 / T, T)
    assert list(below) == pytest.approx(list(above), rel=1e-6)
    for z in (0.3, 3.0, 30.0):  # they move a constant exactly
        found = decay_of(z / T, T)
        assert found.first + 2.0 * found.middle + found.last == pytest.approx(-T * math.expm1(-z) / z, rel=1e-12)


def test_a_stage_stands_for_a_published_boost_converter() -> None:
    """The link of a unit of Simplus's battery plant after its power doubles, from the plant's parameters. A PI loop
    that holds the link's voltage is the stage that knows the bridge's power, with tau = C/K_p and k_p = V K_i tau. The
    boost converter has an inner current loop of 500 Hz besides, which the stage has not: 6 % of the largest dip."""
    T, steps = 5e-5, 4000
    plant = step_of_power(0.15, 0.15, np.arange(2 * steps + 1, dtype=np.float64) * 0.5 * T)
    ratings, source = DcRatings(T, V_DC, C_DC, math.inf, 1.0), DC_SOURCES["converter"]
    tau = C_DC / (plant.share * K_P_DC)
    values = source.values(
        ratings, {"p_max": 1.0, "tau": tau, "k_p": V_DC * plant.share * K_I_DC * tau, "p_charge_max": 1.0}
    )
    constants = source.build(ratings, values)
    settings = DcSettings(**dict.fromkeys(DcSettings._fields, 0.0) | {"T_s": T, "over_C": 1.0 / C_DC, "V_dc": V_DC})
    v, memory = source.rest(plant.p[0], ratings, constants, values)
    counted = dict.fromkeys(DcState._fields, 0.0) | {"v": v, "p": float(plant.p[0]), "memory": memory}
    state, settings = DcState(**counted), settings._replace(source=constants)
    found = []
    for begin, middle, end in zip(plant.p[:-2:2], plant.p[1:-1:2], plant.p[2::2], strict=True):
        found.append(state.v)
        power = BridgePower(begin, middle, end, (begin + 4.0 * middle + end) / 6.0)
        state = link_step(state, power, 0.0, settings, source.law)
    published = plant.v_dc[:-2:2]
    low, lowest = int(np.argmin(found)), int(np.argmin(published))
    assert 0.03 < T * lowest < 0.06
    assert T * low == pytest.approx(T * lowest, rel=0.05)
    dip = 1.0 - published[lowest]
    assert 1.0 - found[low] == pytest.approx(dip, rel=0.07)
    assert np.abs(np.array(found) - published).max() < 0.08 * dip
