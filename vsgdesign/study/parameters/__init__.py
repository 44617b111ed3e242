"""The inputs: study files and published cases, as frozen, validated data in SI units."""

from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.loading import case_names, load_study, study_from_text
from vsgdesign.study.parameters.study import ClosedFormTarget, ControllerSpec, Event, SimulationSpec, Study

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
