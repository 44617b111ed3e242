"""The registry of what is measured in a test: every name that a criterion of a suite may ask for."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from vsgdesign.compliance.measured.currents import CURRENTS
from vsgdesign.compliance.measured.extremes import EXTREMES
from vsgdesign.compliance.measured.recovery import RECOVERY
from vsgdesign.compliance.measuring import Measure, Measured, MeasureInput, Parameter, Ratings

__all__ = ["MEASURES", "Measure", "MeasureInput", "Measured", "Parameter", "Ratings"]

MEASURES: Mapping[str, Measure] = MappingProxyType({found.name: found for found in (*RECOVERY, *CURRENTS, *EXTREMES)})
"""By name, in the order of tables."""
