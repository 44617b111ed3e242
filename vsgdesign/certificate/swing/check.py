"""Decides on boxes where the swing function falls (docs/theory/large-signal.md)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.box_bounds import EMPTY, PROVED, UNDECIDED, Look, bounds
from vsgdesign.certificate.boxes import Boxes, parameters_of
from vsgdesign.certificate.region import System
from vsgdesign.certificate.swing.conditions import SwingLaw, Test

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]

SIDES = np.array([0.2, 0.5, 1.0, 0.5, 1.0, 0.2])
"""A size for each coordinate: how boxes are cut where nothing better is known."""

Named = dict[str, tuple[Array, Array]]
"""Least and largest value of each output on N boxes, (N,) each."""

Holds = Callable[[Named, Boxes], Truth]
"""Bounds of the outputs on boxes to whether the statement holds on each."""


def looks(system: System, tests: list[Test], whole: Boxes, holds: Holds) -> Look:
    """What :func:`~vsgdesign.certificate.box_bounds.cover` asks. A box holds a statement if every test does that may
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
