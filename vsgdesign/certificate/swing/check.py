"""Decides on boxes where the swing function falls (docs/theory/large-signal.md).

The swing of a limited converter in a quasi-static network and its energy function stand first. They are written
separately from the programs that decide.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.box_check import EMPTY, PROVED, UNDECIDED, Look, bounds
from vsgdesign.certificate.boxes import Boxes, parameters_of
from vsgdesign.certificate.region import System
from vsgdesign.certificate.swing.conditions import SwingLaw, Test
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.power_flow import power_flow
from vsgdesign.equations.power_loops import PowerLoopGains

Array = NDArray[np.float64]


class Limited(NamedTuple):
    """What the limiter makes of one angle: the angle φ by which the reference leads the admitted voltage (rad; zero if
    the limiter does not act), and the power that the grid then takes (W, var)."""

    phi: float
    P: float
    Q: float


@dataclass(frozen=True)
class SwingLoops:
    """A converter V∠δ behind R + jX (Ω) at the grid voltage V_g, both phase rms, with V held.

    ``P`` and ``Q`` are those of its rest (W, var), ``I_rated_rms`` and ``Z_base`` are the units of ``law``.
    ``angle_error`` is that of the estimated impedance angle, in rad. The gains are held. The states are δ and Δ, the
    frequency over that of the grid at which the frequency integrator would rest (:eq:`swing-loops`).
    """

    R: float
    X: float
    V: float
    V_g: float
    P: float
    Q: float
    gains: PowerLoopGains
    law: SwingLaw
    I_rated_rms: float
    Z_base: float
    angle_error: float = 0.0

    @property
    def kept(self) -> float:
        """m = 1 − k_P D_p."""
        return 1.0 - self.gains.k_P * self.gains.D_p

    @property
    def rest(self) -> float:
        """δ_0 in rad."""
        P, Q = self.P, self.Q
        return math.atan2(self.X * P - self.R * Q, PHASES * self.V**2 - self.R * P - self.X * Q)

    def limited(self, delta: float) -> Limited:
        """The power and the angle φ at the angle δ (:eq:`held-current`, :eq:`projection`)."""
        law, Z = self.law, complex(self.R, self.X)
        soft, hard = law.i_soft * self.I_rated_rms, law.i_max * self.I_rated_rms
        turn = cmath.exp(1j * (cmath.phase(Z) + self.angle_error))
        u = cmath.rect(self.V, delta)
        gap = u - self.V_g
        i = gap / Z
        if abs(i) <= soft:
            return Limited(0.0, *power_flow(delta, self.V, self.V_g, self.R, self.X))
        if abs(i) <= hard:
            P, Q = power_flow(delta, self.V, self.V_g, self.R, self.X)
            admitted = u - law.Z_v * self.Z_base * turn * i * (1.0 - soft / abs(i))
        else:
            radius = abs(Z) * hard
            chord = math.sqrt(abs(gap) ** 2 - (radius * math.sin(self.angle_error)) ** 2)
            short = chord - radius * math.cos(self.angle_error)
            towards = gap * complex(chord, radius * math.sin(self.angle_error)) / abs(gap) ** 2
            S = PHASES * (u - short * towards) * (hard * towards / turn).conjugate()
            P, Q = S.real, S.imag
            admitted = u - towards * (short + law.Z_v * self.Z_base * (hard - soft))
        return Limited(-cmath.phase(admitted / u), P, Q)

    def unstable_rest(self) -> float:
        """The other angle in rad, within ±π, at which the power error is zero while the limiter does not act
        (:eq:`unstable-rest`); the rest itself where it is unstable with V held."""
        g = self.gains
        crest = math.atan2(self.R, self.X) + math.atan(g.K_pq / g.K_ip)
        if math.cos(self.rest - crest) <= 0.0:
            return self.rest
        return math.remainder(math.pi + 2.0 * crest - self.rest, 2.0 * math.pi)

    def errors(self, at: Limited, speed: float) -> tuple[float, float]:
        """The power error with which the loops turn and pull (W), and its part that shapes the energy: one-sided
        while the limiter acts (:eq:`one-sided-error`)."""
        g = self.gains
        slope = g.K_pq / g.K_ip
        e_P, e_Q = at.P - self.P, slope * (at.Q - self.Q)
        loads = e_P + g.D_p * speed - g.D_p * g.k_P / self.kept * e_Q
        if at.phi == 0.0 or not self.law.one_sided:
            return loads + e_Q / self.kept, e_P + e_Q
        sign = math.copysign(1.0, at.phi)
        return sign * max(sign * loads, 0.0) + e_Q / self.kept, sign * max(sign * e_P, 0.0) + e_Q

    def pull(self, phi: float) -> float:
        """s in rad/s: what the frequency integrator follows of the pull of θ."""
        return min(max(phi / self.law.tau, -self.law.largest_pull), self.law.largest_pull)

    def rates(self, delta: float, speed: float) -> tuple[float, float]:
        """dδ/dt in rad/s and dΔ/dt in rad/s² (:eq:`swing-loops`)."""
        at = self.limited(delta)
        used, _ = self.errors(at, speed)
        turning = speed - at.phi / self.law.tau - self.gains.k_P * used
        return turning, -self.law.g * self.pull(at.phi) / self.kept - self.gains.K_ip * used

    def slope(self, delta: float, speed: float) -> float:
        """dW/dt in rad²/s³ (:eq:`swing-falls`) of the function W (:eq:`swing-function`)."""
        at = self.limited(delta)
        _, shaping = self.errors(at, speed)
        d_delta, d_speed = self.rates(delta, speed)
        force = self.law.g * self.pull(at.phi) + self.gains.K_ip * shaping
        return self.kept * speed * d_speed + force * d_delta


Truth = NDArray[np.bool_]

SIDES = np.array([0.2, 0.5, 1.0, 0.5, 1.0, 0.2])
"""A size for each coordinate: how boxes are cut where nothing better is known."""

Named = dict[str, tuple[Array, Array]]
"""Least and largest value of each output on N boxes, (N,) each."""

Holds = Callable[[Named, Boxes], Truth]
"""Bounds of the outputs on boxes to whether the statement holds on each."""


def looks(system: System, tests: list[Test], whole: Boxes, holds: Holds) -> Look:
    """What :func:`~vsgdesign.certificate.box_check.cover` asks. A box holds a statement if every test does that may
    have a point of the region in it."""

    def look(boxes: Boxes) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        own = parameters_of(system, _of_estimates(boxes), _of_estimates(whole))
        some, good = np.zeros(len(boxes), dtype=np.bool_), np.ones(len(boxes), dtype=np.bool_)
        worth = np.zeros((boxes.low.shape[1], len(boxes)))
        for test in tests:
            least, most, moved = bounds(test.program, boxes.low, boxes.high, own)
            count = len(test.names)
            named = {name: (least[k], most[k]) for k, name in enumerate(test.names)}
            low, high = test.conditions[:, :1], test.conditions[:, 1:]
            with np.errstate(invalid="ignore"):
                outside = (least[count:] > high) | (most[count:] < low)
                held = holds(named, boxes)
                open_ = (least <= 0.0) & (most >= 0.0)
                open_[count:] = (least[count:] < low) | (most[count:] > high)
                share = moved / np.maximum(moved.sum(axis=1, keepdims=True), 1e-300)
            here = ~outside.any(axis=0)
            some |= here
            good &= held | ~here
            worth += np.where(open_[:, None, :] & np.isfinite(share) & (here & ~held), share, 0.0).sum(axis=0)
        state = np.where(~some, EMPTY, np.where(good, PROVED, UNDECIDED))
        # A side that is short already promises little; of a box without bounds the longest is cut.
        width = ((boxes.high - boxes.low) / SIDES).T
        return state, np.argmax((worth + 1e-6) * np.sqrt(width), axis=0)

    return look


def gains_hold(named: Named, boxes: Boxes) -> Truth:  # noqa: ARG001 - every statement takes the same arguments
    """K_ip > 0, k_P ≥ 0, k_P D_p < 1, and enough droop reserve for the pull (:eq:`pull-reserve`)."""
    return (named["K_ip"][0] > 0.0) & (named["k_P"][0] >= 0.0) & (named["kept"][0] > 0.0)


def rest_holds(named: Named, boxes: Boxes) -> Truth:  # noqa: ARG001
    """The rest is stable, its unstable counterpart lies beyond the limit, the gate is open, and the error of the angle
    does not reach the edge of what the limit admits."""
    good = [named[name][0] > 0.0 for name in ("rising", "beyond", "open", "near", "clear")]
    return np.logical_and.reduce(good)


def limited_holds(law: SwingLaw) -> Holds:
    """(g s + k_1 h)(φ/τ + k_d h) ≥ 0 while the limiter acts (:eq:`swing-falls`): the error that is used has the sign of
    φ, or it is small compared with the pull."""

    def holds(named: Named, boxes: Boxes) -> Truth:
        ahead = boxes.low[:, 4] >= 0.0
        e_P, e_Q, error, turned = (_least_along(named[name], ahead) for name in ("e_P", "e_Q", "error", "turned"))
        kept, left = named["kept"][0], named["left"][1]
        used = error >= 0.0
        if "towards" in named:
            used |= named["towards"][0] >= 0.0
        if law.one_sided:
            used |= np.maximum(e_P, 0.0) + e_Q >= 0.0

        def turned_by(angle: Array) -> Truth:
            """Whether φ is at least so large, rad."""
            return (angle < 1.5) & (np.cos(angle) * turned - np.sin(angle) * left >= 0.0)

        pulls = _largest(named["pulled_by_Q"]), _largest(named["turned_by_Q"]) / kept
        # Close to the edge, the droop needs reserve if Q pulls back (:eq:`pull-reserve`).
        by_P = [np.maximum(_least_along(named[name], ahead), 0.0) for name in ("pulled_by_P", "turned_by_P")]
        strong = (kept * e_P >= 2.0 * _largest(named["e_Q"])) & (by_P[0] * by_P[1] >= 2.0 * law.g * pulls[1] ** 2)
        used &= (e_Q >= 0.0) | (named["reserve"][0] >= 0.0) | strong | turned_by(law.tau * pulls[1])
        if not law.one_sided:
            pulls = pulls[0] + _largest(named["pulled_by_P"]), pulls[1] + _largest(named["turned_by_P"]) / kept
        small = 2.0 * pulls[0] <= law.g * law.largest_pull
        small &= turned_by(2.0 * law.tau * np.maximum(pulls[0] / max(law.g, 1e-9), pulls[1]))
        return (kept > 0.0) & (used | small)

    return holds


def edge_holds(law: SwingLaw, angle: float, speed: float) -> Holds:
    """At ±``angle`` (rad) the pull is faster than anything that starts within it at ±``speed`` (rad/s) may become
    (:eq:`held-back`)."""

    def holds(named: Named, boxes: Boxes) -> Truth:
        ahead = boxes.low[:, 4] >= 0.0
        kept = named["kept"][0]
        height = 4.0 * angle * (law.g * law.largest_pull + named["steepest"][1])
        most = np.sqrt(height / kept + speed * speed) + _largest(named["turned_by_Q"]) / kept
        turned, left = _least_along(named["turned"], ahead), named["left"][1]
        held = np.minimum(law.tau * most, np.pi)
        # φ has the sign of δ here, and so between here and the edge of the disc: a sine is least at an end.
        clear = named["clear"][0] > 0.0
        return clear & (kept > 0.0) & (held < 0.9 * np.pi) & (np.cos(held) * turned - np.sin(held) * left >= 0.0)

    return holds


def _largest(limits: tuple[Array, Array]) -> Array:
    return np.maximum(np.abs(limits[0]), np.abs(limits[1]))


def _least_along(limits: tuple[Array, Array], ahead: Truth) -> Array:
    """The least value in the direction of δ."""
    return np.where(ahead, limits[0], -limits[1])


def with_angle(boxes: Boxes, low: float, high: float, error: float) -> Boxes:
    """Boxes with δ from low to high (rad) in place of the error of R and ±error of the angle in place of that of L."""
    one, other = boxes.low.copy(), boxes.high.copy()
    one[:, 4], other[:, 4], one[:, 5], other[:, 5] = low, high, -error, error
    return Boxes(one, other, boxes.piece)


def _of_estimates(boxes: Boxes) -> Boxes:
    """The same without the last two coordinates, which are no errors here."""
    one, other = boxes.low.copy(), boxes.high.copy()
    one[:, 4:], other[:, 4:] = 0.0, 0.0
    return replace(boxes, low=one, high=other)
