"""Sags by their types A to G: the positive and negative sequence of three phase phasors."""

from __future__ import annotations

from vsgdesign.equations.frames import PHASES

_HALF, _THIRD = 0.5, 1.0 / PHASES

SAG_TYPES: dict[str, tuple[float, float]] = {
    "A": (1.0, 0.0),
    "B": (_THIRD, -_THIRD),
    "C": (_HALF, _HALF),
    "D": (_HALF, -_HALF),
    "E": (1.0 - _THIRD, _THIRD),
    "F": (1.0 - _THIRD, -_THIRD),
    "G": (1.0 - _THIRD, _THIRD),
}
"""Shares p and n of each type (:eq:`sag-types`). Without a zero sequence, E and G are the same."""


def sag_sequences(kind: str, V: complex) -> tuple[complex, complex]:
    """Positive and negative sequence of a sag over the voltage before it, as phasors of phase a (:eq:`sag-types`).

    ``kind`` is a name of :data:`SAG_TYPES`, and ``V`` is the characteristic voltage over the voltage before. Phase a is
    the phase of symmetry. The zero sequence is left out: three wires carry none.
    """
    p, n = SAG_TYPES[kind]
    return 1.0 - p * (1.0 - V), n * (1.0 - V)
