"""The registry of what is measured in a test: every name that a criterion of a suite may ask for."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from vsgdesign.campaigns.compliance.measured_faults import FAULTS
from vsgdesign.campaigns.compliance.measured_frequency import FREQUENCY, OSCILLATIONS
from vsgdesign.campaigns.compliance.measured_responses import CURRENTS, EXTREMES, RECOVERY, RESPONSES
from vsgdesign.campaigns.compliance.measuring import Measure, Measured, MeasureInput, Parameter, Ratings

__all__ = ["MEASURES", "Measure", "MeasureInput", "Measured", "Parameter", "Ratings"]

_ALL = (*RECOVERY, *CURRENTS, *RESPONSES, *FREQUENCY, *OSCILLATIONS, *FAULTS, *EXTREMES)

MEASURES: Mapping[str, Measure] = MappingProxyType({found.name: found for found in _ALL})
"""By name, in the order of tables."""
