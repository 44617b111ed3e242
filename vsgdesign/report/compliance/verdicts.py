"""How the five verdicts look and how they are counted: each has a sign and a word besides its colour."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from vsgdesign.compliance.rows import FAIL, IMPOSSIBLE, INFORMATIONAL, NOT_APPLICABLE, PASS, VERDICTS


@dataclass(frozen=True)
class Look:
    """Sign, class of the page's style, colour of words and of areas, and what the verdict says."""

    sign: str
    style: str
    colour: str
    fill: str
    says: str


LOOKS: Mapping[str, Look] = {
    PASS: Look("✓", "pass", "#00577F", "#8FB8D0", "everything that was asked for is kept"),
    FAIL: Look("✗", "fail", "#A33B00", "#E8A077", "something that was asked for is not kept, or not known"),
    INFORMATIONAL: Look("i", "info", "#444444", "#DDDDDD", "measured, nothing was asked for; this is not a pass"),
    NOT_APPLICABLE: Look("–", "none", "#666666", "#FFFFFF", "the test does not apply to this converter"),
    IMPOSSIBLE: Look("⊘", "never", "#333333", "#777777", "no converter with this current limit can do it"),
}
"""The look of each verdict. All colours of words keep a contrast of 4.5 to 1 on white."""


@dataclass(frozen=True)
class Counts:
    """How many rows have each verdict."""

    of: Mapping[str, int]

    @property
    def judged(self) -> int:
        """Rows of which something was asked that is possible."""
        return self.of[PASS] + self.of[FAIL]

    @property
    def total(self) -> int:
        """All rows."""
        return sum(self.of.values())

    def words(self, verdicts: Iterable[str] = VERDICTS) -> str:
        """Counts that are not zero, in words: ``12 informational, 1 impossible``."""
        return ", ".join(f"{self.of[verdict]} {verdict}" for verdict in verdicts if self.of[verdict])


def counted(rows: Iterable[Mapping[str, Any]]) -> Counts:
    """Counts of rows of a document."""
    found: dict[str, int] = dict.fromkeys(VERDICTS, 0)
    for row in rows:
        found[row["verdict"]] += 1
    return Counts(found)
