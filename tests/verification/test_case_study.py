"""A drawn case as a study file: the same numbers to the bit, and a run that is that of the case."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests import gain_tables
from vsgdesign.artifacts.gain_table_file import write_table_file
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.campaigns.verification.draws import FAMILIES, cases_of, uniforms_of
from vsgdesign.campaigns.verification.emt import case_study
from vsgdesign.errors import StudyError
from vsgdesign.metrics.events import MEASURED
from vsgdesign.metrics.survival import SURVIVED
from vsgdesign.report.scenario.verdict import survival_text
from vsgdesign.report.scenario.verdict import verdict as verdict_text
from vsgdesign.simulation.lanes.results import JUDGED
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.given_files import toml_text
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.grid import GridEstimate
from vsgdesign.study.parameters.loading import load_study

UTILITY = Path(__file__).resolve().parents[2] / "studies" / "survival" / "utility.toml"

TEXT = """
base = "case:hoang2025_5kva"
[converter]
current_limit_pu = 1.2
current_limiter = "projection"
[grid]
scr_basis = "impedance"
scr = 5
x_over_r = 3
[power_loops]
structure = "angle_damped"
settling_time = "0.3 s"
[simulation]
duration = "1 s"
P_ref = "2 kW"
Q_ref = "0 var"
[background]
[specification]
scr = [1.5, 20]
x_over_r = [0.5, 10]
P = ["-4 kW", "4 kW"]
Q = ["-1 kvar", "1 kvar"]
error = "20 %"
f_g = ["49.9 Hz", "50.1 Hz"]
V_g_pu = [0.97, 1.03]
[[controllers]]
name = "other"
kind = "fixed"
[[controllers]]
name = "one"
kind = "scheduled"
"""


def of(family: str, k: int, study: Study, spec: int = 1, **options: object) -> tuple[Study, str]:
    cases, _ = cases_of(study, study.controllers[spec], uniforms_of(1, k, 1), FAMILIES.index(family))
    return case_study(study, study.controllers[spec], cases, 0, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("family", FAMILIES)
def test_every_number_is_read_to_the_bit_of_what_was_drawn(family: str) -> None:
    study = study_from_text(TEXT)
    spec = study.controllers[1]
    cases, _ = cases_of(study, spec, uniforms_of(1, 7, 1), FAMILIES.index(family))
    found, text = case_study(study, spec, cases, 0, title="A case")
    assert replace(study_from_text(text), origin=None, hash="", files=()) == replace(found, origin=None, hash="")
    assert (found.grid.R_g, found.grid.L_g) == (cases.R_g[0], cases.L_g[0])
    assert (found.simulation.P_ref, found.simulation.Q_ref) == (cases.P_ref[0], cases.Q_ref[0])
    # A closed form is designed for the source of the study and does not know that of the case.
    assert found.grid_source == study.grid_source
    begun = found.events[0]
    assert (begun.t_s, begun.grid, begun.P_ref) == (0.0, None, None)
    assert begun.V_g_rms == pytest.approx(cases.V_g_rms[0], rel=1e-15)
    assert begun.omega_g == pytest.approx(cases.omega_g[0], rel=1e-15)
    told = GridEstimate(cases.error_R[0], cases.error_X[0], cases.silent_s[0])
    assert [one.knowledge for one in found.controllers] == [told]
    assert found.background is not None  # that of the case, not that of the study
    assert found.background.seed == cases.around.backgrounds[0].seed  # type: ignore[index]
    assert found.simulation.log_interval == found.converter.T_s
    e = cases.events
    used = np.isfinite(e.t_s[0])
    assert [event.t_s for event in found.events[1:]] == e.t_s[0][used].tolist()
    for j, event in enumerate(found.events[1:]):
        assert event.over == e.over[0, j]
        assert event.phase_jump == e.phase_jump[0, j]
        given = [event.V_g_rms, event.omega_g, event.P_ref, event.Q_ref]
        given += [None, None] if event.grid is None else [event.grid.R_g, event.grid.L_g]
        asked = [e.V_g_rms, e.omega_g, e.P_ref, e.Q_ref, e.R_g, e.L_g]
        for value, drawn in zip(given, asked, strict=True):
            if value is None:
                assert np.isnan(drawn[0, j])
            else:
                assert value == pytest.approx(drawn[0, j], rel=1e-15, abs=1e-15)


def test_a_run_of_the_file_has_the_figures_of_the_batch() -> None:
    """The batch knows no file, and its judges are not those of single runs."""
    study = study_from_text(TEXT).undisturbed
    spec = study.controllers[1]
    families = np.array([FAMILIES.index(name) for name in ("step", "sag", "ramp", "grid")])
    cases, _ = cases_of(study, spec, uniforms_of(1, 0, 4), families)
    found = run_lanes(study, spec, NOTHING, cases)
    assert (found.status == JUDGED).all()
    for k, family in enumerate(families):
        run = run_scenario(case_study(study, spec, cases, k)[0])
        verdict, name = run.controllers[0].survival, FAMILIES[family]
        if name == "step":
            assert verdict is None
            signal = "P_pcc" if cases.signal[k] == 0 else "Q_pcc"
            step = next(event.cycle_mean for event in run.controllers[0].events if event.signal == signal)
            assert step.overshoot_pct == pytest.approx(100.0 * found.overshoot[k], abs=1e-6)
            assert step.settling_time_s == pytest.approx(found.settling_s[k], abs=1e-6)
            continue
        assert verdict is not None
        assert verdict.status == SURVIVED
        for figure in ("recovery_s", "peak_pu", "first_peak_pu", "limited_s", "swing_rad"):
            assert getattr(verdict, figure) == pytest.approx(getattr(found, figure)[k], abs=1e-6), (name, figure)
        said = survival_text(run)
        assert said.startswith(f"one survives the events and is at rest {found.recovery_s[k]:.4g} s after the last one")
        assert said in "".join(verdict_text(run, []))


@pytest.mark.parametrize("name", ["5 kVA, LC", "1 MVA, LCL, 60 Hz, delayed"])
def test_a_switched_bridge_has_the_figures_of_its_file(name: str) -> None:
    """Its powers ripple, and it rests beside the averaged bridge: a run knows both, and so does a batch."""
    own = name.startswith("5 kVA")
    study = study_from_text(TEXT).undisturbed if own else load_study(UTILITY)
    spec, lead_s = study.controllers[1], 0.2 if own else 1.0
    names = ("step", "step", "sag") if own else ("step", "grid")
    families = np.array([FAMILIES.index(name) for name in names])
    cases = cases_of(study, spec, uniforms_of(1, 0, len(names)), families)[0].later(lead_s)
    found = run_lanes(study, spec, NOTHING, cases, bridge="pwm")
    assert (found.status == JUDGED).all()
    for k, name in enumerate(names):
        result = run_scenario(case_study(study, spec, cases, k, bridge="pwm")[0]).controllers[0]
        if name == "step":
            step = next(event for event in result.events if event.kind == "step")
            assert step.status == MEASURED
            assert step.cycle_mean.overshoot_pct == pytest.approx(100.0 * found.overshoot[k], abs=1e-6)
            assert step.cycle_mean.settling_time_s == pytest.approx(found.settling_s[k], abs=1e-6)
            continue
        assert result.survival is not None
        for figure in ("recovery_s", "peak_pu", "first_peak_pu", "limited_s", "swing_rad"):
            assert getattr(result.survival, figure) == pytest.approx(getattr(found, figure)[k], abs=1e-6), figure


def test_a_table_and_files_are_named_as_seen_from_the_case(tmp_path: Path) -> None:
    table = gain_tables.table()
    (tmp_path / "worst").mkdir()
    write_table_file(table, tmp_path / "one.table.json")
    text = TEXT.replace('name = "one"', 'name = "one"\nschedule = "table"\ntable = "one.table.json"')
    (tmp_path / "study.toml").write_text(text)
    study = load_study(tmp_path / "study.toml")
    spec = study.controllers[1]
    ready = Ready(tables={"one": table})
    cases, _ = cases_of(study, spec, uniforms_of(1, 0, 1), 0, ready=ready)
    for named in (None, "../one.table.json"):
        _, written = case_study(study, spec, cases, 0, ready=ready, folder=tmp_path / "worst", table=named)
        path = tmp_path / "worst" / "01.toml"
        path.write_text(written)
        assert tomllib.loads(written)["controllers"][0]["table"] == "../one.table.json"
        found = load_study(path)
        assert Path(str(found.controllers[0].table_file)).resolve() == (tmp_path / "one.table.json").resolve()
    # 1.85 settling times of the table, 1.5 s, after the step.
    assert found.simulation.duration == pytest.approx(float(cases.events.t_s[0, 0]) + 1.85 * 1.5, abs=1e-4)


def test_designed_inner_loops_and_a_fixed_grid_are_said() -> None:
    text = TEXT.replace("[grid]", "[inner_loops]\ndesign = true\n[grid]", 1)
    plain = study_from_text(TEXT)
    study = study_from_text(text, inner_loops=lambda _: (plain.inner_gains._replace(K_ff=0.9, R_t=0.5), 250.0))
    found, written = of("grid", 2, study, spec=0)
    np.testing.assert_allclose(found.inner_gains, study.inner_gains, rtol=1e-15)
    assert found.omega_t == pytest.approx(250.0, rel=1e-15)
    assert found.controllers[0].design_grid == study.grid
    assert found.controllers[0].knowledge is None
    assert tomllib.loads(written)["inner_loops"].get("design") is None


def test_toml_is_read_as_it_was_written() -> None:
    document = {
        "schema": 1,
        "a": {"x": 1e-05, "y": 0.1 + 0.2, "on": True, "text": 'A "quoted"\nline\x7f µ', "deep": {"er": {"k": -0.0}}},
        "list": [{"time": 1.0, "grid": {"R_g": 1e22}}, {"v": [1, 2.5, "3 kW"]}],
        "none": [],
        "odd key": {"with.dot": 3},
    }
    assert tomllib.loads(toml_text(document, ("What it is", ""))) == document
    with pytest.raises(ValueError, match="not finite"):
        toml_text({"a": {"x": math.nan}})
    with pytest.raises(TypeError, match="has no word in TOML"):
        toml_text({"a": {"x": None}})


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("[sensors]\nlevel = 'typical'", r"powers do not come to rest with \[sensors\] and no distorted"),
        ("[background]\nlevel = 'measured'", r"powers do not come to rest with a \[background\] that wanders"),
        ("", "nothing happens after t = 0"),
    ],
)
def test_what_cannot_be_judged_as_one_disturbance_is_refused(more: str, said: str) -> None:
    text = TEXT.replace("[background]", more).replace('Q_ref = "0 var"', 'Q_ref = "0 var"\nsurvival = true')
    with pytest.raises(StudyError, match=said):
        study_from_text(text)
