"""Where everything is installed, a skipped test is a failure (continuous integration sets VSGDESIGN_NO_SKIPS)."""

from __future__ import annotations

from typing import Any

import pytest

from tests import conftest


def report(outcome: Any, **more: Any) -> pytest.TestReport:
    where = ("tests/test_a.py", 1, "Skipped: gcc is not installed")
    made = pytest.TestReport("tests/test_a.py::test", where, {}, "passed", where, "call", **more)
    made.outcome = outcome
    return made


@pytest.mark.parametrize(("wanted", "outcome"), [(True, "failed"), (False, "skipped")])
def test_a_skip_fails_where_none_is_allowed(wanted: bool, outcome: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conftest, "NO_SKIPS", wanted)
    made = report("skipped")
    conftest.fail_what_was_skipped(made)
    assert made.outcome == outcome
    assert "gcc is not installed" in made.longreprtext


def test_other_outcomes_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conftest, "NO_SKIPS", True)
    for made in (report("passed"), report("skipped", wasxfail="a known fault")):
        before = made.outcome
        conftest.fail_what_was_skipped(made)
        assert made.outcome == before
