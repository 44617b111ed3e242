"""Disturbances through the EMT: cases as data, one run with its verdict, many of them."""

from vsgdesign.simulation.survival.cases import (
    FOR_EVER,
    Change,
    GridKnowledge,
    GridState,
    SurvivalCase,
    case_from_document,
)
from vsgdesign.simulation.survival.late import LateSchedule
from vsgdesign.simulation.survival.running import CaseResult, CaseRun, Subject, rest_of, run_case, trace_case

__all__ = [
    "FOR_EVER",
    "CaseResult",
    "CaseRun",
    "Change",
    "GridKnowledge",
    "GridState",
    "LateSchedule",
    "Subject",
    "SurvivalCase",
    "case_from_document",
    "rest_of",
    "run_case",
    "trace_case",
]
