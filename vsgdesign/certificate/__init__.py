"""A proof over a region of grids, operating points and estimate errors, or a counterexample."""

from vsgdesign.certificate.certify import certify, largest_rate, region_of
from vsgdesign.certificate.region import MeasuredSchedule, Region
from vsgdesign.certificate.results import Certificate, Counterexample, Gap, NoFunctionError, Trajectory, refusal_record
from vsgdesign.certificate.steps import certified_steps, with_steps

__all__ = [
    "Certificate",
    "Counterexample",
    "Gap",
    "MeasuredSchedule",
    "NoFunctionError",
    "Region",
    "Trajectory",
    "certified_steps",
    "certify",
    "largest_rate",
    "refusal_record",
    "region_of",
    "with_steps",
]
