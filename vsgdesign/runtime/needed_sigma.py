"""How certain an estimate must be for a schedule to follow it fully, as numbers and as a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.table_text import error_text
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime.error_set import ErrorSet, error_set_of
from vsgdesign.runtime.guards import SchedulerSettings, settings_of

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable

Array = NDArray[np.float64]


class NeededSigma(NamedTuple):
    """The certainty with which an estimate is followed fully on every grid of a schedule."""

    sigma: float
    """Relative standard deviation of Z (:eq:`needed-sigma`), the smallest over X/R."""
    x_over_r: float
    """The X/R that needs it."""
    errors: ErrorSet
    """The errors for which the gains are designed."""

    @property
    def text(self) -> str:
        """The same as a sentence."""
        R, X, Z = (round(error, 6) for error in self.errors)  # as given: the settings hold what float32 can
        known = f"R and X known {error_text(R, Z)}"
        if R != X:
            known = f"R known {error_text(R, Z)}, and X {error_text(X, Z)}"
        return (
            "An estimate is followed fully on every grid if its relative standard deviation of Z is at most "
            f"{100.0 * self.sigma:.2g} % (X/R {self.x_over_r:.3g} needs it), and in part otherwise: the gains are for "
            f"{known}."
        )


def needed_sigma(settings: SchedulerSettings, x_over_r: Sequence[float] = ()) -> NeededSigma:
    """The smallest over the box of a scheduler: over the X/R of its table's nodes, and over the limits of the box."""
    errors, low, high = settings.error_set, 1.0 / settings.r_over_x[1], 1.0 / settings.r_over_x[0]
    ratios = sorted({min(max(float(ratio), low), high) for ratio in (*x_over_r, low, high)})
    sigma, at = min((errors.needed_sigma(1.0, ratio), ratio) for ratio in ratios)
    return NeededSigma(sigma, at, errors)


def needed_sigma_of(table: GainTable) -> NeededSigma:
    """The smallest over a table, as its scheduler has it. Raises ArtifactError if the scheduler's box is empty."""
    return needed_sigma(settings_of(table), table.x_over_r.tolist())


def needed_sigmas(table: GainTable) -> Array:
    """The relative standard deviation of Z that each node (n SCR, m X/R) of a table needs; NaN at nodes outside.

    It depends on X/R alone.
    """
    errors = error_set_of(table)
    row = np.array([errors.needed_sigma(1.0, float(ratio)) for ratio in table.x_over_r])
    return np.where(table.valid, row, np.nan)


def needed_sigma_text(table: GainTable) -> str:
    """The sentence for a table. It says if the errors are assumed, because the table was designed for exact estimates,
    and if no scheduler can have the table."""
    try:
        text = needed_sigma_of(table).text
    except ArtifactError as error:
        return f"No scheduler can take this table. {error}"
    box, validity = table.specification.get("box"), table.validity
    asked = [box.get(f"error_{name}") for name in "RXZ"] if isinstance(box, dict) else []
    given = any((*asked, validity.error, validity.error_Z))
    return text if given else f"{text} (These errors are assumed: the table was designed for exact estimates.)"
