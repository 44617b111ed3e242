"""Disturbances through the EMT: cases as data, a set of them, one run with its verdict, many runs."""

from vsgdesign.simulation.survival.cases import (
    FOR_EVER,
    GridKnowledge,
    GridState,
    SurvivalCase,
    field_cases,
)
from vsgdesign.simulation.survival.running import CaseResult, CaseRun, Subject, rest_of, run_case, trace_case
from vsgdesign.simulation.survival.sets import dc_set, fixed_set, plant_set, random_set
from vsgdesign.simulation.survival.verdicts import (
    ClearingTimes,
    SurvivalFigures,
    Verdicts,
    by_group,
    critical_clearing_times,
    figures_of,
)

__all__ = [
    "FOR_EVER",
    "CaseResult",
    "CaseRun",
    "ClearingTimes",
    "GridKnowledge",
    "GridState",
    "Subject",
    "SurvivalCase",
    "SurvivalFigures",
    "Verdicts",
    "by_group",
    "critical_clearing_times",
    "dc_set",
    "field_cases",
    "figures_of",
    "fixed_set",
    "plant_set",
    "random_set",
    "rest_of",
    "run_case",
    "trace_case",
]
