"""How often an estimate is inside a gain table's error set: one sentence and one map."""

from __future__ import annotations

import numpy as np

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.measured_errors import MeasuredErrors
from vsgdesign.artifacts.table_text import certificate_failed, error_text
from vsgdesign.errors import counted
from vsgdesign.linear.stability.safe_place import SETTLED, InsideSet, inside_set
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.quantities import plain

PART = 5
"""Of the page: the certificate's."""

_ASKED_PCT = 95.0


def inside_sentence(table: GainTable, measured: MeasuredErrors | None) -> str:
    """How often the estimate that was measured is inside the table's error set, at rest and after a jump; or why that
    is not known."""
    v = table.validity
    proved = table.certificate is not None and not certificate_failed(table.certificate)
    name = "certified set" if proved else "set that the table was designed for"
    if v.error == v.error_Z == 0.0:
        return "The table was designed for an exact estimate: no estimate is inside its error set."
    if measured is None:
        return f"How often an estimate is inside the {name} is not known: no errors were measured."
    found = inside_set(table, measured)
    of = f"the estimator {measured.estimator} ({counted(measured.runs, 'run')}: {measured.background})"
    if found.worst is None:
        return f"How often the estimate is inside the {name} is not known: {of} was not measured on its grids."
    i, j = found.worst
    at = f"SCR {plain(float(table.scr[i]))}, X/R {plain(float(table.x_over_r[j]))}"
    text = (
        f"The estimate is inside the {name} (R and X known {error_text(v.error, v.error_Z)}) at least "
        f"{_percent(found.shares[i, j])} of the time at rest (worst node: {at}, "
        f"{counted(int(found.answers[i, j]), 'answer')}){_since(found)}. Measured with {of}."
    )
    missing = int((table.valid & ~np.isfinite(found.shares)).sum())
    if missing:
        text += f" At {counted(missing, 'node')} nothing was measured: there it is not known."
    return text


def _since(found: InsideSet) -> str:
    if not found.since:
        return ""
    jumps = f"of {counted(found.jumps, 'jump')} of the grid"
    if found.settled_s is None:
        last, share = found.since[-1]
        return f"; after {plain(last)} s it is inside for {_percent(share)} {jumps}"
    return f", and from {plain(found.settled_s, 2)} s after a jump ({plain(100.0 * SETTLED)} % {jumps})"


def _percent(share: float) -> str:
    """Rounded down: a share that is not whole is not called so."""
    return f"{plain(np.floor(1000.0 * share + 1e-9) / 10.0)} %"


def inside_figure(table: GainTable, measured: MeasuredErrors | None) -> NamedFigure | None:
    """A map of the share of the time at rest; None where nothing was measured on the table's grids."""
    # Matplotlib is loaded for the map alone: the sentence is part of what every verb about a table prints.
    from vsgdesign.report.drawing.look import Cells, Scale
    from vsgdesign.report.drawing.panels import Frame, Panel, map_figure
    from vsgdesign.report.gain_table.maps import scr_label

    if measured is None or (table.validity.error == table.validity.error_Z == 0.0):
        return None
    found = inside_set(table, measured)
    if found.worst is None:
        return None
    values = 100.0 * found.shares
    nowhere = np.zeros(table.shape, dtype=np.bool_)
    cells = Cells(
        x=table.scr, y=table.x_over_r, values=values, unstable=nowhere, missing=np.isnan(values), partial=nowhere
    )
    low = min(float(np.nanmin(values)), 90.0)
    scale = Scale(low, 100.0, _ASKED_PCT, True, False, (0.0, 20.0, 40.0, 60.0, 80.0, 90.0, 95.0, 98.0, 100.0))
    caption = (
        "How to read: the share of the time at rest for which the measured estimate of a grid is inside the error set "
        f"of the table, R and X known {error_text(table.validity.error, table.validity.error_Z)}. A node has the worst "
        "of the ranges of grids that it lies in. Crosses: nothing was measured there."
    )
    frame = Frame(
        "table_inside",
        "How often the estimate is inside the error set",
        caption,
        scr_label(table),
        "X/R [1]",
        "Inside at rest [% of the time]",
        PART,
        gate_label=f"at least {_ASKED_PCT:g} % of the time",
        missing_label="not known: not measured",
    )
    return map_figure(frame, [[Panel("", cells)]], scale)
