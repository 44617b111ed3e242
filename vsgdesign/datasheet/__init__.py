"""From a one-page datasheet to a study: reading, resolving, writing. This room designs and simulates nothing."""

from vsgdesign.datasheet.fields import FIELDS, Field
from vsgdesign.datasheet.reading import Entry, Sheet, read_sheet
from vsgdesign.datasheet.resolving import Datasheet, faults_of, resolve
from vsgdesign.datasheet.rows import Assumption
from vsgdesign.datasheet.study_text import study_text

__all__ = [
    "FIELDS",
    "Assumption",
    "Datasheet",
    "Entry",
    "Field",
    "Sheet",
    "faults_of",
    "read_sheet",
    "resolve",
    "study_text",
]
