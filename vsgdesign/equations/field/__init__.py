"""The field estimator: the grid's impedance from the converter's own signals and a small probe, nothing else.

Plain scalar recursions without a buffer of samples, written once for Python, the simulation and C:
:func:`probe_value` and :func:`listen` run with every sample, :func:`conclude` once per cycle, then :func:`features` if
a network follows.
docs/theory/field-estimator.md derives them.
"""

from vsgdesign.equations.field.cycle import conclude
from vsgdesign.equations.field.data import DOUBT, LEARN, TRACK, FieldAnswer, FieldSettings, LineSums, LockIn
from vsgdesign.equations.field.fusion import FieldFeatures, features
from vsgdesign.equations.field.lock_in import first_lock_in, listen, probe_value
from vsgdesign.equations.field.state import FieldTrack, first_track

__all__ = [
    "DOUBT",
    "LEARN",
    "TRACK",
    "FieldAnswer",
    "FieldFeatures",
    "FieldSettings",
    "FieldTrack",
    "LineSums",
    "LockIn",
    "conclude",
    "features",
    "first_lock_in",
    "first_track",
    "listen",
    "probe_value",
]
