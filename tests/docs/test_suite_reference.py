"""docs/how-to/comply.md against the reader of suites: every field, both ways."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vsgdesign.campaigns.compliance.applies import NEEDS
from vsgdesign.campaigns.compliance.envelopes import ENVELOPES
from vsgdesign.campaigns.compliance.reading import suite_from_text
from vsgdesign.errors import StudyError

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "comply.md"
TEXT = PAGE.read_text(encoding="utf-8")

EVERYWHERE_UNKNOWN = """
qqqqqqqqqq = 1
[[tests]]
qqqqqqqqqq = 1
name = "one"
scr = 1
x_over_r = 1
events = [{ qqqqqqqqqq = 1, P_pu = 0 }]
criteria = [{ measure = "survived", qqqqqqqqqq = 1 }]
"""


def known_fields() -> dict[str, set[str]]:
    """The fields that the reader knows of each table, as it tells them to a user who gives another."""
    with pytest.raises(StudyError) as caught:
        suite_from_text(EVERYWHERE_UNKNOWN)
    return {
        fault.field.rpartition(".")[0]: set(fault.advice.partition(": ")[2].split(", "))
        for fault in caught.value.faults
    }


def documented(heading: str) -> set[str]:
    """The names in the first column of the table under a heading."""
    section = TEXT.split(f"\n### {heading}\n")[1].split("\n#")[0]
    cells = re.findall(r"^\| (`[^|]*) \|", section, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize(
    ("heading", "table"),
    [
        ("At the top of the file", ""),
        ("A test", "tests[0]"),
        ("An event", "tests[0].events[0]"),
        ("A criterion", "tests[0].criteria[0]"),
    ],
)
def test_every_field_is_documented(heading: str, table: str) -> None:
    assert documented(heading) == known_fields()[table] - {"qqqqqqqqqq"}


def test_every_envelope_and_need_is_named() -> None:
    for name in (*ENVELOPES, *NEEDS):
        assert f"`{name}`" in TEXT, name
