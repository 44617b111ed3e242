"""The colours of controllers on the page: Okabe and Ito's palette, which people with a colour-vision deficiency can
tell apart.
"""

from __future__ import annotations

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#777777")
"""As in the figures of the report (:data:`vsgdesign.report.drawing.style.COLOURS`), without the black of the text."""


def colour_of(index: int) -> str:
    """The colour of a controller by its place in the study."""
    return COLOURS[index % len(COLOURS)]


OWN_COLOUR = "#000000"
"""Of gains that the user gives by hand."""
