"""From a one-page datasheet to a study: reading, resolving, writing. This room designs and simulates nothing."""

from vsgdesign.study.datasheet.fields import FIELDS, Field
from vsgdesign.study.datasheet.measured_impedance import SeriesFit, fit_series, read_impedance, with_impedance
from vsgdesign.study.datasheet.reading import Assumption, Entry, Sheet, read_sheet
from vsgdesign.study.datasheet.resolving import Datasheet, faults_of, resolve
from vsgdesign.study.datasheet.study_text import study_text

__all__ = [
    "FIELDS",
    "Assumption",
    "Datasheet",
    "Entry",
    "Field",
    "SeriesFit",
    "Sheet",
    "faults_of",
    "fit_series",
    "read_impedance",
    "read_sheet",
    "resolve",
    "study_text",
    "with_impedance",
]
