"""Whole paths from a study to a folder of results. Names are imported when they are first used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vsgdesign.verbs.pipeline.making import make_ready
    from vsgdesign.verbs.pipeline.margins import StabilityResult, assess_study, report_stability, stability_document
    from vsgdesign.verbs.pipeline.opening import open_study
    from vsgdesign.verbs.pipeline.results import results_document
    from vsgdesign.verbs.pipeline.run import run_study

_HOMES = {
    "StabilityResult": "margins",
    "assess_study": "margins",
    "make_ready": "making",
    "open_study": "opening",
    "report_stability": "margins",
    "results_document": "results",
    "run_study": "run",
    "stability_document": "margins",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


__all__ = [
    "StabilityResult",
    "assess_study",
    "make_ready",
    "open_study",
    "report_stability",
    "results_document",
    "run_study",
    "stability_document",
]
