"""The whole controller as a strict loop of eight lanes: bit for bit what Python makes of the same functions."""

from __future__ import annotations

import math
import typing
from typing import Any

import numpy as np
import pytest

from tests.codegen.twins import twin
from vsgdesign.codegen.llvm import LoopSpec, compiled_loop, empty_rows, flat_block
from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_step
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiter_interface import LimiterRatings
from vsgdesign.equations.limiters import LIMITERS, GridEstimate, Limiter
from vsgdesign.equations.power_loops import PowerLoopGains, References

LANES, SAMPLES = 8, 200
OMEGA, T_S, V_PK, I_PK = 314.0, 1e-4, 155.0, 20.0
S = 1.5 * V_PK * I_PK
INNER = InnerLoopGains(K_pv=0.05, K_iv=20.0, K_pc=15.0, K_ic=2e3, K_ff=0.9, R_t=0.4, X_t=0.3, kappa=0.5)


def settings(limiter: Limiter) -> ControllerSettings:
    ratings = LimiterRatings(
        T_s=T_S, V_rated_pk=V_PK, I_rated_pk=I_PK, i_max_pk=1.2 * I_PK, Z_base=V_PK / I_PK, omega_0=OMEGA, R_2=0.05,
        L_2=1e-3, V_low_pu=0.85, V_high_pu=1.25,
    )  # fmt: skip
    return ControllerSettings(
        T_s=T_S, smoothing_P=0.02, smoothing_Q=0.03, omega_C=0.01, omega_L=0.6, i_max_pk=1.2 * I_PK, v_max_pk=250.0,
        advance_cos=math.cos(1.5 * OMEGA * T_S), advance_sin=math.sin(1.5 * OMEGA * T_S), smoothing_t=0.05,
        half_cos=math.cos(0.5 * OMEGA * T_S), half_sin=math.sin(0.5 * OMEGA * T_S), T_over_L=0.05, notch_gain=0.05,
        notch_step=1e-3, notch_back=0.05, limiter=limiter.constants(ratings),
    )  # fmt: skip


def leaves(value: Any, path: str) -> dict[str, float]:
    """Numbers of a NamedTuple by the names that a block gives to them."""
    if not isinstance(value, tuple):
        return {path: value}
    found: dict[str, float] = {}
    for name, item in zip(value._fields, value, strict=True):  # type: ignore[attr-defined]
        found |= leaves(item, f"{path}.{name}")
    return found


def start(limiter: Limiter, lane: int) -> ControllerState:
    memory = typing.get_type_hints(limiter.at_rest)["return"]
    remembered = memory(*(1.0 + 0.1 * lane + at for at in range(len(memory._fields))))
    return ControllerState(
        theta=0.1 * lane, omega_i=OMEGA, V=V_PK / math.sqrt(2.0), P_f=0.1 * S, Q_f=0.0, xi_vd=0.0, xi_vq=0.0, xi_id=0.0,
        xi_iq=0.0, limiter=remembered,
    )  # fmt: skip


def measured() -> np.ndarray:
    """(SAMPLES, fields of Measurement, LANES): turning vectors with disturbances, now and then far above the limit."""
    rng, rows = np.random.default_rng(7), []
    for k in range(SAMPLES):
        angle = OMEGA * T_S * k + 0.1 * np.arange(LANES) + rng.uniform(-0.3, 0.3, LANES)
        size = rng.choice([0.3, 1.0, 2.5], LANES)
        v, i_s, i_g = (
            scale * np.array([np.cos(angle), np.sin(angle)]) for scale in (V_PK, size * I_PK, 0.9 * size * I_PK)
        )
        rows.append(np.concatenate([v, i_s, i_g]) + rng.normal(0.0, 1.0, (6, LANES)))
    return np.array(rows)


@pytest.mark.parametrize("name", LIMITERS)
def test_controller_has_the_bits_of_python(name: str) -> None:
    limiter = LIMITERS[name]
    constants = settings(limiter)
    states = [start(limiter, lane) for lane in range(LANES)]
    grids = [GridEstimate(0.1 + 0.05 * lane, 1e-3 + 1e-3 * lane) for lane in range(LANES)]
    refs = [References(0.2 * S * (1 + lane / 8), 0.1 * S, OMEGA, V_PK / math.sqrt(2.0)) for lane in range(LANES)]
    gains = [
        PowerLoopGains(20.0 / S, 0.3 * S, 60.0 / S, 0.01 * S * (1 + lane / 8), 1.0 / S, 5.0 / S, 3.0 / S, -1.0 / S)
        for lane in range(LANES)
    ]
    kinds: dict[Any, dict[str, Any]] = {
        ControllerState: {"limiter": type(states[0].limiter)}, ControllerSettings: {"limiter": type(constants.limiter)}
    }  # fmt: skip
    block = flat_block(controller_step, fixed={"limiter": limiter.law}, kinds=kinds)
    lane_rows = [
        leaves(GridEstimate(*g), "grid") | leaves(r, "refs") | leaves(k, "power_gains")
        for g, r, k in zip(grids, refs, gains, strict=True)
    ]
    shared = leaves(INNER, "inner_gains") | leaves(constants, "settings")
    moving = [leaves(state, "state") for state in states]
    pairs = tuple((path, path.replace("state", "following", 1)) for path in moving[0])
    spec = LoopSpec(
        (block,), pairs, constant=tuple(lane_rows[0]), uniform=tuple(shared),
        fed=tuple(f"measured.{field}" for field in Measurement._fields),
        logged=("output.v_b_alpha", "output.limited", "state.theta"), lanes=8, strict=True,
    )  # fmt: skip
    rows = empty_rows(spec, 1)
    for lane in range(LANES):
        rows[0, :, lane] = [*moving[lane].values(), *lane_rows[lane].values()]
    fed, log = measured(), np.zeros((1, SAMPLES, 3, LANES))
    done = compiled_loop(spec)(0, SAMPLES, rows, np.array([*shared.values()]), fed=fed[None], log=log, every=1)
    assert done == SAMPLES
    run, law = twin(controller_step), twin(limiter.law)
    limited = 0.0
    for lane in range(LANES):
        state = states[lane]
        for k in range(SAMPLES):
            measurement = Measurement(*fed[k, :, lane].tolist())
            before = state
            state, output = run(state, measurement, grids[lane], refs[lane], gains[lane], INNER, constants, law)
            assert log[0, k, :, lane].tolist() == [output.v_b_alpha, float(output.limited), before.theta]
            limited += float(output.limited)
        assert rows[0, : len(pairs), lane].tolist() == [*leaves(state, "state").values()]
    assert 100 < limited < LANES * SAMPLES - 100, "The limiter acts in some of the samples."
