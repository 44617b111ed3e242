"""The power flow of a study against a phasor circuit that is solved here, and what limits it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.cli.small_studies import call
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.design.study_design import FIELDS, PowerFlow, flow_axes, power_flow
from vsgdesign.study.parameters import Study, study_from_text

KESTREL = """
schema = 1
[study]
title = "Kestrel 50 kVA"
[converter]
S_rated = "50 kVA"
V_rated_ll_rms = "480 V"
f_n = "60 Hz"
V_dc = "800 V"
f_sw = "8 kHz"
samples_per_carrier = 2
delay_samples = 1
modulation = "min_max"
current_limit_pu = 1.2
current_limiter = "projection"
[filter]
kind = "LCL"
L_1 = "400 uH"
R_1 = "5.027 mohm"
C = "90 uF"
R_c = "0 ohm"
L_2 = "80 uH"
R_2 = "1.005 mohm"
[inner_loops]
K_pv = 0.3814733920571664
K_iv = 101.97174649528505
K_pc = 3.0182647601791377
K_ic = 113.58399791502754
current_feedforward = 0.5550284380139361
transient_resistance_pu = 0.03316199402213403
transient_reactance_pu = 0.03497280335651359
transient_corner = 10.385899934224254
current_prediction = 1.4019416550363464
[grid]
scr = 4.4
x_over_r = 2.4
[power_loops]
structure = "angle_damped"
tau_P = "5 ms"
tau_Q = "5 ms"
P_droop = "5 %"
Q_droop = "50 %"
P_design = "25 kW"
Q_design = "0 var"
[specification]
settling_time = "1.3 s"
P = ["-45 kW", "45 kW"]
Q = ["-20 kvar", "20 kvar"]
scr = [1.3, 3.5, 15]
x_over_r = [0.5, 1.8, 12]
[[controllers]]
name = "table"
kind = "scheduled"
schedule = "table"
[simulation]
duration = "1 s"
P_ref = "8 kW"
Q_ref = "0 var"
"""


@pytest.fixture(scope="module")
def study() -> Study:
    return study_from_text(KESTREL)


@pytest.fixture(scope="module")
def flow(study: Study) -> PowerFlow:
    return power_flow(study, study.controllers[0])


def phasors(scr: float, x_over_r: float, P: float, Q_ref: float) -> dict[str, float] | None:
    """The rest of the converter above in a circuit without sampling; None where there is none.

    The droop of Q is S/(50 % of V_n) on V at the capacitor, P is P_ref at the nominal frequency, and V is the largest
    with which the source has its voltage. There more angle must give more power: Q ≤ 3 V² X/|Z|².
    """
    S, V_n, w = 50e3, 480.0 / math.sqrt(3.0), 2.0 * math.pi * 60.0
    R_g = 480.0**2 / S / scr / math.hypot(1.0, x_over_r)
    Z = R_g + 1.005e-3 + 1j * (R_g * x_over_r + w * 80e-6)

    def current(V: float) -> complex:
        return complex(np.conj((P + 1j * (Q_ref + S / (0.5 * V_n) * (V_n - V))) / (3.0 * V)))

    def missing(V: float) -> float:
        return abs(V - Z * current(V)) - V_n

    tried = V_n * np.linspace(2.0, 0.3, 3401)
    first = next((k for k in range(3400) if missing(tried[k]) * missing(tried[k + 1]) <= 0.0), None)
    if first is None:
        return None
    V = brentq(missing, tried[first + 1], tried[first], xtol=1e-10)
    if Q_ref + S / (0.5 * V_n) * (V_n - V) > 3.0 * V * V * Z.imag / abs(Z) ** 2:
        return None
    i_s = current(V) + 1j * w * 90e-6 * V
    m = math.sqrt(2.0) * abs(V + (5.027e-3 + 1j * w * 400e-6) * i_s) / 400.0
    return {
        "P": P,
        "Q": Q_ref + S / (0.5 * V_n) * (V_n - V),
        "V_rms": V,
        "I_rms": abs(i_s),
        "modulation_index": m,
        "modulation_margin": 1.0 - m / (2.0 / math.sqrt(3.0)),
    }


def test_every_rest_is_that_of_a_phasor_circuit(flow: PowerFlow) -> None:
    """Sampling changes a rest by less than this; found: 0.03 var, 0.1 mV, 0.1 A of 60 A, 3e-5."""
    near = {"P": 1e-3, "Q": 0.1, "V_rms": 1e-3, "I_rms": 0.2, "modulation_index": 1e-4, "modulation_margin": 1e-4}
    count = 0
    for k in range(len(flow.limit)):
        place = (flow.scr[k], flow.x_over_r[k], flow.P_ref[k], flow.Q_ref[k])
        known = phasors(*place)
        assert (known is None) == bool(np.isnan(flow.V_rms[k])), place
        for name, value in (known or {}).items():
            assert getattr(flow, name)[k] == pytest.approx(value, abs=near[name]), (place, name)
        count += known is not None
    assert 60 < count < 81


def limit_at(flow: PowerFlow, *place: float) -> tuple[str, bool]:
    found = np.array([flow.scr, flow.x_over_r, flow.P_ref, flow.Q_ref]).T
    k = int(np.flatnonzero((found == place).all(axis=1))[0])
    return flow.limit[k], bool(flow.possible[k])


def test_what_limits_a_weak_grid(flow: PowerFlow) -> None:
    """On a resistive grid of SCR 1.3, 45 kW raise V until the bridge has no voltage left; nothing said so before."""
    assert limit_at(flow, 1.3, 0.5, 45e3, 0.0) == ("bridge voltage", False)
    known = phasors(1.3, 0.5, 45e3, 0.0)
    assert known is not None
    assert known["modulation_margin"] < 0.0
    assert limit_at(flow, 1.3, 12.0, -45e3, 0.0) == ("power transfer", False)
    assert limit_at(flow, 15.0, 0.5, 45e3, -20e3) == ("current", True)
    assert limit_at(flow, 3.5, 0.5, -45e3, -20e3)[1] is False


def test_the_limits_that_are_named_are_exceeded_and_no_others(study: Study, flow: PowerFlow) -> None:
    c = study.converter
    for k in np.flatnonzero(~np.isnan(flow.V_rms)):
        V, I_pk = flow.V_rms[k] / c.V_rated_rms, math.sqrt(2.0) * flow.I_rms[k]
        Z = c.Z_base / flow.scr[k]
        beyond = {
            "bridge voltage": flow.modulation_margin[k] < 0.005,
            "current": I_pk > 0.995 * 1.15 * c.I_rated_pk,  # the soft limit of this limiter
            "least voltage": c.V_min_pu > V,
            "largest voltage": c.V_max_pu < V,
            "power transfer": 3.0 * (V * c.V_rated_rms) ** 2 / Z < 1.29 * math.hypot(flow.P[k], flow.Q[k]),
        }
        if flow.possible[k]:
            assert not any(beyond.values()), (k, beyond)
            assert flow.used[k] <= 1.0
        else:
            assert beyond[flow.limit[k]] or flow.used[k] < 1.01, (k, flow.limit[k], beyond)


def test_a_table_that_is_not_there_has_the_same_power_flow(study: Study, flow: PowerFlow) -> None:
    """Its droops are known before its design."""
    made = table(
        base=base_of(study, "impedance"), scr=(1.0, 20.0), x_over_r=(0.4, 15.0), D_p=2652.58, D_q=360.84391824351604
    )
    found = power_flow(study, study.controllers[0], Ready(tables={"table": made}))
    there = ~np.isnan(found.V_rms) & ~np.isnan(flow.V_rms)
    assert there.sum() > 60
    for name in ("P", "Q", "V_rms", "I_rms", "used"):
        assert getattr(found, name)[there] == pytest.approx(getattr(flow, name)[there], rel=1e-9, abs=1e-6)


def test_axes_without_a_specification_are_those_of_the_maps() -> None:
    text = 'base = "case:lab_12kva_lcl"\nsimulation = { duration = "1 s", P_ref = "1 kW", Q_ref = "0 var" }\n'
    text += 'controllers = [{ name = "fixed", kind = "fixed" }]\n'
    study = study_from_text(
        text + 'stability = { scr = [2, 5], x_over_r = [3], P = ["1 kW", "2 kW"], Q = ["0 var"] }\n'
    )
    assert flow_axes(study)[1:] == ((2.0, 5.0), (3.0,), (1e3, 2e3), (0.0,))


def test_design_shows_and_writes_its_power_flow(tmp_path: Path) -> None:
    (tmp_path / "k.toml").write_text(KESTREL, encoding="utf-8")
    shown = call("design", tmp_path / "k.toml", "--out", tmp_path / "out")
    assert shown.exit_code == 0, shown.output
    assert "table rests within the static limits on" in shown.stdout
    assert "bridge voltage" in shown.stdout
    document = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    assert set(document["power_flow"][0]) == {"controller", "scr_basis", *FIELDS}
    rows = (tmp_path / "out" / "power_flow.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + 3 * 3 * 9
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert all(word in page for word in ("Margin of the modulation index", "power_flow.csv", "Nearest limit"))
