"""A large-signal statement: a function that falls while the limiter acts, and from where the swing returns."""

from vsgdesign.certificate.swing.conditions import SwingLaw
from vsgdesign.certificate.swing.statement import (
    SwingPart,
    SwingPoint,
    SwingStart,
    SwingStatement,
    large_signal,
    swing_law,
    swing_statement,
)

__all__ = [
    "SwingLaw",
    "SwingPart",
    "SwingPoint",
    "SwingStart",
    "SwingStatement",
    "large_signal",
    "swing_law",
    "swing_statement",
]
