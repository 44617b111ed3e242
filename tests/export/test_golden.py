"""The generated C of one table is kept in the repository: a review sees what a change of an equation does to it."""

from __future__ import annotations

import difflib

from tests.export.golden.__main__ import PLACE, text


def test_the_generated_text_is_the_one_that_was_reviewed() -> None:
    kept, made = PLACE.read_text(encoding="ascii").splitlines(), text().splitlines()
    changed = "\n".join(difflib.unified_diff(kept, made, "reviewed", "generated", lineterm="", n=1))
    assert not changed, f"look at the changes, then: python -m tests.export.golden\n{changed}"
