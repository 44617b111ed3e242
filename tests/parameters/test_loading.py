"""Files and the bases below them: merged field by field, one way of saying a thing replacing the other."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest

from tests.parameters.documents import case_document, to_toml
from vsgdesign.errors import StudyError
from vsgdesign.study.parameters import load_study, study_from_text

REST = """
[simulation]
duration = "1 s"
P_ref = 0
Q_ref = 0
[[controllers]]
name = "a"
kind = "scheduled"
"""
ON_CASE = 'base = "case:hoang2025_5kva"\n'


def message(text: str, folder: Path = Path(".")) -> str:
    with pytest.raises(StudyError) as caught:
        study_from_text(text, folder=folder)
    return str(caught.value)


def test_tables_merge_and_the_upper_file_wins(tmp_path: Path) -> None:
    (tmp_path / "bases").mkdir()
    (tmp_path / "bases" / "lower.toml").write_text(ON_CASE + '[converter]\nf_sw = "20 kHz"\nV_dc = "700 V"\n')
    (tmp_path / "bases" / "middle.toml").write_text('base = "lower.toml"\n[converter]\nV_dc = "750 V"\n')
    top = tmp_path / "top.toml"
    top.write_text('base = "bases/middle.toml"\n' + REST)
    study = load_study(top)
    assert (study.converter.f_sw, study.converter.V_dc, study.converter.S_rated) == (20e3, 750.0, 5000.0)
    assert study.name == "top"


def test_a_study_called_study_takes_the_name_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "farm").mkdir()
    path = tmp_path / "farm" / "study.toml"
    path.write_text(ON_CASE + REST)
    assert load_study(path).name == "farm"


def test_lists_replace_instead_of_adding(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(ON_CASE + REST + "[[events]]\ntime = 0.5\nP_ref = 1\n")
    (tmp_path / "top.toml").write_text('base = "base.toml"\nevents = []\n')
    assert load_study(tmp_path / "top.toml").events == ()


@pytest.mark.parametrize(
    ("section", "checks"),
    [
        ('[grid]\nR_g = 1.5\nL_g = "4 mH"\n', {"R_g": 1.5, "L_g": 0.004}),
        ("[grid]\nscr = 4\n", {"R_g": 1.815}),
    ],
)
def test_ohms_and_short_circuit_ratio_replace_each_other(section: str, checks: dict[str, float]) -> None:
    grid = study_from_text(ON_CASE + section + REST).grid
    for field, value in checks.items():
        assert getattr(grid, field) == pytest.approx(value, rel=1e-15)


def test_a_ratio_over_ohms_of_the_base(tmp_path: Path) -> None:
    (tmp_path / "ohms.toml").write_text(ON_CASE + '[grid]\nR_g = 1.5\nL_g = "4 mH"\n')
    study = study_from_text('base = "ohms.toml"\n[grid]\nscr = 4\nx_over_r = 2\n' + REST, folder=tmp_path)
    assert study.grid.scr(study.converter, "reactance") == pytest.approx(4.0)


def test_the_basis_of_the_ratio_survives_ohms_on_top() -> None:
    """It still says how the events' ratios are meant."""
    events = '[[events]]\ntime = "0.5 s"\ngrid = { scr = 8, x_over_r = 1 }\n'
    study = study_from_text(ON_CASE + '[grid]\nR_g = 1.5\nL_g = "4 mH"\n' + REST + events)
    assert study.scr_basis == "reactance"
    assert study.events[0].grid is not None
    assert study.events[0].grid.R_g == pytest.approx(7.26 / 8.0)


def test_gains_replace_response_times_and_back(tmp_path: Path) -> None:
    gains = "[inner_loops]\nK_pc = 10\nK_ic = 30e3\nK_pv = 0.05\nK_iv = 15\n"
    study = study_from_text(ON_CASE + gains + REST)
    assert study.inner_gains[:4] == (0.05, 15.0, 10.0, 30e3)
    (tmp_path / "gains.toml").write_text(ON_CASE + gains)
    times = '[inner_loops]\ncurrent_response_time = "1 ms"\nvoltage_response_time = "10 ms"\n'
    back = study_from_text('base = "gains.toml"\n' + times + REST, folder=tmp_path)
    assert back.inner_gains == study_from_text(ON_CASE + REST).inner_gains


def test_the_transient_resistance_is_in_ohms_and_its_corner_half_of_nominal() -> None:
    """0.08 of 3·110²/5000 Ω; off by default; an upper file may turn it off and leave the corner where it is."""
    study = study_from_text(ON_CASE + "[inner_loops]\ntransient_resistance_pu = 0.08\n" + REST)
    assert study.inner_gains.R_t == pytest.approx(0.08 * 7.26, rel=1e-14)
    assert study.omega_t == pytest.approx(2.0 * math.pi * 25.0, rel=1e-14)
    smoothing = study.controller_settings().smoothing_t
    assert smoothing == pytest.approx(1.0 - math.exp(-2.0 * math.pi * 25.0 * 50e-6), rel=1e-12)
    assert study_from_text(ON_CASE + REST).inner_gains.R_t == 0.0
    off = '[inner_loops]\ntransient_resistance_pu = 0\ntransient_corner = "10 Hz"\n'
    assert study_from_text(ON_CASE + off + REST).inner_gains.R_t == 0.0


def test_line_to_line_replaces_phase_voltage() -> None:
    study = study_from_text(ON_CASE + '[converter]\nV_rated_ll_rms = "200 V"\n' + REST)
    assert study.converter.V_rated_rms == pytest.approx(200.0 / 3.0**0.5, rel=1e-15)


def test_an_unknown_case_lists_the_known_ones() -> None:
    text = message('base = "case:hoang"\n')
    assert "no such case" in text
    assert '"case:hoang2025_5kva"' in text


@pytest.mark.parametrize("value", ["3", "true", "[1]", "{ a = 1 }"])
def test_a_base_must_be_a_text(value: str) -> None:
    assert "must be a text" in message(f"base = {value}\n")


def test_a_circle_of_bases(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('base = "b.toml"\n')
    (tmp_path / "b.toml").write_text('base = "a.toml"\n')
    with pytest.raises(StudyError, match="circle"):
        load_study(tmp_path / "a.toml")


def test_eight_bases_are_a_tower_and_nine_too_many(tmp_path: Path) -> None:
    (tmp_path / "0.toml").write_text(to_toml(case_document()))
    for k in range(1, 10):
        (tmp_path / f"{k}.toml").write_text(f'base = "{k - 1}.toml"\n')
    assert load_study(tmp_path / "8.toml").converter.S_rated == 5000.0
    with pytest.raises(StudyError, match="more than 8 bases"):
        load_study(tmp_path / "9.toml")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="there is no such file"):
        load_study(tmp_path / "absent.toml")
    with pytest.raises(StudyError, match="is a folder"):
        load_study(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b'name = "\xff\xfe"\n')
    with pytest.raises(StudyError, match=r"is not UTF-8 text \(byte 8\)"):
        load_study(tmp_path / "binary.toml")
    (tmp_path / "text.toml").write_text("this is no TOML\n")
    with pytest.raises(StudyError, match=r"cannot be read as TOML.*line 1"):
        load_study(tmp_path / "text.toml")
    with pytest.raises(StudyError, match="cannot be read"):
        load_study(tmp_path / ("x" * 5000))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"name": "small", "grid": {"scr": 2}}', "this is JSON. Write it as TOML"),
        ('["small", 2]', "this is JSON. Write it as TOML"),
        ('{"name": "small"', "cannot be read as TOML"),
        ("[" * 5000, "cannot be read as TOML"),
    ],
)
def test_json_is_told_from_broken_toml(text: str, said: str) -> None:
    assert said in message(text)


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    """As editors and spreadsheets on Windows write UTF-8."""
    path = tmp_path / "marked.toml"
    path.write_bytes(b"\xef\xbb\xbf" + (ON_CASE + REST).replace("\n", "\r\n").encode())
    assert load_study(path).converter.S_rated == 5000.0


def test_a_missing_base_is_named_with_its_path(tmp_path: Path) -> None:
    assert str(tmp_path / "nowhere.toml") in message('base = "nowhere.toml"\n', tmp_path)
    assert "is a folder" in message('base = ""\n', tmp_path)


@pytest.mark.parametrize("text", ["x = 1" + "0" * 5000, "x = " + "[" * 5000 + "]" * 5000])
def test_toml_that_breaks_the_parser(text: str) -> None:
    """More digits than Python converts, deeper nesting than it recurses."""
    assert sys.get_int_max_str_digits() < 5000
    assert "cannot be read as TOML" in message(text)


def test_the_hash_is_of_the_content_not_of_the_spelling(tmp_path: Path) -> None:
    (tmp_path / "base.toml").write_text(ON_CASE)
    one = study_from_text(ON_CASE + REST)
    two = study_from_text("# a comment\n" + 'base = "base.toml"\n' + REST, folder=tmp_path)
    other = study_from_text(ON_CASE + REST.replace("P_ref = 0", "P_ref = 1"))
    assert one.hash == two.hash
    assert one.hash != other.hash
    assert len(one.hash) == 64


def test_what_an_event_keeps_of_the_grid_is_what_was_given() -> None:
    """Back on the first SCR the grid is the first one, to the bit: pages then show it once."""
    events = "".join(f'[[events]]\ntime = "{0.1 * k} s"\ngrid = {{ scr = {scr} }}\n' for k, scr in ((1, 1.5), (2, 5.5)))
    study = study_from_text(ON_CASE + "[grid]\nscr = 5.5\nx_over_r = 2.4\n" + REST + events)
    assert study.events[1].grid == study.grid


def test_a_study_of_the_present_folder_has_its_folders_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where it is named by its whole path: an empty name would put results straight into out/."""
    home = tmp_path / "bench"
    home.mkdir()
    (home / "study.toml").write_text(ON_CASE + REST)
    monkeypatch.chdir(home)
    assert load_study("study.toml").name == load_study(home / "study.toml").name == "bench"


def test_the_content_of_a_study_is_what_results_depend_on() -> None:
    """Names and files are no part of it, nor the order of the set of fields that [verification] gives, which is another
    in each process: kept work was lost for it."""
    text = ON_CASE + REST + '[verification]\nscr = [2, 9]\n[study]\nname = "{}"\ntitle = "{}"\n'
    one, other = (study_from_text(text.format(name, name.upper())) for name in ("first", "second"))
    assert repr(one.content) == repr(other.content)
    assert one.verification is not None
    assert one.verification.given
    assert one.content.verification is not None
    assert not one.content.verification.given
    changed = study_from_text(text.replace("[2, 9]", "[2, 8]").format("first", "FIRST"))
    assert repr(changed.content) != repr(one.content)
