"""One reader of certificates: what the file says comes back, what is not said is None, all faults are named at once."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tests.gain_tables import table
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.artifacts.certificate_record import CertificateCell, CertificateRegion, certificate_record
from vsgdesign.artifacts.files import sorted_plain
from vsgdesign.artifacts.guarded_file import content_hash
from vsgdesign.certificate import Region, refusal_record
from vsgdesign.errors import ArtifactError

PROVED = {
    "certified": True,
    "region": {"scr": [2, 8.0], "x_over_r": [0.3, 3.0], "P": [-1.0, 1.0], "Q": [0.0, 1.0], "error": 0.2, "rate": 0.05},
    "decay": 2.0,
    "proof": "gridded",
    "gap": {"share": 0.25, "box": [0.0] * 6},
    "P": [[[1.0]]],
    "checked": 40,
    "fresh": 2,
    "of_somebody_else": {"kept": True},
}


def test_everything_that_is_said_is_there_and_the_document_is_kept() -> None:
    record = certificate_record(PROVED)
    assert record.region == CertificateRegion(
        scr=(2.0, 8.0), x_over_r=(0.3, 3.0), P=(-1.0, 1.0), Q=(0.0, 1.0), error=0.2, rate=0.05
    )
    assert (record.certified, record.decay, record.proof, record.gap_share) == (True, 2.0, "gridded", 0.25)
    assert record.points == 42
    assert record.cell is None
    assert record.document == PROVED


def test_what_is_not_said_is_none_and_the_grid_may_jump() -> None:
    record = certificate_record({})
    assert record.certified  # a document without the key was one of a proof
    assert record.region == CertificateRegion()
    assert math.isinf(record.region.rate)
    assert {record.decay, record.proof, record.gap_share, record.points, record.cell, record.reason} == {None}
    assert certificate_record({"rate": 0.1}).region.rate == 0.1
    assert math.isinf(certificate_record({"rate": 0.1, "region": {"rate": None}}).region.rate)


def test_a_refusal_names_its_slowest_cell() -> None:
    cell = CertificateCell(scr=2.0, x_over_r=0.3, P=1e3, Q=0.0, error_R=0.2, error_L=-0.2, decay=0.4)
    region = Region((1.0, 2.0), (0.3, 1.0), (0.0, 1e3), (0.0, 1e2), 0.2)
    record = refusal_record("No common function exists.", region, cell)
    assert record.cell == cell
    assert not cell.is_unstable
    assert record == certificate_record(json.loads(json.dumps(record.document)))
    assert refusal_record("x", region).cell is None


def test_all_faults_at_once() -> None:
    wrong = {
        "certified": False,
        "region": {"scr": [8.0, 2.0], "error": "0.2"},
        "gap": [],
        "decay": True,
        "checked": 1.5,
        "proof": 3,
        "slowest": {"scr": 2.0, "x_over_r": 1.0, "P": 0.0, "Q": 0.0, "error_R": 0.0, "error_L": 0.0},
    }
    with pytest.raises(ValueError, match="certificate") as caught:
        certificate_record(wrong)
    for fault in (
        "certificate.region.scr: must be two numbers, the smaller first",
        "certificate.region.error: must be a number",
        "certificate.gap: must be a table",
        "certificate.decay: must be a number",
        "certificate.checked: must be a whole number",
        "certificate.proof: must be text",
        "certificate.slowest.decay: is missing",
    ):
        assert fault in str(caught.value)


def test_a_file_with_a_certificate_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    write_table_file(table(certificate=PROVED), path)
    assert read_table_file(path).certificate == certificate_record(sorted_plain(PROVED))
    document = json.loads(path.read_text(encoding="utf-8"))
    del document["sha256"]
    document["certificate"]["region"]["P"] = ["-4 kW", "4 kW"]
    from vsgdesign.artifacts.gain_table_file import TABLE_FILE

    assert content_hash(document)
    path.write_text(TABLE_FILE.render(document), encoding="utf-8")
    with pytest.raises(ArtifactError, match=r"certificate\.region\.P: must be two numbers, the smaller first"):
        read_table_file(path)
