"""Whether another converter sends its probe on the same lines: the residual then follows a sign that is not the own."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.field.tracks import Lines
from vsgdesign.equations.field.windows import Window, residual
from vsgdesign.equations.frames import rotate_back

FOREIGN_MEMORY = 50.0
"""Cycles over which residuals are compared."""
FOREIGN_AFTER = 30.0
"""Cycles after which they tell something."""
ON_ONE_AXIS = 0.42
"""From which mean of z² on, over both lines, the residuals lie on one axis: for noise it is 0 ± 0.08."""
STILL_ON_IT = 0.3
"""The same where another probe has been heard."""
STEADY = 0.6
"""From which mean of z on a line keeps its sign, and is no probe."""


class Phasor(NamedTuple):
    """A complex number."""

    re: Any
    im: Any


class ForeignLine(NamedTuple):
    """What is known of one line's residual e: the part that follows the own probe u, and how the rest turns.

    z is the rest times the conjugate of that four cycles before, over its length: the differences of both have no cycle
    in common.
    """

    ue: Phasor
    """Σ w u* e"""
    uu: Any
    """Σ w |u|², where w takes its size from a residual that is larger than the noise."""
    one: Phasor
    two: Phasor
    three: Phasor
    four: Phasor
    """The rests of the last cycles."""
    z: Phasor
    """Σ z"""
    zz: Any
    """Re Σ z²"""


class Foreign(NamedTuple):
    """Both lines."""

    line_1: ForeignLine
    line_2: ForeignLine
    count: Any
    """Cycles in the sums, forgotten ones as what is left of them."""
    heard: Any
    """1 while another probe is heard, else 0."""


def no_foreign() -> Foreign:
    """Nothing heard."""
    zero = Phasor(re=0.0, im=0.0)
    line = ForeignLine(ue=zero, uu=0.0, one=zero, two=zero, three=zero, four=zero, z=zero, zz=0.0)
    return Foreign(line_1=line, line_2=line, count=0.0, heard=0.0)


def foreign_line(sums: ForeignLine, window: Window, R: Any, X: Any, noise: Any) -> ForeignLine:
    """The sums with the residual of one more cycle that R and X leave; ``noise`` is its variance over a cycle."""
    keep = 1.0 - 1.0 / FOREIGN_MEMORY
    e_re, e_im = residual(window, R, X)
    weight = noise / np.maximum(e_re * e_re + e_im * e_im, noise)
    by_re, by_im = rotate_back(e_re, e_im, window.u_re, window.u_im)
    ue = Phasor(re=keep * sums.ue.re + weight * by_re, im=keep * sums.ue.im + weight * by_im)
    uu = keep * sums.uu + weight * (window.u_re * window.u_re + window.u_im * window.u_im)
    known = 1.0 / np.maximum(uu, 1e-30)
    rest_re = e_re - known * (ue.re * window.u_re - ue.im * window.u_im)
    rest_im = e_im - known * (ue.re * window.u_im + ue.im * window.u_re)
    z_re, z_im = rotate_back(rest_re, rest_im, sums.four.re, sums.four.im)
    now = np.maximum(rest_re * rest_re + rest_im * rest_im, 1e-30)
    before = np.maximum(sums.four.re * sums.four.re + sums.four.im * sums.four.im, 1e-30)
    size = np.sqrt(now) * np.sqrt(before)
    z_re, z_im = z_re / size, z_im / size
    return ForeignLine(
        ue=ue,
        uu=uu,
        one=Phasor(re=rest_re, im=rest_im),
        two=sums.one,
        three=sums.two,
        four=sums.three,
        z=Phasor(re=keep * sums.z.re + z_re, im=keep * sums.z.im + z_im),
        zz=keep * sums.zz + z_re * z_re - z_im * z_im,
    )


def moves(sums: ForeignLine, count: Any) -> Any:
    """1 if a line's rest does not keep its sign, else 0."""
    return 1.0 if sums.z.re * sums.z.re + sums.z.im * sums.z.im < STEADY * STEADY * count * count else 0.0


def foreign_with(foreign: Foreign, line_1: Window, line_2: Window, lines: Lines, noise_1: Any, noise_2: Any) -> Foreign:
    """The sums of both lines with one more cycle, and what they tell (:eq:`field-foreign`)."""
    count = (1.0 - 1.0 / FOREIGN_MEMORY) * foreign.count + 1.0
    one = foreign_line(foreign.line_1, line_1, lines.R_1, lines.X_1, noise_1)
    two = foreign_line(foreign.line_2, line_2, lines.R_2, lines.X_2, noise_2)
    share = STILL_ON_IT if foreign.heard > 0.5 else ON_ONE_AXIS
    on_axis = 0.5 * (one.zz + two.zz) > share * count and count > FOREIGN_AFTER
    heard = moves(one, count) * moves(two, count) if on_axis else 0.0
    return Foreign(line_1=one, line_2=two, count=count, heard=heard)
