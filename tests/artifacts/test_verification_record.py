"""A gain table keeps its verification in its file, and says it in the same words as the verification's page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.gain_tables import table
from tests.verification_documents import document
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.artifacts.gain_table_file import verification_faults, verification_record
from vsgdesign.artifacts.verification_text import headline, promise_sentences
from vsgdesign.errors import ArtifactError
from vsgdesign.report.gain_table.page import table_page
from vsgdesign.report.gain_table.words import heading
from vsgdesign.report.page.html import print_html


def test_a_table_keeps_what_was_shown(tmp_path: Path) -> None:
    bare, shown = table(), document(runs=900)
    verified = replace(bare, verification=verification_record(shown))
    assert verified.sha256 != bare.sha256
    write_table_file(verified, tmp_path / "t.json")
    read = read_table_file(tmp_path / "t.json")
    assert read == verified
    assert read.verification is not None
    assert promise_sentences(read.verification) == promise_sentences(shown)
    assert headline(read.verification) == headline(shown)
    assert "worst" not in read.verification
    assert "map" not in read.verification


def test_a_table_without_one_keeps_its_bytes(tmp_path: Path) -> None:
    write_table_file(table(), tmp_path / "t.json")
    assert "verification" not in json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))
    assert read_table_file(tmp_path / "t.json").verification is None


def test_words_and_page_say_so(tmp_path: Path) -> None:
    lines = list(heading(table()))
    assert "Not verified: no random cases were simulated with this table (vsgdesign verify)." in lines
    shown = document(runs=900, broken=False)
    verified = replace(table(), verification=verification_record(shown))
    first = f"Verified in EMT: every promise was kept in all of {shown['judged']} judged cases, of 900 drawn."
    assert f"{first} (carried, not checked)" in list(heading(verified))
    assert set(promise_sentences(shown)) <= set(heading(verified))
    page = print_html(table_page(verified), tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count(first) == 2  # in the verdict and in its part
    assert all(page.count(sentence) == 1 for sentence in set(promise_sentences(shown)))


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda _: "yes", "must be a table"),
        (lambda r: r | {"runs": 1.5}, "runs must be a whole number"),
        (lambda r: r | {"confidence": 1}, "confidence must be between 0 and 1"),
        (lambda r: r | {"families": {"step": {"promises": {"overshoot": {"limit": 0.05}}}}}, "families must have"),
    ],
)
def test_a_damaged_record_is_refused(tmp_path: Path, change: Any, fault: str) -> None:
    record = verification_record(document(runs=300))
    assert verification_faults(record) == []
    with pytest.raises(ArtifactError, match=f"verification: {fault}"):
        write_table_file(replace(table(), verification=change(record)), tmp_path / "t.json")
