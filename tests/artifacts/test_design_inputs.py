"""What a table's design depends on: a title and a file name do not count, a promise and a filter do."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.small_studies import call, failure
from tests.gain_tables import table
from vsgdesign.artifacts import GainTable, read_table_file, write_table_file
from vsgdesign.artifacts.design_inputs import design_hash, design_inputs, input_differences, study_differences
from vsgdesign.artifacts.gain_table import base_of, table_document
from vsgdesign.artifacts.gain_table_file import TABLE_FILE
from vsgdesign.artifacts.table_text import certificate_sentence
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.runtime.table import with_node_gains
from vsgdesign.study.parameters import Study, study_from_text

TEXT = """
base = "case:hoang2025_5kva"
study = { name = "mine", title = "Mine" }
simulation = { duration = "1 s", P_ref = "4 kW", Q_ref = "0 var" }

[filter]
L_1 = "1.5 mH"

[specification]
settling_time = "1.3 s"
P = ["-4.5 kW", "4.5 kW"]
scr = [2, 8]
x_over_r = [0.5, 3]

[[controllers]]
name = "scheduled"
kind = "scheduled"
structure = "angle_damped"
schedule = "table"
"""

SAME = {
    "a title": ('title = "Mine"', 'title = "Yours"'),
    "a name": ('name = "mine"', 'name = "yours"'),
    "the controller's name": ('name = "scheduled"', 'name = "other"'),
    "a file": ('schedule = "table"', 'schedule = "table"\ntable = "t.json"'),
    "other units": ('L_1 = "1.5 mH"', "L_1 = 0.0015"),
    "the order": ("scr = [2, 8]\nx_over_r = [0.5, 3]", "x_over_r = [0.5, 3]\nscr = [2.0, 8.0]"),
    "what is simulated": ('duration = "1 s"', 'duration = "2 s"'),
    "maps": ("[specification]", "[stability]\nscr = [2, 4]\n\n[specification]"),
    "events": ("[[controllers]]", '[[events]]\ntime = "0.5 s"\nP_ref = "3 kW"\n\n[[controllers]]'),
    "what only a closed form uses": ("[specification]", "[power_loops]\nk_1 = 30\n\n[specification]"),
}
OTHER = {
    "specification.settling_time was 1.3 in its design, the study has 1.5": ("1.3 s", "1.5 s"),
    "filter.L_1 was 0.0015 in its design, the study has 0.0016": ("1.5 mH", "1.6 mH"),
    "specification.box.P was [-4500, 4500] in its design, the study has [-4500, 4000]": ('"4.5 kW"', '"4 kW"'),
    "controller.structure was angle_damped in its design, the study has decoupled": ("angle_damped", "decoupled"),
    "converter.delay_samples was zero or not given in its design, the study has 1": (
        "[filter]",
        "[converter]\ndelay_samples = 1\n\n[filter]",
    ),
    "power_loops.tau_P was zero or not given in its design, the study has 0.01": (
        "[filter]",
        '[power_loops]\ntau_P = "10 ms"\n\n[filter]',
    ),
    "inner_loops.K_ff was 1 in its design, the study has 0.5": (
        "[filter]",
        "[inner_loops]\ncurrent_feedforward = 0.5\n\n[filter]",
    ),
    "grid.V_g_rms was 110 in its design, the study has 99": ("[filter]", "[grid]\nV_g_pu = 0.9\n\n[filter]"),
}


def text(*changes: tuple[str, str]) -> str:
    found = TEXT
    for old, new in changes:
        assert old in found
        found = found.replace(old, new, 1)
    return found


def designed(study: Study) -> GainTable:
    """A table that says that it was designed from a study."""
    asked, inputs = study.specification, design_inputs(study, study.controllers[0].target)
    made = table(scr=(2.0, 8.0), x_over_r=(0.5, 3.0), base=base_of(study), name="scheduled", study_hash=study.hash)
    if asked is None:
        return replace(made, design_inputs=inputs)
    box = replace(made.validity, P=(min(asked.box.P), max(asked.box.P)), Q=(min(asked.box.Q), max(asked.box.Q)))
    box = replace(box, error=max(asked.box.error_R, asked.box.error_X))
    made = replace(made, validity=box, specification=asdict(asked), time_scale=asked.settling_time)
    return with_node_gains(replace(made, design_inputs=inputs))


@pytest.mark.parametrize("change", SAME)
def test_what_the_design_does_not_depend_on_changes_nothing(change: str) -> None:
    study, other = study_from_text(TEXT), study_from_text(text(SAME[change]))
    assert design_inputs(study, study.controllers[0].target) == design_inputs(other, other.controllers[0].target)
    assert study_differences(designed(study), other) == []


@pytest.mark.parametrize("says", OTHER)
def test_what_it_depends_on_is_named_with_both_values(says: str) -> None:
    study, other = study_from_text(TEXT), study_from_text(text(OTHER[says]))
    made = designed(study)
    lines = study_differences(made, other)
    assert says in lines
    assert made.design_hash != design_hash(design_inputs(other, other.controllers[0].target))


def test_verbs_take_a_study_that_uses_the_table_and_refuse_another(tmp_path: Path) -> None:
    """The way to use a table is to name it in the study: then it is still that study's table."""
    study = study_from_text(TEXT)
    write_table_file(designed(study), tmp_path / "t.json")
    (tmp_path / "uses.toml").write_text(text(SAME["a file"], SAME["a title"]))
    says = "specification.settling_time was 1.3 in its design, the study has 1.5"
    (tmp_path / "other.toml").write_text(text(OTHER[says]))
    check = ("table", "check", tmp_path / "t.json", "--study")
    export = ("export", "c", tmp_path / "t.json", "--out", tmp_path / "c", "--study")
    for verb in (check, export):
        used = call(*verb, tmp_path / "uses.toml")
        assert used.exit_code == 0, used.output
    refused = call(*check, tmp_path / "other.toml")
    assert refused.exit_code == 1
    assert says in refused.stdout
    assert says in failure(2, *export, tmp_path / "other.toml")


def test_a_gain_that_a_later_version_adds_and_that_is_off_changes_nothing() -> None:
    study = study_from_text(TEXT)
    inputs = design_inputs(study, study.controllers[0].target)
    made = replace(designed(study), design_inputs=inputs)
    for name in InnerLoopGains._fields:
        assert (name in inputs["inner_loops"]) is (getattr(study.inner_gains, name) != 0.0)
    assert study_differences(made, study) == []


def test_a_study_without_a_specification_takes_the_tables_promises() -> None:
    study = study_from_text(TEXT)
    begin, end = TEXT.index("[specification]"), TEXT.index("[[controllers]]")
    without = study_from_text((TEXT[:begin] + TEXT[end:]).replace('= "table"', '= "table"\ntable = "t.json"'))
    assert study_differences(designed(study), without) == []


def test_many_differences_are_cut_short() -> None:
    made = {"converter": {f"x_{k}": float(k + 1) for k in range(20)}}
    assert len(input_differences(made, {"specification": {"H": 1.0}})) == 21
    study = study_from_text(TEXT)
    lines = study_differences(replace(designed(study), design_inputs=made), study)
    assert len(lines) == 9
    assert lines[-1].endswith("more fields differ")


def schema_1(made: GainTable) -> dict[str, Any]:
    """A table's document as version 0.1 wrote it."""
    document = table_document(made)
    for name in ("design_inputs", "between", "causes"):
        document.pop(name)
    return document | {"schema": 1}


def test_a_certificate_of_schema_2_is_none_any_more_and_its_gains_are_read(tmp_path: Path) -> None:
    """It followed ω_i, which jumps when the gains change; a counterexample is one with any state."""
    made = designed(study_from_text(TEXT))
    region = {"scr": [2.0, 20.0], "rate": None}
    for certificate, kept in (
        ({"decay": 1.5, "proof": "gap-free", "P": [[1.0]], "region": region}, False),
        ({"certified": False, "reason": "no function", "region": region}, True),
        (None, True),
    ):
        document = table_document(made) | {"schema": 2, "certificate": certificate}
        (tmp_path / "old.json").write_text(TABLE_FILE.render(document), encoding="utf-8")
        read = read_table_file(tmp_path / "old.json")
        np.testing.assert_array_equal(read.gains.K_ip, made.gains.K_ip)
        assert (read.certificate is None) == (certificate is None)
        if read.certificate is not None:
            assert not read.certificate.certified
            assert read.certificate.decay is None
            assert read.certificate.region.scr == (2.0, 20.0)
            sentence = certificate_sentence(read.certificate)
            assert ("no function" in sentence) == kept
            assert ("not continuous when the gains change; prove the table again" in sentence) != kept
        write_table_file(read, tmp_path / "new.json")
        assert read_table_file(tmp_path / "new.json").sha256 == read.sha256


def test_a_table_of_schema_1_is_read(tmp_path: Path) -> None:
    study = study_from_text(TEXT)
    document = schema_1(designed(study))
    (tmp_path / "old.json").write_text(TABLE_FILE.render(document), encoding="utf-8")
    read = read_table_file(tmp_path / "old.json")
    assert (read.design_inputs, read.between, read.causes, read.design_hash) == ({}, None, [], "")
    np.testing.assert_array_equal(read.gains.K_ip, designed(study).gains.K_ip)
    write_table_file(read, tmp_path / "new.json")
    assert read_table_file(tmp_path / "new.json").sha256 == read.sha256
    # It cannot say what it was designed from: its study's document has to be the very same.
    assert study_differences(read, study) == []
    (line,) = study_differences(read, study_from_text(text(SAME["a title"])))
    assert "does not hold the inputs of its design: build it again" in line
