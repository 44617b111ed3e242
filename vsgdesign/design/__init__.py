"""From a specification to gains: closed forms, optimised gain tables, fixed tunings and designed inner loops."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from vsgdesign.certificate import Certificate, Counterexample, Region
from vsgdesign.design.study_design import ClosedFormDesign, design_closed_form, distinct_grids

if TYPE_CHECKING:
    from vsgdesign.certificate import certify


def __getattr__(name: str) -> Any:
    """``certify`` is imported when it is first used: Numba takes long to load."""
    if name != "certify":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from vsgdesign.certificate import certify

    return certify


__all__ = [
    "Certificate",
    "ClosedFormDesign",
    "Counterexample",
    "Region",
    "certify",
    "design_closed_form",
    "distinct_grids",
]
