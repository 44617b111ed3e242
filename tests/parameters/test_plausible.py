"""A wrong unit is told as one: what no converter has, a study cannot have either."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.parameters.documents import to_toml
from vsgdesign.errors import StudyError
from vsgdesign.study.parameters import load_study, study_from_text

SIMULATION: dict[str, Any] = {"duration": "1 s", "P_ref": "1 kW", "Q_ref": "0 var"}


def text_of(section: str, field: str, value: object) -> str:
    controllers = [{"name": "fixed", "kind": "fixed"}]
    document = {"base": "case:lab_12kva_lcl", "simulation": SIMULATION, "controllers": controllers}
    return to_toml(document | {section: {field: value}})


@pytest.mark.parametrize(
    ("section", "field", "value", "said"),
    [
        ("converter", "f_n", 314.16, "did you mean 50 Hz?"),
        ("converter", "f_n", "377 Hz", "did you mean 60 Hz?"),
        ("converter", "V_dc", "700 kV", "the bridge makes 1.24e+03 times the rated voltage"),
        ("filter", "L_1", "490 mH", "is 12.03 pu of the converter, more than 4 pu"),
        ("filter", "L_2", "490 mH", "is 12.03 pu of the converter"),
        ("filter", "R_1", "80 ohm", "is 6.25 pu of the converter"),
        ("filter", "C", "10 mF", "is 40.21 pu of the converter, more than 20 pu"),
    ],
)
def test_what_only_a_wrong_unit_explains(section: str, field: str, value: object, said: str) -> None:
    with pytest.raises(StudyError) as caught:
        study_from_text(text_of(section, field, value), "a study")
    assert any(fault.field == f"{section}.{field}" and said in str(fault) for fault in caught.value.faults)


def test_unusual_is_not_wrong() -> None:
    """A dc link of ten times what is needed, 400 Hz, and an inductor of 1 pu are somebody's."""
    study_from_text(text_of("converter", "V_dc", "7 kV"), "a study")
    study_from_text(text_of("filter", "L_1", "40 mH"), "a study")
    assert study_from_text(text_of("converter", "f_n", "400 Hz"), "a study").converter.omega_n > 2500.0


def test_files_of_another_kind_say_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "sheet.csv").write_text("Rated power,30,kVA\nRated voltage,400,V\n")
    with pytest.raises(StudyError, match=r"write its study with vsgdesign new --from .*sheet.csv"):
        load_study(tmp_path / "sheet.csv")
    (tmp_path / "notepad.toml").write_bytes("schema = 1\n".encode("utf-16"))
    with pytest.raises(StudyError, match=r"is not UTF-8 text but UTF-16. Save it"):
        load_study(tmp_path / "notepad.toml")
    (tmp_path / "newer.toml").write_text("schema = 2\n")
    with pytest.raises(StudyError, match=r"reads no newer format. Install a newer version"):
        load_study(tmp_path / "newer.toml")
