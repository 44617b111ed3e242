"""Random runs for the field estimator: what a seed gives, and that it can be run."""

from __future__ import annotations

import dataclasses

import pytest

from evidence._field_converters import (
    CONVERTERS,
    ROOM_PU,
    after,
    converter_named,
    references,
    rest_at,
    resting_currents,
)
from evidence._field_draws import GROUPS, LEAST_CURRENT_PU, LEAST_RATIO, field_draw
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import NoOperatingPointError


@pytest.fixture(scope="module", params=CONVERTERS)
def converter(request: pytest.FixtureRequest):
    return converter_named(request.param)


def test_a_seed_is_a_draw_for_ever(converter) -> None:
    for group in GROUPS:
        one = field_draw(converter, group, 7)
        assert one == field_draw(converter_named(converter.name), group, 7)
        assert one != field_draw(converter, group, 8)
        assert one.duration_s > max(one.events_s, default=0.0) + 1.0


def test_what_is_drawn_rests_where_it_says(converter) -> None:
    c = converter.study.converter
    for seed in range(20):
        draw = field_draw(converter, "jump and step", seed)
        P_ref, Q_ref = references(converter, draw.start)
        point = rest_at(converter, draw.start, P_ref, Q_ref)
        assert point.P / c.S_rated == pytest.approx(draw.start.P_pu)
        assert point.Q / c.S_rated == pytest.approx(draw.start.Q_pu)
        currents = resting_currents(converter, draw.start, draw.changes)
        assert currents is not None
        assert min(currents) >= LEAST_CURRENT_PU
        assert max(currents) <= ROOM_PU
        (change,) = draw.changes
        ratio = draw.start.scr / after(draw.start, change).scr
        assert max(ratio, 1.0 / ratio) >= LEAST_RATIO


def test_the_current_is_that_of_the_whole_bridge(converter) -> None:
    """Without a load the bridge feeds the capacitor alone."""
    c = converter.study.converter
    start = dataclasses.replace(field_draw(converter, "rest", 1).start, P_pu=0.0, Q_pu=0.0, V_g_pu=1.0, df_hz=0.0)
    currents = resting_currents(converter, start, ())
    assert currents is not None
    assert currents[0] * c.I_rated_pk == pytest.approx(
        c.omega_n * converter.study.filter.C * rms_to_peak(c.V_rated_rms)
    )


def test_a_grid_that_cannot_carry_it_is_no_draw(converter) -> None:
    start = dataclasses.replace(field_draw(converter, "rest", 1).start, scr=1.2, x_over_r=10.0, P_pu=2.0)
    assert resting_currents(converter, start, ()) is None
    with pytest.raises(NoOperatingPointError):
        references(converter, start)
