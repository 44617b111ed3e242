"""From a specification to gains: closed forms, optimised gain tables, fixed tunings and designed inner loops."""

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
