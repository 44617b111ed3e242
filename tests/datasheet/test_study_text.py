"""The study that is written says what the datasheet says, and asks for nothing that its grids cannot carry."""

from __future__ import annotations

import itertools
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.datasheet.sheets import write_all
from tests.datasheet.test_resolving import of
from vsgdesign.equations.frames import phase_to_ll, rms_to_peak
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.errors import StudyError
from vsgdesign.estimator.recipes import WINDOW_RECIPES
from vsgdesign.study.datasheet import Datasheet, read_sheet, resolve, study_text
from vsgdesign.study.datasheet.study_text import middle, nodes
from vsgdesign.study.parameters import Study, study_from_text

UNTOLD = InnerLoopGains(*[math.nan] * 4), math.nan


def study_of(sheet: Datasheet) -> Study:
    return study_from_text(study_text(sheet, "a test"), inner_loops=lambda _: UNTOLD)


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> list[Datasheet]:
    folder: Path = tmp_path_factory.mktemp("sheets")
    return [resolve(read_sheet(path)) for path in write_all(folder).values()]


def test_the_study_holds_the_datasheet(sheets: list[Datasheet]) -> None:
    for sheet in sheets:
        study = study_of(sheet)
        c, f = study.converter, study.filter
        read = (c.S_rated, phase_to_ll(c.V_rated_rms), c.omega_n / (2.0 * math.pi), c.V_dc, c.f_sw, c.current_limit_pu)
        said = (sheet.S_rated, sheet.V_rated_ll_rms, sheet.f_n, sheet.V_dc, sheet.f_sw, sheet.current_limit_pu)
        assert read == pytest.approx(said, rel=1e-5)
        assert (c.samples_per_carrier, c.delay_samples) == (sheet.samples_per_carrier, sheet.delay_samples)
        assert c.zero_sequence is (sheet.modulation == "min_max")
        assert (f.L_1, f.R_1, f.C, f.R_c, f.L_2, f.R_2) == pytest.approx(
            (sheet.L_1, sheet.R_1, sheet.C, sheet.R_c, sheet.L_2, sheet.R_2), rel=1e-5
        )
        assert study.specification is not None
        assert (study.specification.scr[0], study.specification.scr[-1]) == pytest.approx(sheet.scr, rel=1e-5)
        assert study.controllers[0].schedule == "table"


@pytest.mark.parametrize(("least", "error_Z"), [(0.3, 0.08), (0.05, 0.02)])
def test_an_estimate_may_be_off_in_any_direction_and_keeps_an_inductance(least: float, error_Z: float) -> None:
    sheet = replace(of(), x_over_r=(least, 20.0))
    specification = study_of(sheet).specification
    assert specification is not None
    assert specification.box.errors == (0.2, 0.2, pytest.approx(error_Z))


def test_inner_loops_are_left_to_be_designed_for_these_grids(sheets: list[Datasheet]) -> None:
    requests = []
    for sheet in sheets:
        study_from_text(study_text(sheet, "a test"), inner_loops=lambda request: requests.append(request) or UNTOLD)
    assert [request.scr for request in requests] == [pytest.approx(sheet.scr, rel=1e-5) for sheet in sheets]
    assert [request.x_over_r for request in requests] == [sheet.x_over_r for sheet in sheets]


def test_every_assumption_stands_in_the_study(sheets: list[Datasheet]) -> None:
    for sheet in sheets:
        comments = " ".join(line.lstrip("# ") for line in study_text(sheet, "a test").splitlines() if line[:1] == "#")
        for assumption in sheet.assumptions:
            assert f"- {assumption.field}: {assumption.text}" in comments


def test_the_estimator_that_is_offered_is_one_that_the_reader_takes() -> None:
    """The commented lines, with the comment signs taken away."""
    text = study_text(of(), "a test")
    assert study_of(of()).estimator is None
    for line in ('estimate = "neural"', "[estimator]", 'recipe = "wide"', "grid_phase = true"):
        assert f"# {line}" in text
        text = text.replace(f"# {line}", line)
    study = study_from_text(text, inner_loops=lambda _: UNTOLD)
    assert study.estimator is not None
    assert study.controllers[0].estimate == "neural"
    low, high = WINDOW_RECIPES.load("wide").P_pu.values
    assert f"It learns P from {low:g} to {high:g} pu" in text
    assert study.simulation.P_ref < low * study.converter.S_rated


def states(study: Study) -> list[tuple[float, float, float, float]]:
    """R and X from the capacitor on, P and Q of every stretch between events."""
    found = []
    P, Q, grid = study.simulation.P_ref, study.simulation.Q_ref, study.grid
    for event in (None, *study.events):
        if event is not None:
            P = P if event.P_ref is None else event.P_ref
            Q = Q if event.Q_ref is None else event.Q_ref
            grid = grid if event.grid is None else event.grid
        found.append((study.filter.R_2 + grid.R_g, study.converter.omega_n * (study.filter.L_2 + grid.L_g), P, Q))
    return found


def random_sheets(count: int) -> list[Datasheet]:
    rng = np.random.default_rng(11)
    sheets = []
    for _ in range(count):
        low = float(np.exp(rng.uniform(np.log(0.5), np.log(8.0))))
        scr = (low, low * float(np.exp(rng.uniform(0.0, 3.0))))
        ratio = (float(np.exp(rng.uniform(np.log(0.1), np.log(2.0)))), float(rng.uniform(2.0, 30.0)))
        L_2 = float(rng.choice([0.0, 3e-4]))
        sheets.append(
            replace(of(), scr=scr, x_over_r=ratio, L_2=L_2, R_2=0.01 * L_2, f_n=float(rng.choice([50.0, 60.0])))
        )
    return sheets


def test_every_step_of_the_scenario_exists_on_its_grid(sheets: list[Datasheet]) -> None:
    """With V within its limits and the bridge's, and the current within the converter's: closed-form power flow."""
    for sheet in [*sheets, *random_sheets(200)]:
        study = study_of(sheet)
        c = study.converter
        low, high = c.V_limits_rms
        for R, X, P, Q in states(study):
            V, _ = operating_point(P, Q, study.grid_source.V_g_rms, R, X)
            assert low < V < high, (sheet.scr, P, Q, V)
            assert rms_to_peak(V) < c.v_max_pk
            assert math.hypot(P, Q) / (3.0 * V) < 0.8 * sheet.current_limit_pu * c.S_rated / (3.0 * c.V_rated_rms)


def test_texts_of_a_file_cannot_break_out_of_the_study() -> None:
    nasty = replace(of(), title='a "b" \\ ] \x07 [converter]', source="x'''\"\"\"", unused=("line\nS_rated = 1",))
    document = tomllib.loads(study_text(nasty, 'file"\n[evil]\nx = 1\n.csv'))
    assert document["study"]["title"] == nasty.title
    assert "evil" not in document
    assert document["converter"]["S_rated"] == "100 kVA"


@pytest.mark.parametrize("ends", [(1.5, 20.0), (0.3, 20.0), (5.0, 5.0), (2.0, 2.1), (0.5, 1000.0), (19.9, 20.0)])
def test_nodes_keep_the_ends_and_increase(ends: tuple[float, float]) -> None:
    found = nodes(ends)
    assert 2 <= len(found) <= 6
    assert all(a < b for a, b in itertools.pairwise(found))
    if ends[1] > 1.02 * ends[0]:
        assert (found[0], found[-1]) == ends
    else:
        assert found[0] < ends[0] <= ends[1] < found[-1]
    assert ends[0] <= middle(ends) <= ends[1]


def test_a_dc_side_in_the_study_is_that_of_the_datasheet() -> None:
    """Given and assumed; its rows without a power are not used; a fault names its row and its limits."""
    given = {"dc_power": "120 kW", "charge power": "60 kW", "C_dc": "3 mF", "usable energy": "40 kWh"}
    study = study_of(of(**given))
    assert study.dc is not None
    assert (study.dc.source, study.dc.control, study.dc.C) == ("converter", "power_clamp", 3e-3)
    values = study.dc.values
    assert [values[name] for name in ("p_max", "p_charge_max", "energy", "charge")] == [1.2e5, 6e4, 1.44e8, 0.5]
    sheet = of(dc_power="120 kW")
    study = study_of(sheet)
    assert study.dc is not None
    assert pytest.approx(0.02 * 100e3 / 750.0**2, rel=5e-3) == study.dc.C
    assert {"dc_charge_power", "dc_capacitor", "dc_energy", "dc source"} <= {one.field for one in sheet.assumptions}
    sheet = of(**{name: value for name, value in given.items() if name != "dc_power"})
    assert sheet.dc is None
    assert study_of(sheet).dc is None
    assert {"charge power", "C_dc", "usable energy"} <= set(sheet.unused)
    with pytest.raises(StudyError) as caught:
        of(**{"dc_power": "20 kW", "C_dc": "0 F", "usable energy": "nan kWh"})
    said = str(caught.value)
    assert "is 20 kW, 0.2 pu, and so outside 50 kW to 2 MW" in said
    assert 'dc_capacitor (C_dc) = "0 F"' in said
    assert 'dc_energy (usable energy) = "nan kWh"' in said
