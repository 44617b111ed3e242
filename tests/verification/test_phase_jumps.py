"""The currents after phase jumps: against runs of their own, against the voltage across L_1, and in words."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc

import vsgdesign as vd
from tests.design.inner.designed import DESIGNED
from vsgdesign.campaigns import phase_jumps as campaign
from vsgdesign.campaigns.phase_jumps import (
    ANGLES_DEG,
    NEW_LOOPS,
    SCRS,
    Hardware,
    PhaseJumps,
    below_95,
    hardware_of,
    peaks_of,
    phase_jumps,
    remedied,
)
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.converter import phase_jump_blocks, phase_jump_text
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Grid

LITTLE_VOLTAGE = "studies/survival/laboratory.toml"
"""12.5 kVA with 1.24 pu of bridge voltage."""


@pytest.fixture(scope="module")
def own() -> Hardware:
    found = hardware_of(vd.load(LITTLE_VOLTAGE))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def told() -> PhaseJumps:
    found = phase_jumps(vd.load(LITTLE_VOLTAGE))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def megawatt() -> Hardware:
    """1 MVA with 1.28 pu of bridge voltage."""
    found = hardware_of(vd.load("studies/survival/utility.toml"))
    assert found is not None
    return found


def test_peaks_are_those_of_single_runs(megawatt: Hardware) -> None:
    """Grids and powers are computed here from the drawn numbers, and the peak is the largest of every sample."""
    own = megawatt
    found, c = peaks_of(own, [(60.0, 3.0)], each=2, seed=5), own.converter
    for k, (scr, ratio, P, Q) in enumerate(qmc.LatinHypercube(4, seed=5).random(2)):
        Z, x_over_r = c.Z_base / (3.0 * 1.1 ** (2.0 * scr - 1.0)), 2.0 * 10.0**ratio
        R = Z / math.hypot(1.0, x_over_r)
        of_run = replace(
            own.study.simulation,
            duration=0.5,
            P_ref=(2.0 * P - 1.0) * 0.9 * c.S_rated,
            Q_ref=(2.0 * Q - 1.0) * 0.3 * c.S_rated,
        )
        jump = Event(0.1, phase_jump=math.radians(60.0) * (1.0 if k % 2 else -1.0))
        alone = replace(own.study, grid=Grid(R, R * x_over_r / c.omega_n), simulation=of_run, events=(jump,))
        run = run_scenario(alone).controllers[0].simulation
        current = np.hypot(run.column("i_s_alpha"), run.column("i_s_beta")) / c.I_rated_pk
        assert found[k] == pytest.approx(current.max(), rel=1e-6)


def test_a_jump_stays_below_the_bound_by_hand(told: PhaseJumps, own: Hardware) -> None:
    """The voltage of the jump across L_1 for two sampling periods, in SI; EMT may be some per cent above."""
    c = own.converter
    assert [(one.angle_deg, one.scr) for one in told.peaks] == [(angle, scr) for angle in ANGLES_DEG for scr in SCRS]
    for one in told.peaks:
        volts = abs(np.exp(1j * math.radians(one.angle_deg)) - 1.0) * math.sqrt(2.0) * c.V_rated_rms
        rise = volts * (1 + c.delay_samples) * c.T_s / own.filter.L_1
        assert one.bound_pu == pytest.approx(told.limit_pu + rise / c.I_rated_pk, rel=1e-12)
        assert one.runs > 0
        assert one.p95_pu is not None
        assert one.largest_pu is not None
        assert told.limit_pu * 0.99 < one.p95_pu <= one.largest_pu < 1.06 * one.bound_pu


def test_the_missing_voltage_is_found(told: PhaseJumps) -> None:
    """With more dc voltage the peak disappears; an inductance on the grid side does not help."""
    assert told.warned is not None
    assert told.warned.p95_pu is not None
    assert told.all_voltage_pu is not None
    assert told.V_max_pu == pytest.approx(1.2374, abs=1e-4)  # 700 V/√3 beside √2 · 230.9 V
    helps = {remedy.change: remedy.helps for remedy in told.remedies}
    assert helps["20 % more dc voltage"]
    assert helps["half the capacitor"]
    assert not helps["0.05 pu more of grid-side reactance"]
    assert told.all_voltage_pu < 1.1 * told.limit_pu < told.warned.p95_pu


def test_words_and_table(told: PhaseJumps) -> None:
    document = told.document()
    text = phase_jump_text(document)
    assert text[0].startswith("A phase jump of 60° at SCR 3 makes a current of up to 1.3")
    assert "the missing voltage makes 0.09" in text[1]
    assert text[2].startswith("What helps, with inner loops designed for it: half the capacitor (1.2")
    assert text[3].startswith("Little is gained, or no more, with inner loops designed for it, by: a new design of")
    one = told.remedies[1]
    untold = replace(one, change="a", told=False, p95_pu=None, helps=False)
    slow, diverging = (replace(one, change="b", score=0.774), replace(untold, change="c", told=True, p95_pu=math.inf))
    more = phase_jump_text(replace(told, remedies=(untold, slow, replace(diverging, score=1.2))).document())[2:]
    assert more[0].endswith(" pu, with a score of the inner loops of 0.774).")
    assert more[1].endswith(", by: c (more than 5 % diverge).")
    assert more[2].startswith("Nothing is told of: a. A short search finds no inner loops that keep all that is asked")
    table = next(block for block in phase_jump_blocks(document) if isinstance(block, Table))
    assert [row[0] for row in table.rows] == ["20°", "30°", "60°", "90°"]
    assert {len(row) for row in table.rows} == {len(table.head)}


def test_where_no_inner_loops_keep_what_is_asked_only_currents_near_the_limit_are_told(
    own: Hardware, told: PhaseJumps, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every search is made to end with the present gains and a score of a half."""
    monkeypatch.setattr(campaign, "designed_again", lambda one, full: (one.gains, one.omega_t, 0.5 + full))
    found = phase_jumps(vd.load(LITTLE_VOLTAGE))
    assert found is not None
    assert found.peaks == told.peaks
    for remedy, (_, scaled) in zip(found.remedies, remedied(own), strict=True):
        peak = below_95(peaks_of(scaled, [(60.0, 3.0)]))
        assert peak is not None
        assert remedy.told == (peak <= 1.1 * 1.2)
        assert remedy.p95_pu == (peak if remedy.told else None)
    assert {remedy.told for remedy in found.remedies} == {True, False}


def test_a_limited_current_leaves_the_bridge_its_voltage(megawatt: Hardware) -> None:
    """With a reference that the bridge cannot hold the peak was 1.62 pu."""
    peak = below_95(peaks_of(megawatt, [(60.0, 3.0)], 80))
    assert peak is not None
    assert peak < 1.4


def test_other_hardware_is_told_with_inner_loops_designed_for_it() -> None:
    """The oracle are the stored gains of a full search for this converter. The study's own loops are slower: a new
    design lowers the peak by itself, and other hardware helps only if it does more."""
    study = vd.load("studies/published/study.toml")
    found, own = phase_jumps(study), hardware_of(study)
    assert found is not None
    assert own is not None
    assert found.warned is not None
    gains, omega_t, _ = DESIGNED["hoang2025_5kva"]
    designed = own._replace(gains=gains, omega_t=omega_t)
    full = below_95(peaks_of(designed, [(found.warned.angle_deg, found.warned.scr)]))
    new, *others = found.remedies
    assert new.p95_pu is not None
    assert (new.change, new.told, new.helps) == (NEW_LOOPS, True, True)
    assert new.p95_pu == pytest.approx(full, rel=0.07)
    assert found.warned.p95_pu is not None
    assert found.warned.p95_pu > 1.1 * new.p95_pu
    for other in others:
        assert other.score >= 1.0
        assert other.p95_pu is not None
        assert other.p95_pu < 0.97 * found.warned.p95_pu
        assert other.helps == (other.p95_pu < 0.97 * new.p95_pu)


def test_without_a_limit_nothing_is_told() -> None:
    study: Study = vd.load("studies/structures/study.toml")
    without = replace(
        study,
        converter=replace(study.converter, current_limit_pu=None),
        controllers=tuple(replace(spec, current_limit_pu=None) for spec in study.controllers),
    )
    assert phase_jumps(without) is None
    assert phase_jump_blocks(None) == []
