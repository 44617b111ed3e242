"""Whole paths: study in, folder of evidence out."""

from vsgdesign.pipeline.margins import StabilityResult, assess_study, report_stability, stability_document
from vsgdesign.pipeline.run import results_document, run_study

__all__ = [
    "StabilityResult",
    "assess_study",
    "report_stability",
    "results_document",
    "run_study",
    "stability_document",
]
