"""The table of events that runs of a converter and of a plant share: no figure beside a reason why there is none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vsgdesign.metrics.events import EndState, EventWindow, measure_event
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.plant import steps

T_S, TAU = 1e-3, 0.1
PLANT = SimpleNamespace(units=(SimpleNamespace(name="first"),))


@pytest.mark.parametrize(("slowest", "settles"), [(1.0 / TAU, "0.391 s"), (0.5, "too short")])
def test_a_settling_time_stands_only_where_the_window_is_long_enough(slowest: float, settles: str) -> None:
    """1 − e^(−t/τ) is within 2 % from τ ln 50 = 0.391 s on. In a window of 1 s, a mode of 0.5 1/s may still come."""
    t = np.arange(0.0, 2.0, T_S)
    y = 1000.0 * np.where(t < 1.0, 0.0, -np.expm1(-np.maximum(t - 1.0, 0.0) / TAU))
    window, end = EventWindow("P_ref", 1.0, 2.0, steps_signal=True), EndState(final=1000.0, decay=slowest)
    event = measure_event(window, "P_pcc", t, y, 1000.0, 1, end)
    unit = SimpleNamespace(events=(event,))
    one, study = SimpleNamespace(spec=SimpleNamespace(name="vsg"), units=(unit,)), SimpleNamespace(plant=PLANT)
    result: Any = SimpleNamespace(controllers=(one,), study=study)
    (table,) = steps(result)
    assert isinstance(table, Table)
    (row,) = table.rows
    assert (row[0], row[5]) == ("first", settles)
    assert (table.notes == ()) == (settles != "too short")
