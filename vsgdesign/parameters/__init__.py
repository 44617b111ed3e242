"""The inputs: study files and published cases, as frozen, validated data in SI units."""

from vsgdesign.parameters.loading import case_names, load_study, study_from_text
from vsgdesign.parameters.study import (
    ClosedFormTarget,
    ControllerSpec,
    Converter,
    Event,
    Filter,
    Grid,
    GridSource,
    SimulationSpec,
    Study,
)

__all__ = [
    "ClosedFormTarget",
    "ControllerSpec",
    "Converter",
    "Event",
    "Filter",
    "Grid",
    "GridSource",
    "SimulationSpec",
    "Study",
    "case_names",
    "load_study",
    "study_from_text",
]
