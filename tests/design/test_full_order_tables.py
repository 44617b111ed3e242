"""What a gain table keeps of the proof of its sampled full-order loop, and where it is said."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import GainTable, ValidityBox, base_of
from vsgdesign.artifacts.gain_table_file import read_table_file, table_faults, write_table_file
from vsgdesign.artifacts.proof_file import PROOF_FILE, proof_of, proved_table
from vsgdesign.artifacts.table_text import full_order_sentence, proof_sentences, table_summary
from vsgdesign.certificate import Region
from vsgdesign.certificate.asked import within_scheduler
from vsgdesign.export.c_content import Origin, content_of
from vsgdesign.report.gain_table.words import heading
from vsgdesign.runtime.guards import settings_of
from vsgdesign.runtime.scheduler import scheduler_of
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.cli.common import going_on
from vsgdesign.verbs.pipeline.full_order import check_proof_file, with_full_order
from vsgdesign.verbs.pipeline.table import FULL_ORDER, check_whole_table

STUDY = Path(__file__).parents[2] / "studies/table/study.toml"


def bare() -> tuple[Any, Any, GainTable]:
    """A study, its controller, and a table of one cell on a strong grid."""
    study = replace(load_study(STUDY), scr_basis="impedance")
    spec = next(one for one in study.controllers if one.name == "table")
    scr, ratio = np.array([8.0, 8.3]), np.array([2.0, 2.1])
    box = ValidityBox((8.0, 8.3), (2.0, 2.1), (1e3, 3e3), (0.0, 1e3), (93.5, 137.5), 0.05)
    columns = {"k_1": 15.8, "d_1": 6.6, "k_2": 4.0, "share_Q": 0.9}
    found = table("angle_damped", "poles", scr, ratio, columns, D_q=9.09, validity=box, base=base_of(study))
    return study, spec, found


@functools.cache
def proved() -> Any:
    study, spec, one = bare()
    found, proof = with_full_order(study, spec, one, 60.0)
    assert proof is not None
    return study, one, found, proof


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Finished parts are kept below it."""
    monkeypatch.chdir(tmp_path)


def test_a_table_keeps_what_is_proved_and_everything_says_it(tmp_path: Path) -> None:
    study, one, found, proof = proved()
    said = found.full_order
    assert said["certified"] is True
    assert said["proof_sha256"]
    assert said["inner_gains"] == study.inner_gains._asdict()
    file = tmp_path / "a.json"
    write_table_file(found, file)
    assert read_table_file(file) == found
    # What it proves are the gains: they are the same with and without the statement, or with another verification.
    assert proof.table == proved_table(one) == proved_table(found)
    assert proof.table != proved_table(replace(one, D_p=2.0 * one.D_p))
    sentence = full_order_sentence(said)
    assert f"inner gains {said['inner_hash']}" in sentence
    assert "with an ideal dc link" in sentence
    assert sentence in proof_sentences(found)
    origin = Origin("a", "0" * 64, "s", "0" * 64, full_order=sentence)
    headline = content_of(scheduler_of(found), origin)["headline"]
    assert f"inner gains {said['inner_hash']}" in headline
    assert "with an ideal dc link" in headline
    assert sentence in list(heading(found))
    assert table_summary(study, found)["full_order"]["text"] == sentence
    assert FULL_ORDER in check_whole_table(found).carried
    assert going_on(said, file, "study.toml") is None
    PROOF_FILE.write(proof, proof_of(file))
    checked = check_proof_file(proof_of(file), study, found)
    assert not checked.faults
    assert checked.looked is not None
    other = check_proof_file(proof_of(file), study, replace(found, D_p=2.0 * found.D_p))
    assert other.carried


def test_out_of_time_the_rest_is_named_and_the_command_goes_on() -> None:
    study, spec, one = bare()
    found, proof = with_full_order(study, spec, one, 1e-3)
    said = found.full_order
    assert said is not None
    assert proof is not None
    assert (said["certified"], said["proved"]) == (False, 0.0)
    assert {part["reason"] for part in said["left"]} == {"time"}
    assert full_order_sentence(said).startswith("Nothing is proved yet of the sampled full-order model")
    line = going_on(said, "t.json", "study.toml")
    assert line is not None
    assert f"vsgdesign certify t.json --study study.toml --model full --decay {said['decay']!r} goes on" in line
    assert "certify 'my t.json' --study 'my s.toml' --model" in str(going_on(said, "my t.json", "my s.toml"))
    assert with_full_order(study, spec, one, 0.0) == (one, None)


def test_why_there_is_no_proof_is_kept() -> None:
    """The table's box of V is smaller than the converter's: its scheduler would draw V in."""
    study, spec, one = bare()
    narrow = replace(one, validity=replace(one.validity, V_rms=(100.0, 120.0)))
    found, proof = with_full_order(study, spec, narrow, 60.0)
    assert proof is None
    assert "table's box of V_rms" in full_order_sentence(found.full_order)
    assert not table_faults(found)


def test_a_statement_that_is_none_is_named() -> None:
    _, _, one = bare()
    faults = "; ".join(table_faults(replace(one, full_order={"certified": True, "proved": 0.5, "decay": -1.0})))
    for part in ("proved: must be 1", "decay: must be", "states: missing", "inner_hash: missing", "region: missing"):
        assert f"full_order{'[0]' if 'must be 1' not in part else ''}.{part}" in faults


def test_a_proof_keeps_to_the_limits_that_a_scheduler_holds_in_single_precision() -> None:
    """0.85 · 398.37 V is no number of single precision: the scheduler keeps the next one inside, and so must the proof.
    Limits that are narrower on purpose stay a fault."""
    study = load_study(STUDY)
    V = 690.0 / np.sqrt(3.0)
    study = replace(study, converter=replace(study.converter, V_rated_rms=V))
    own = table(validity=replace(table().validity, V_rms=study.converter.V_limits_rms, P=(-4321.1, 4321.1)))
    region = Region((2.0, 9.0), (0.3, 10.0), (-4321.1, 4321.1), (-1e3, 1e3), 0.2)
    box, (kept, narrowed) = settings_of(own), within_scheduler(study, region, own)
    for asked, mine, held in (
        (study.converter.V_limits_rms, kept.converter.V_limits_rms, box.V_rms),
        (region.P, narrowed.P, box.P),
    ):
        assert asked[0] < held[0] <= mine[0] < asked[0] + 2e-7 * abs(asked[0])
        assert asked[1] > held[1] >= mine[1] > asked[1] - 2e-7 * abs(asked[1])
    assert narrowed == replace(region, P=narrowed.P)
    less = table(validity=replace(own.validity, V_rms=(0.9 * V, 1.1 * V)))
    assert within_scheduler(study, region, less)[0].converter.V_limits_rms == study.converter.V_limits_rms
    assert within_scheduler(study, region, None) == (study, region)
