"""Inner loops from a datasheet: gains for a converter, its filter and a box of grids, with what they keep."""

from vsgdesign.design.inner.designing import (
    Alternative,
    FullOrderCheck,
    InnerDesign,
    check_apart,
    check_full_order,
    design_inner_loops,
    what_would_help,
)
from vsgdesign.design.inner.grids import GridBox
from vsgdesign.design.inner.passivity import PassiveBand, passive_band
from vsgdesign.design.inner.promises import PROMISES, InnerScore, PromiseReached, Promises, Targets, score_inner_loops

__all__ = [
    "PROMISES",
    "Alternative",
    "FullOrderCheck",
    "GridBox",
    "InnerDesign",
    "InnerScore",
    "PassiveBand",
    "PromiseReached",
    "Promises",
    "Targets",
    "check_apart",
    "check_full_order",
    "design_inner_loops",
    "passive_band",
    "score_inner_loops",
    "what_would_help",
]
