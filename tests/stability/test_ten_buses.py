"""The ten-bus plant of nine units of Simplus-Grid-Tool: its data, and the modes that its page states."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.linear.operating_point.rest_of_units import UnitsAtRest, rest_of_units
from vsgdesign.linear.stability.modes_of_units import modes_of_units
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.units import PlantTimeline, plant_timeline
from vsgdesign.simulation.units.start import situation_at
from vsgdesign.study.parameters import Study, load_study

STUDY = Path(__file__).resolve().parents[2] / "studies" / "ten_buses" / "study.toml"
LINES = {
    **dict.fromkeys(("line2_3", "line3_4", "line5_6", "line6_7", "line8_9", "line9_10"), (0.02, 0.1)),
    **dict.fromkeys(("line2_5", "line2_8"), (6e-5, 3e-4)),
}
"""R and X, pu, out of BESS_Plant_10Bus.json; the line from its bus 1 to bus 2 is 0.02 + j0.1, too."""


@functools.cache
def study() -> Study:
    return load_study(STUDY)


@functools.cache
def rest() -> UnitsAtRest:
    """At its start, with the closed form for what each unit sees."""
    timeline: PlantTimeline = plant_timeline(study(), study().controllers[0])
    gains = []
    for own, line in zip(timeline.units, timeline.timelines, strict=True):
        feed = feed_of(own, own.controllers[0], line, NOTHING)
        assert isinstance(feed, tuple | list)
        change: GainChange = feed[0]
        gains.append(change.gains)
    return rest_of_units(situation_at(study(), timeline, timeline.segments[0], gains, range(9)))


def test_its_data_are_those_of_the_toolbox() -> None:
    plant, c, f = study().plant, study().converter, study().filter
    assert plant is not None
    X = {one.name: (one.R / c.Z_base, one.L * c.omega_n / c.Z_base) for one in plant.elements}
    assert set(X) == set(LINES)
    for name, expected in LINES.items():
        assert X[name] == pytest.approx(expected, rel=1e-12)
    grid = study().grid
    assert (grid.R_g / c.Z_base, grid.L_g * c.omega_n / c.Z_base) == pytest.approx((0.02, 0.1), rel=1e-5)
    own = (f.L_1 * c.omega_n, f.R_1, f.L_2 * c.omega_n, f.R_2)
    assert np.array(own) / c.Z_base == pytest.approx([0.05, 0.01, 0.3, 0.06], rel=1e-5)
    assert f.C * c.omega_n * c.Z_base == pytest.approx(0.02, rel=1e-5)
    assert {one.P_ref / c.S_rated for one in plant.units} == {0.15}
    assert len(plant.units) == 9


def test_its_modes_are_those_of_the_page() -> None:
    found = modes_of_units(rest())
    assert len(found) == 153
    assert [one.s for one in found[:2]] == pytest.approx([-3.7596, -3.7601], abs=1e-4)
    assert dict(found[0].units)["unit2"] == pytest.approx(0.669, abs=1e-3)
    assert [one.s for one in found[2:17] if one.s.imag] == []
    assert [found[k].s.real for k in (2, 16)] == pytest.approx([-3.854, -4.564], abs=1e-3)
    slowest = next(one for one in found if one.s.imag)
    assert (slowest.s.real, abs(slowest.s.imag)) == pytest.approx((-4.707, 2.036), abs=1e-3)
    shares = dict(slowest.units)
    assert shares["unit7"] == pytest.approx(0.121, abs=1e-3)
    assert shares["unit2"] == pytest.approx(0.098, abs=1e-3)
    fast = [one.damping for one in found if one.s.imag > 20.0 * math.pi and abs(one.s) < 1e5]
    assert min(fast) == pytest.approx(0.397, abs=2e-3)


def test_two_of_its_strings_are_alike() -> None:
    """Strings 5–6–7 and 8–9–10 may be exchanged, so each mode is the same for both units of a pair, or moves them
    against each other with equal shares."""
    for one in modes_of_units(rest(), 60):
        shares = dict(one.units)
        for first, second in (("unit5", "unit8"), ("unit6", "unit9"), ("unit7", "unit10")):
            assert shares.get(first, 0.0) == pytest.approx(shares.get(second, 0.0), abs=2e-3)
