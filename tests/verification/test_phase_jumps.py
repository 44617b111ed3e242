"""The currents after phase jumps: against runs of their own, against the voltage across L_1, and in words."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc

import vsgdesign as vd
from tests.design.inner.designed import DESIGNED
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
)
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.phase_jumps import phase_jump_blocks, phase_jump_text
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Grid

LITTLE_VOLTAGE = "studies/survival/utility.toml"
"""1 MVA with 1.28 pu of bridge voltage."""


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


def test_peaks_are_those_of_single_runs(own: Hardware) -> None:
    """Grids and powers are computed here from the drawn numbers, and the peak is the largest of every sample."""
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
    """With more dc voltage the peak disappears. At this sampling rate no inner loops keep all that is asked of them, so
    that nothing is told of other filters."""
    assert told.warned is not None
    assert told.warned.p95_pu is not None
    assert told.all_voltage_pu is not None
    assert told.V_max_pu == pytest.approx(1.281, abs=1e-3)  # 1,250 V/√3 beside √2 · 398.4 V
    assert [remedy.change for remedy in told.remedies if remedy.helps] == ["20 % more dc voltage"]
    for remedy in told.remedies:
        assert remedy.score < 1.0
        assert remedy.told == remedy.helps == (remedy.p95_pu is not None)
    assert told.all_voltage_pu < 1.1 * told.limit_pu < told.warned.p95_pu


def test_words_and_table(told: PhaseJumps) -> None:
    document = told.document()
    text = phase_jump_text(document)
    assert text[0].startswith("A phase jump of 60° at SCR 3 makes a current of up to 1.6")
    assert "the missing voltage makes 0.39" in text[1]
    assert text[2].startswith("What helps, with inner loops designed for it: 20 % more dc voltage (1.2")
    assert text[2].endswith(" pu, with a score of the inner loops of 0.774).")
    assert text[3].startswith("Nothing is told of: a new design of the inner loops alone; half the capacitor; twice")
    diverging = replace(told.remedies[1], told=True, p95_pu=math.inf, score=1.2)
    fully = phase_jump_text(replace(told, remedies=(told.remedies[2], diverging)).document())
    (said,) = fully[3:]
    assert said.startswith("Little is gained, or no more, with inner loops designed for it, by: half the capacitor (")
    assert said.endswith("(more than 5 % diverge).")
    table = next(block for block in phase_jump_blocks(document) if isinstance(block, Table))
    assert [row[0] for row in table.rows] == ["20°", "30°", "60°", "90°"]
    assert {len(row) for row in table.rows} == {len(table.head)}


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
