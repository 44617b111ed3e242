"""Files of datasheets: columns, separators, encodings, and files that are none."""

from __future__ import annotations

import math
import random
from dataclasses import asdict
from pathlib import Path

import pytest

from tests.datasheet.sheets import GERMAN, INDUSTRIAL, SIMPLE, of, write_all
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import StudyError
from vsgdesign.study.datasheet import FIELDS, read_sheet, resolve, study_text
from vsgdesign.study.parameters import study_from_text


def test_a_german_spreadsheet_is_read_like_an_english_one(tmp_path: Path) -> None:
    """The same rows in Windows-1252, as older spreadsheets write them, and with a point for the comma."""
    old = tmp_path / "old.csv"
    old.write_bytes(GERMAN.replace("Ω", "ohm").encode("cp1252"))
    english = tmp_path / "english.csv"
    english.write_text(GERMAN.replace(",", "."), encoding="utf-8")
    first, second = (asdict(resolve(read_sheet(path))) for path in (old, english))
    assert "Windows-1252" in first.pop("assumptions")[0]["text"]
    second.pop("assumptions")
    assert first == second


def test_columns_and_separators_do_not_matter(tmp_path: Path) -> None:
    texts = {
        "tabs.csv": INDUSTRIAL.replace(",", "\t"),
        "semicolons.csv": INDUSTRIAL.replace(",", ";"),
        "bars.csv": INDUSTRIAL.replace(",", "|"),
        "no_header.csv": INDUSTRIAL.partition("\n")[2],
        "mac.csv": INDUSTRIAL.replace("\n", "\r\n"),
        "comments.csv": "# a comment\n\n" + INDUSTRIAL,
        "sections.csv": INDUSTRIAL.replace("L1,", "Filter,,\nL1,"),
        "swapped.csv": "\n".join(
            ",".join([*line.split(",")[1:], line.split(",")[0]]) for line in INDUSTRIAL.split("\n") if line
        ).replace("Value,Unit,Parameter", "Value,Unit,Parameter"),
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8", newline="")
    expected = asdict(resolve(read_sheet(write_all(tmp_path)["industrial"])))
    for name in texts:
        assert asdict(resolve(read_sheet(tmp_path / name))) == expected, name


def test_one_converter_a_row(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    path.write_text(";".join(SIMPLE) + "\n" + ";".join(SIMPLE.values()) + "\n", encoding="utf-8")
    assert asdict(resolve(read_sheet(path))) == asdict(of())


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"\xef\xbb\xbf  \r\n", "is empty"),
        (b"\x00\x01\x02" * 50, "is not text"),
        (bytes(range(128, 256)) * 20, "is not text"),
        (b"PK\x03\x04" + b"x" * 99, "spreadsheet"),
        (b"hello\nworld\n", "no line has two columns"),
        (b"a,b\n" * 300_000, r"it has 1\.2 MB, and the limit of its kind is 1 MB"),
        (b"Rating,12,5 kVA\nVoltage,400,V\n", "a comma between columns and in a number"),
        (b"\xff\xfe\x00", "is not text"),
    ],
)
def test_files_that_are_no_datasheet(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "sheet.csv"
    path.write_bytes(content)
    with pytest.raises(StudyError, match=said):
        read_sheet(path)


def test_paths_that_are_no_file(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="is a folder"):
        read_sheet(tmp_path)
    with pytest.raises(StudyError, match="there is no such file"):
        read_sheet(tmp_path / "absent.csv")
    broken = tmp_path / "broken.toml"
    broken.write_text("rating = = 5")
    with pytest.raises(StudyError, match="cannot be read as TOML"):
        read_sheet(broken)


def test_no_datasheet_ends_in_a_traceback(tmp_path: Path) -> None:
    """Rows of odd names, values and units: a converter that the study reader takes, or faults."""
    rng = random.Random(3)
    keys = ["foo", "", "#", *(alias.partition(" > ")[0] for field in FIELDS for alias in (field.name, *field.aliases))]
    values = (
        "1", "12,5", "1.250", "1,250", "-3", "0", "1e999", "nan", "1.5-20", "20 - 1.5", "[1]", "3x", "±", "1...",
        "...2", "a to b", "\u202f", "٣ V", "1/2", "480Y/277", "0/0", "1.2.3", "∞", "--1", "1 - -2", "Δ", "twice",
        "9" * 400, ".",
    )  # fmt: skip
    units = ("", "V", "kVA", "mH", "uF", "%", "pu", "A rms", "A", "Ω", "s", "L-L", "delta", "kvar", "xx", "m", "(V)")
    complete = ("rating", "voltage", "frequency", "dc_link", "carrier", "L_1", "C")
    path, read = tmp_path / "odd.csv", 0
    for _ in range(150):
        rows = [[key, str(SIMPLE[key])] for key in complete if rng.random() < 0.97]
        rows += [[rng.choice(keys), rng.choice(values) + rng.choice(units), rng.choice(units)]]
        separator = rng.choice(";\t")
        path.write_text("\n".join(separator.join(row) for row in rows), encoding="utf-8")
        try:
            text = study_text(resolve(read_sheet(path)), "odd.csv")
        except StudyError:
            continue
        read += 1
        study_from_text(text, inner_loops=lambda _: (InnerLoopGains(*[math.nan] * 4), math.nan))
    assert 3 < read < 147
