"""The data of a stability report, and the names of its files."""

from __future__ import annotations

import re
from dataclasses import dataclass

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.linear.stability.assessment import ControllerAssessment
from vsgdesign.linear.stability.maps import MarginMap
from vsgdesign.linear.stability.modes_of_units import DifferentialWorst
from vsgdesign.linear.stability.verdict import Verdict
from vsgdesign.simulation.evidence import StepEvidence
from vsgdesign.study.parameters.study import Study

MAP_KINDS = ("reduced", "full_order", "stale", "estimate_error")
"""Maps of one controller, as their files name them."""


@dataclass(frozen=True)
class StabilityResult:
    """The data of a stability report. The keys of ``evidence`` are (controller, label of the cell)."""

    study: Study
    assessments: tuple[ControllerAssessment, ...]
    evidence: dict[tuple[str, str], tuple[StepEvidence, StepEvidence]]
    verdicts: tuple[Verdict, ...]
    timing_s: dict[str, float]
    ready: Ready = NOTHING
    """The gain tables that the controllers were assessed with."""
    differential: tuple[DifferentialWorst, ...] = ()
    """Of each controller, where the study is one of several equal units."""
    whole: Study | None = None
    """The study with their plant."""


def slug(label: str) -> str:
    """A label as part of a file name."""
    return re.sub(r"[^A-Za-z0-9.]+", "_", label).strip("_")


def maps_of(a: ControllerAssessment) -> dict[str, MarginMap]:
    """The maps that a controller has, by kind."""
    fields = dict(zip(MAP_KINDS, (a.reduced, a.full_order, a.stale, a.estimate_error), strict=True))
    return {kind: field for kind, field in fields.items() if field is not None}


def map_file(controller: str, kind: str) -> str:
    """File of one map."""
    return f"map_{controller}_{kind}.csv"


def frequency_file(controller: str, label: str) -> str:
    """File of one cell over frequency."""
    return f"frequency_{controller}_{slug(label)}.csv"


def step_file(controller: str, label: str, signal: str) -> str:
    """File of one small step."""
    return f"step_{signal}_{controller}_{slug(label)}.csv"
