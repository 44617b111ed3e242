"""The errors of an estimate for which a schedule is designed, against the 95 % set of an estimate with a covariance.

See :doc:`docs/theory/runtime.md`, "An estimate that knows its error".
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

from vsgdesign.equations.estimate_guards import CHI_SQUARE_95
from vsgdesign.equations.grid import error_half_widths
from vsgdesign.runtime.schedule import on_floats

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable

_half_widths = on_floats(error_half_widths)


class ErrorSet(NamedTuple):
    """Errors of R̂ and X̂ that a schedule is designed for: each may be off by its share, or by a share of \\|Z\\|,
    whichever is larger, in either direction (:eq:`error-set`)."""

    error_R: float
    error_X: float
    error_Z: float

    def half_widths(self, R: float, X: float) -> tuple[float, float]:
        """Half-widths in R and in X at the impedance R + jX, in its unit (:eq:`error-set`)."""
        return _half_widths(R, X, *self)

    def needed_sigma(self, R: float, X: float) -> float:
        """The largest relative standard deviation of Z with which an estimate is followed fully (:eq:`needed-sigma`).

        It is √(var R + var X)/\\|Z\\| of an estimate whose R and X are equally uncertain.
        """
        return sqrt(2.0 / CHI_SQUARE_95) * min(self.half_widths(R, X)) / hypot(R, X)

    def faults(self) -> Iterator[str]:
        """What is wrong with the three numbers, in words."""
        for name, value in self._asdict().items():
            if not 0.0 <= value < 1.0:
                yield f"{name} = {value:g}: must be a share from 0 to below 1"
        if not min(max(self.error_R, self.error_Z), max(self.error_X, self.error_Z)) > 0.0:
            yield (
                f"error_R = {self.error_R:g}, error_X = {self.error_X:g}, error_Z = {self.error_Z:g}: no estimate "
                "would ever fit; give error_Z, or error_R and error_X"
            )


NOT_DESIGNED = ErrorSet(0.2, 0.2, 0.05)
"""What is taken for a schedule that was designed for exact estimates or for errors that nobody knows."""


def error_shares(table: GainTable) -> ErrorSet:
    """The errors that a table is made for: from its specification, or from its validity where the specification has
    none. All may be zero."""
    box = table.specification.get("box")
    box = box if isinstance(box, dict) else {}
    error = table.validity.error
    return ErrorSet(
        _share(box.get("error_R", error)),
        _share(box.get("error_X", error)),
        _share(box.get("error_Z", table.validity.error_Z)),
    )


def error_set_of(table: GainTable) -> ErrorSet:
    """The error set of a table (:func:`error_shares`).

    Where the table has no error of R (or X) at all, that of ``NOT_DESIGNED`` is taken, because no estimate would ever
    fit a set without width.
    """
    found = error_shares(table)
    if found.error_Z > 0.0:
        return found
    return ErrorSet(found.error_R or NOT_DESIGNED.error_R, found.error_X or NOT_DESIGNED.error_X, 0.0)


def _share(value: Any) -> float:
    return (
        float(value) if isinstance(value, float | int) and not isinstance(value, bool) and 0.0 <= value < 1.0 else 0.0
    )
