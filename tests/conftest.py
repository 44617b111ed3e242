"""For every test."""

from __future__ import annotations

import os
import signal
from collections.abc import Generator
from typing import Any

import pytest
from hypothesis import settings

# The same examples in every run, and no deadline: a machine that is busy is no fault of the code.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# A shell that starts a job in the background makes it ignore SIGINT, and every process of it: tests of interruptions
# would wait for nothing.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


NO_SKIPS = bool(os.environ.get("VSGDESIGN_NO_SKIPS"))
"""Set where everything is installed that a test may want, as in continuous integration: a skip is then a failure."""


def fail_what_was_skipped(report: pytest.TestReport | pytest.CollectReport) -> None:
    """What was skipped failed: a program or package that is wanted is missing."""
    if NO_SKIPS and report.outcome == "skipped" and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"skipped, and VSGDESIGN_NO_SKIPS is set: {report.longreprtext}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    report = yield
    fail_what_was_skipped(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, Any, Any]:
    report = yield
    fail_what_was_skipped(report)
    return report
