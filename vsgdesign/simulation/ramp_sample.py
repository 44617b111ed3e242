"""One interval of a run whose source is on a ramp of its voltage or its frequency."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.frames import rotate
from vsgdesign.simulation.circuit_sample import PlantRow


class Ramp(NamedTuple):
    """Where a ramp of the source is: its amplitude (V peak), and by how much its frequency has left the one for which
    the responses are made, rad/s."""

    V_pk: Any
    drift: Any


class RampRow(NamedTuple):
    """The source over one interval of a ramp: what c·s^m·e^{jωs} adds to each state, m = 0, 1, 2, and both slopes in
    V/s and rad/s²."""

    re01: Any
    re02: Any
    re03: Any
    im01: Any
    im02: Any
    im03: Any
    re11: Any
    re12: Any
    re13: Any
    im11: Any
    im12: Any
    im13: Any
    re21: Any
    re22: Any
    re23: Any
    im21: Any
    im22: Any
    im23: Any
    V_slope: Any
    omega_slope: Any


def with_ramp(row: PlantRow, ramp: Ramp, ramp_of: RampRow, T_s: Any) -> Any:
    """The interval of a sample on a ramp (:eq:`source-ramp`): to second order in drift and slope. Returns (moved_row,
    ramp_after, extra): the row, the ramp at the next sample, and by how much more the source turns, rad."""
    V = ramp.V_pk
    d = ramp.drift
    a = ramp_of.V_slope
    r = ramp_of.omega_slope
    one_im = d * V
    two_re = -0.5 * V * d * d
    two_im = 0.5 * V * r + d * a
    extra = d * T_s + 0.5 * r * T_s * T_s
    turn_cos, turn_sin = rotate(row.turn_cos, row.turn_sin, np.cos(extra), np.sin(extra))
    moved_row = row._replace(
        re1=ramp_of.re01 * V
        + (ramp_of.re11 * a - ramp_of.im11 * one_im)
        + (ramp_of.re21 * two_re - ramp_of.im21 * two_im),
        re2=ramp_of.re02 * V
        + (ramp_of.re12 * a - ramp_of.im12 * one_im)
        + (ramp_of.re22 * two_re - ramp_of.im22 * two_im),
        re3=ramp_of.re03 * V
        + (ramp_of.re13 * a - ramp_of.im13 * one_im)
        + (ramp_of.re23 * two_re - ramp_of.im23 * two_im),
        im1=ramp_of.im01 * V
        + (ramp_of.im11 * a + ramp_of.re11 * one_im)
        + (ramp_of.im21 * two_re + ramp_of.re21 * two_im),
        im2=ramp_of.im02 * V
        + (ramp_of.im12 * a + ramp_of.re12 * one_im)
        + (ramp_of.im22 * two_re + ramp_of.re22 * two_im),
        im3=ramp_of.im03 * V
        + (ramp_of.im13 * a + ramp_of.re13 * one_im)
        + (ramp_of.im23 * two_re + ramp_of.re23 * two_im),
        turn_cos=turn_cos,
        turn_sin=turn_sin,
    )
    return moved_row, Ramp(V_pk=V + a * T_s, drift=d + r * T_s), extra
