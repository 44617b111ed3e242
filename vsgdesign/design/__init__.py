"""Specification to gains: in closed form today, with a certificate over a region."""

from vsgdesign.certificate import Certificate, Counterexample, Region, certify
from vsgdesign.design.closed_form import ClosedFormDesign, design_closed_form, distinct_grids

__all__ = [
    "Certificate",
    "ClosedFormDesign",
    "Counterexample",
    "Region",
    "certify",
    "design_closed_form",
    "distinct_grids",
]
