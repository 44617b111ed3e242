"""Random cases: their distribution, their independence of blocks, and what the converter is asked to carry."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from tests import gain_tables
from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.verification.draws import (
    FAMILIES,
    UNIFORMS,
    cases_of,
    draw_cases,
    uniforms_of,
    verification_of,
)
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.linear.operating_point.many_rests import rest_with_measured_gains
from vsgdesign.linear.operating_point.sampled import SampledState
from vsgdesign.metrics.survival import REST_SHARE
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.survival.cases import LEAD_S, LEARNING_S
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.grid import Grid, GridSource, Load, Network
from vsgdesign.study.parameters.study import Study

LIMITED = """
[converter]
current_limit_pu = 1.2
current_limiter = "projection"
[power_loops]
structure = "angle_damped"
[verification.ramp]
weight = 1
[verification.reference]
weight = 1
[specification]
scr_basis = "impedance"
scr = [1.5, 20]
x_over_r = [0.5, 10]
P = ["-4.5 kW", "4.5 kW"]
Q = ["-1.5 kvar", "1.5 kvar"]
error = "20 %"
error_Z = "8 %"
V_g_pu = [0.95, 1.05]
f_g = ["49.8 Hz", "50.2 Hz"]
"""


def study(more: str = LIMITED, case: str = "hoang2025_5kva", controller: str = 'kind = "scheduled"') -> Study:
    return study_from_text(f"""
base = "case:{case}"
simulation = {{ duration = "1 s", P_ref = "2 kW", Q_ref = "0 var" }}
controllers = [{{ name = "a", {controller} }}]
{more}
""")


def drawn(one: Study, count: int, first: int = 0) -> tuple[LaneCases, np.ndarray]:
    return draw_cases(one, one.controllers[0], first, count)


def same(a: LaneCases, b: LaneCases) -> None:
    for part, other in ((a, b), (a.events, b.events)):
        for f in fields(part):
            if f.name != "events":
                np.testing.assert_array_equal(getattr(part, f.name), getattr(other, f.name), err_msg=f.name)


@pytest.mark.parametrize("structure", ["published", "decoupled", "angle_damped"])
def test_a_case_is_the_same_to_the_bit_in_any_block(structure: str) -> None:
    one = study(LIMITED.replace("angle_damped", structure))
    whole, families = drawn(one, 400)
    for first, count in ((0, 1), (1, 2), (13, 7), (100, 131), (399, 1)):
        part, kinds = drawn(one, count, first)
        same(part, whole.take(np.arange(first, first + count)))
        np.testing.assert_array_equal(kinds, families[first : first + count])


def test_the_seed_decides_and_families_have_their_weights() -> None:
    one = study()
    cases, families = drawn(one, 6000)
    other, _ = drawn(study(LIMITED.replace("[verification.ramp]", "[verification]\nseed = 2\n[verification.ramp]")), 10)
    assert not np.isin(other.R_g, cases.R_g).any()
    # Each of the six has 1000 ± 29 (one standard deviation).
    assert np.abs(np.bincount(families, minlength=len(FAMILIES)) - 1000).max() < 120


def test_grids_are_uniform_in_the_logarithm_and_sources_uniform() -> None:
    one = study()
    cases, _ = cases_of(one, one.controllers[0], uniforms_of(2, 0, 4000))
    c = one.converter
    scr = c.Z_base / np.hypot(cases.R_g, c.omega_n * cases.L_g)
    ratio = c.omega_n * cases.L_g / cases.R_g
    for values, low, high in (
        (np.log(scr), np.log(1.5), np.log(20.0)),
        (np.log(ratio), np.log(0.5), np.log(10.0)),
        (cases.V_g_rms, 0.95 * 110.0, 1.05 * 110.0),
        (cases.omega_g, 99.6 * np.pi, 100.4 * np.pi),
        (cases.events.t_s[:, 0], LEAD_S, LEAD_S + 0.02),
    ):
        at = np.sort((values - low) / (high - low))
        assert at[0] >= -1e-12
        assert at[-1] <= 1.0 + 1e-12
        # Kolmogorov and Smirnov: 1.95/√n is exceeded with a probability of 0.1 %.
        assert np.abs(at - (np.arange(4000) + 0.5) / 4000).max() < 1.95 / np.sqrt(4000)


def test_estimates_lie_in_the_error_set() -> None:
    one = study()
    cases, _ = drawn(one, 2000)
    R, X = cases.R_g, one.converter.omega_n * cases.L_g
    least = 0.08 * np.hypot(R, X)
    for errors, part in ((cases.error_R, R), (cases.error_X, X)):
        share = errors * part / np.maximum(0.2 * part, least)
        assert np.abs(share).max() <= 1.0 + 1e-12
        assert np.abs(share).max() > 0.99
        assert abs(share.mean()) < 0.06
    assert cases.error_R.min() >= -1.0


def rest(one: Study, cases: LaneCases, k: int) -> SampledState:
    """The steady state before the disturbance, by the solver of single runs and without a current limit."""
    law = gain_law(one, one.controllers[0])
    free = replace(one, converter=replace(one.converter, current_limit_pu=None))
    grid = Grid(float(cases.R_g[k]), float(cases.L_g[k]))
    source = GridSource(float(cases.V_g_rms[k]), float(cases.omega_g[k]))
    known = grid.R_g * (1.0 + cases.error_R[k]), grid.L_g * (1.0 + cases.error_X[k])

    def gains_of(P: float, Q: float, V_rms: float) -> PowerLoopGains:
        return PowerLoopGains(*(float(gain) for gain in law(*known, P, Q, V_rms)))

    refs = one.converter.references(float(cases.P_ref[k]), float(cases.Q_ref[k]))
    return rest_with_measured_gains(free, grid, source, refs, gains_of)[0]


def test_cases_begin_at_powers_of_the_box_within_the_limits() -> None:
    """The references lie beside the box, because the droops answer to voltage and frequency; the rests do not."""
    one = study()
    cases, _ = drawn(one, 60)
    beside = 0
    for k in range(60):
        at = rest(one, cases, k)
        assert abs(at.controller.P_f) <= 4500.0 * (1.0 + 1e-6)
        assert abs(at.controller.Q_f) <= 1500.0 * (1.0 + 1e-6)
        i_s_pu = float(np.hypot(*at.plant[:2])) / one.converter.I_rated_pk
        # The sampled bridge's rest is that of the power flow but for its half sample of delay in the filter.
        assert i_s_pu <= REST_SHARE * 1.2 * (1.0 + 1e-3)
        beside += abs(cases.Q_ref[k]) > 1500.0
    assert beside > 10


def test_reduced_powers_are_on_a_limit_and_all_others_as_drawn() -> None:
    """Without droop of V and at nominal frequency the references are the powers themselves."""
    nominal = LIMITED.replace("V_g_pu = [0.95, 1.05]", "").replace('f_g = ["49.8 Hz", "50.2 Hz"]', "")
    one = study(nominal.replace('"angle_damped"', '"angle_damped"\nQ_droop = 0'))
    u = uniforms_of(5, 0, 800)
    cases, _ = cases_of(one, one.controllers[0], u, FAMILIES.index("phase"))
    P, Q = -4500.0 + 9000.0 * u[:, 3], -1500.0 + 3000.0 * u[:, 4]
    share = cases.P_ref / P
    np.testing.assert_allclose(cases.Q_ref / Q, share, rtol=1e-9)
    assert share.max() <= 1.0 + 1e-12
    reduced = share < 1.0 - 1e-9
    assert 20 < reduced.sum() < 400
    Z_pu = np.hypot(cases.R_g, one.converter.omega_n * cases.L_g) / one.converter.Z_base
    V = voltage(cases, cases.P_ref, cases.Q_ref)
    uses = np.array(
        [
            1.3 * np.hypot(cases.P_ref, cases.Q_ref) / one.converter.S_rated * Z_pu / (V / 110.0) ** 2,
            0.85 * 110.0 / V,
            V / (1.25 * 110.0),
            current(one, V, cases.P_ref, cases.Q_ref) / (REST_SHARE * 1.2 * one.converter.I_rated_pk),
        ]
    ).max(axis=0)
    assert uses.max() < 1.0 + 1e-6
    np.testing.assert_allclose(uses[reduced], 1.0, atol=1e-5)


def voltage(cases: LaneCases, P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """V of the power flow by iteration, independent of its closed form: V = |V_g + Z (P − jQ)/(3 V*)|, V real."""
    Z = cases.R_g + 1j * cases.omega_g * cases.L_g
    V = cases.V_g_rms.astype(complex)
    for _ in range(200):
        V = cases.V_g_rms + Z * np.conj((P + 1j * Q) / (3.0 * V))
    return np.abs(V)


def current(one: Study, V: np.ndarray, P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Peak current of the bridge: that into the grid with the capacitor's, whose resistance is zero here."""
    assert one.filter.R_c == 0.0
    return rms_to_peak(np.abs((P - 1j * Q) / (3.0 * V) + 1j * one.converter.omega_n * one.filter.C * V))


def test_steps_keep_their_size_and_stay_in_the_box() -> None:
    nominal = LIMITED.replace("V_g_pu = [0.95, 1.05]", "").replace('f_g = ["49.8 Hz", "50.2 Hz"]', "")
    one = study(nominal.replace('"angle_damped"', '"angle_damped"\nQ_droop = 0'))
    cases, _ = cases_of(one, one.controllers[0], uniforms_of(1, 0, 1000), FAMILIES.index("step"))
    dP, dQ = cases.events.P_ref[:, 0] - cases.P_ref, cases.events.Q_ref[:, 0] - cases.Q_ref
    np.testing.assert_allclose(np.abs(np.where(cases.signal == 0, dP, dQ)), 250.0, rtol=1e-9)
    assert (np.isnan(dP) != np.isnan(dQ)).all()
    assert 400 < (cases.signal == 0).sum() < 600
    assert np.nanmax(np.abs(cases.events.P_ref[:, 0])) <= 4500.0 * (1.0 + 1e-9)
    assert np.nanmax(np.abs(cases.events.Q_ref[:, 0])) <= 1500.0 * (1.0 + 1e-9)
    assert (cases.silent_s == 0.0).all()
    assert (cases.kind == 0).all()


def test_each_family_has_its_events() -> None:
    one = study()
    u = uniforms_of(3, 0, 300)
    spec = one.controllers[0]
    found = {name: cases_of(one, spec, u, k)[0] for k, name in enumerate(FAMILIES)}
    sag = found["sag"].events
    depth = 1.0 - sag.V_g_rms[:, 0] / found["sag"].V_g_rms
    assert 0.2 - 1e-12 <= depth.min() < 0.25 < 0.95 < depth.max() <= 1.0
    np.testing.assert_array_equal(sag.V_g_rms[:, 1], found["sag"].V_g_rms)
    np.testing.assert_array_equal(sag.phase_jump.sum(axis=1), 0.0)
    assert np.degrees(np.abs(sag.phase_jump)).max() <= 60.0 + 1e-9
    length = sag.t_s[:, 1] - sag.t_s[:, 0]
    assert 0.05 - 1e-9 < length.min() < 0.06 < 0.9 < length.max() < 1.0 + 1e-9
    np.testing.assert_array_equal(found["sag"].cleared_s, sag.t_s[:, 1])
    ramp = found["ramp"].events
    rate = np.abs(ramp.omega_g[:, 0] - found["ramp"].omega_g) / (2.0 * np.pi * ramp.over[:, 0])
    assert 0.5 - 1e-9 < rate.min() < 0.6 < 3.5 < rate.max() < 4.0 + 1e-9
    assert (ramp.t_s[:, 1] >= ramp.t_s[:, 0] + ramp.over[:, 0]).all()
    np.testing.assert_allclose(found["ramp"].cleared_s, ramp.t_s[:, 1] + ramp.over[:, 1], rtol=1e-12)
    jump = found["grid"].events
    assert np.isfinite(jump.R_g[:, 0]).all()
    assert np.degrees(np.abs(jump.phase_jump[:, 0])).max() <= 30.0 + 1e-9
    assert (np.abs(found["reference"].events.P_ref[:, 0]) < 2.0 * one.converter.S_rated).all()
    silent = found["phase"].silent_s
    assert 0.02 - 1e-12 < silent.min() < 0.025 < 0.9 < silent.max() < 1.0 + 1e-12


def test_a_fixed_controller_and_an_estimator_are_told_nothing() -> None:
    for controller in ('kind = "fixed"', 'kind = "scheduled", estimate = "field"'):
        cases, _ = drawn(study(controller=controller), 50)
        assert not np.any([cases.error_R, cases.error_X, cases.silent_s])
        # A field estimator needs time to learn its grid first.
        assert cases.events.t_s[:, 0].min() >= (LEARNING_S if "field" in controller else LEAD_S)


def test_another_rating_and_filter_and_no_limit() -> None:
    one = study("", "utility_1mva_60hz")
    cases, families = drawn(one, 500)
    assert set(families) == {FAMILIES.index("step"), FAMILIES.index("grid")}
    assert np.isfinite([cases.P_ref, cases.Q_ref]).all()
    assert (cases.events.phase_jump == 0.0).all()
    assert 0.7e6 < np.abs(cases.P_ref).max() <= 0.9e6


def test_a_table_is_tested_within_its_validity() -> None:
    controller = 'kind = "scheduled", schedule = "table", table = "t.json"'
    one = study('[verification]\nP = ["-1 kW", "1 kW"]\n', controller=controller)
    table = gain_tables.table()
    box = verification_of(one, one.controllers[0], Ready(tables={"a": table})).box
    assert (box.scr, box.x_over_r, box.Q) == (table.validity.scr, table.validity.x_over_r, table.validity.Q)
    assert box.P == (-1e3, 1e3)
    assert box.errors == (0.2, 0.2, 0.0)
    robust = gain_tables.table(validity=replace(table.validity, error_Z=0.05))
    assert verification_of(one, one.controllers[0], Ready(tables={"a": robust})).box.errors == (0.2, 0.2, 0.05)
    asked = study("[verification]\nerror_R = 0.3\nerror_X = 0.1\n", controller=controller)
    with pytest.raises(
        StudyError, match=r"verification\.error_R = 0\.3: is more than the table .* made for, 0\.2"
    ) as said:
        verification_of(asked, asked.controllers[0], Ready(tables={"a": robust}))
    assert "error_X" not in str(said.value)
    wide = study('[verification]\nscr = [0.1, 100]\nscr_basis = "impedance"\n', controller=controller)
    with pytest.raises(StudyError, match=r"verification\.scr = 0\.1 to 100: is not within the validity of the table"):
        verification_of(wide, wide.controllers[0], Ready(tables={"a": table}))


def test_nothing_to_draw_is_an_error() -> None:
    one = study("[verification.step]\nweight = 0\n[verification.grid]\nweight = 0\n")
    with pytest.raises(StudyError, match="no family has a weight above zero"):
        drawn(one, 10)


def test_numbers_of_a_case() -> None:
    assert uniforms_of(1, 7, 3).shape == (3, UNIFORMS)
    np.testing.assert_array_equal(uniforms_of(1, 7, 3), uniforms_of(1, 0, 10)[7:])


def test_a_verification_draws_grids_alone() -> None:
    loaded = replace(study(), network=Network(load=Load(R_parallel=20.0)))
    with pytest.raises(InfeasibleStudyError, match=r"a verification has nothing but a grid: leave \[network\] out"):
        cases_of(loaded, loaded.controllers[0], uniforms_of(1, 0, 2))
