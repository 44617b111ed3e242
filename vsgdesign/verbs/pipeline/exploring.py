"""A session of the explorer from what a user gives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import Fault, StudyError
from vsgdesign.report.explore.session import Session, start_of
from vsgdesign.report.explore.state import StateError
from vsgdesign.study.parameters.study import Study


def session_from(study: Study, ready: Ready, start: Mapping[str, Any] | str | None = None, **told: Any) -> Session:
    """A session that begins with a state: what differs from that of the study, or a link of the page. ``told`` is what
    else a session is told. Raises StudyError for a wrong state."""
    try:
        begins = start_of(start, study) if isinstance(start, str) else start
        return Session(study, ready, start=begins, **told)
    except StateError as error:
        faults = [Fault(str(one["field"]), "", one["text"].rstrip(".")) for one in error.faults]
        raise StudyError("--state" if isinstance(start, str) else "the state", faults) from None
