"""A dc link over an interval in which its voltage moves that of the bridge, as plain Python of numbers in lists.

The bridge connects the link to the filter with a constant switching vector s from one edge to the next: its voltage is
s·v, and the current that it takes from the link is 3/2 s·i_s (:eq:`dc-edges`). Filter, grid current and link are moved
together by their Taylor series from edge to edge. What else drives the grid current is a straight line between the ends
of the interval, which the circuit's step says. The numbers are floats, traced or symbols.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.dc_link import DcSettings
from vsgdesign.equations.frames import SPACE_VECTOR_POWER

BENDS = 8
"""Terms of the series of 1/v and v², which change little in an interval."""


class SourceLaw(NamedTuple):
    """The current of a source from a sample to the next, as :class:`vsgdesign.equations.dc_source_interface.DcFlow` has
    it. What is the float 0.0 is left out."""

    v: Any
    """Voltage of the link at the sample, V."""
    current: Any
    slope: Any
    second: Any
    p_begin: Any
    p_middle: Any
    p_end: Any
    tilt: Any
    rate: Any
    """Conductances across the link over its capacitance, 1/s."""


class Edge(NamedTuple):
    """An edge of the bridge: where it is in the interval, 0 to 1, and by how much the switching vector changes."""

    place: Any
    alpha: Any
    beta: Any


class Interval(NamedTuple):
    """An interval, or one of those into which events cut that between two samples."""

    h: Any
    """s."""
    elapsed: Any
    share: Any
    """Where it begins between two samples, 0 to 1, and its length there."""
    x: Sequence[Any]
    """i_s, v_c and i_g at the beginning, each as (α, β), A and V peak."""
    near: Sequence[Mapping[int, Any]]
    """On each axis: the slope of i_g over the interval per number of x, A."""
    rest: Sequence[Sequence[Any]]
    """On each axis: what is left of this slope, as the coefficients of a polynomial in the place in the interval, A."""
    switching: Sequence[Any]
    """s at the beginning, on both axes."""
    edges: Sequence[Edge] = ()
    held: Sequence[Any] | None = None
    """The voltage of a bridge that compensates the link's, on both axes, V peak; the switching vector is then not
    read, and no state gets a response to the link. None: it is s·v."""


class LinkMoved(NamedTuple):
    """The link after an interval."""

    v: Any
    voltage: Any
    squares: Any
    """∫v dt, Vs, and ∫v² dt, V²s."""
    taken: Any
    """Energy that the bridge took, J."""
    moments: Sequence[Sequence[Any]]
    """On each axis: ∫ s (v − v_begin) k x^(k−1) dx for k = 1, 2, …, where x goes from 1 to −1."""


def link_over(v_begin: Any, of: Interval, source: SourceLaw, dc: DcSettings, *, order: int, nodes: int, degree: int):
    """The link over an interval (:eq:`dc-edges`): a :class:`LinkMoved`. ``order``: of the series; ``nodes``: of the
    sum over each piece with which its moments up to ``degree`` are formed."""
    places, weights = (0.5 * np.polynomial.legendre.leggauss(nodes)[k] + (0.5, 0.0)[k] for k in (0, 1))
    v, x, s = v_begin, list(of.x), list(of.switching)
    sums: list[Any] = []
    moments: list[list[Any]] = [[], []]
    begins = [0.0, *(edge.place for edge in of.edges)]
    ends = [*begins[1:], 1.0]
    for number, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        if number:
            edge = of.edges[number - 1]
            s = [s[0] + edge.alpha, s[1] + edge.beta]
        length = end - begin
        h = of.h * length if of.edges else of.h
        states, volts, current = _series(v, x, s, source, dc, of, (begin, length, h), order)
        voltage, squares, taken = _integrals(volts, current, held=of.held is not None)
        sums.append([h * voltage, h * squares, h * taken])
        size = [2.0 * length * weight for weight in weights.tolist()]
        shares = [] if of.held else _moments(volts, v_begin, begin, length, places.tolist(), size, degree)
        for k, of_piece in enumerate(shares):
            for axis in range(2):
                added = s[axis] * of_piece
                if number:
                    moments[axis][k] = moments[axis][k] + added
                else:
                    moments[axis].append(added)
        v, x = _sum(volts), [_sum(one) for one in states]
    voltage, squares, taken = (_sum(column) for column in zip(*sums, strict=True))
    return LinkMoved(v, voltage, squares, taken, moments)


def _series(
    v: Any,
    x: Sequence[Any],
    s: Sequence[Any],
    source: SourceLaw,
    dc: DcSettings,
    of: Interval,
    piece: tuple[Any, Any, Any],
    order: int,
) -> tuple[list[list[Any]], list[Any], list[Any]]:
    """Coefficients of x, of the link and of the current into the bridge over a piece, whose length is 1. ``piece``:
    where it begins in the interval, its length there, and in s."""
    begin, length, h = piece
    states = [[one] for one in x]
    volts, current, inverse, bent = [v], [], [], []
    power = None if _nothing(source.p_begin, source.p_middle, source.p_end) else _power(source, of, begin, length)
    per_volt = [SPACE_VECTOR_POWER * one for one in of.held or s]  # with a voltage that is held: the power itself
    bends = not _nothing(source.slope, source.second)
    rest = [_shifted(one, begin, length) for one in of.rest]
    for n in range(order):
        step, share = h * (1.0 / (n + 1)), length * (1.0 / (n + 1))
        now = [one[n] for one in states]
        current.append(per_volt[0] * now[0] + per_volt[1] * now[1])
        if of.held is None:
            into = -current[n]
        else:
            inverse.append(_next_inverse(volts, inverse))
            into = -_sum([current[k] * inverse[n - k] for k in range(n + 1)])
        if n == 0 and not _nothing(source.current):
            into = source.current + into
        if n < 2 and not _nothing(source.tilt):
            into = into + source.tilt * (of.share * length if n else of.elapsed + of.share * begin - 0.5)
        if power is not None and n <= BENDS:
            if of.held is None:
                inverse.append(_next_inverse(volts, inverse))
            into = into + _sum([power[k] * inverse[n - k] for k in range(min(n, 2) + 1)])
        if bends and n <= BENDS:
            bent.append(volts[n] - source.v if n == 0 else volts[n])
            into = into + source.slope * bent[n]
            into = into + source.second * _sum([bent[k] * bent[n - k] for k in range(n + 1)])
        for axis in range(2):
            i, c, g = (now[k + axis] for k in (0, 2, 4))
            node = c + dc.R_c * (i - g)
            slope = _sum([one * now[k] for k, one in of.near[axis].items()])
            slope = slope + rest[axis][n] if n < len(rest[axis]) else slope
            drop = dc.R_1 * i + node
            if of.held is None:
                states[axis].append(step * dc.over_L_1 * (s[axis] * volts[n] - drop))
            else:
                states[axis].append(step * dc.over_L_1 * (of.held[axis] - drop if n == 0 else -drop))
            states[2 + axis].append(step * dc.over_C_f * (i - g))
            states[4 + axis].append(share * slope)
        volts.append(step * (dc.over_C * into - source.rate * volts[n]))
    return states, volts, current


def _shifted(c: Sequence[Any], begin: Any, length: Any) -> list[Any]:
    """The coefficients of a polynomial over a piece of its interval."""
    found, power = [], 1.0
    for k in range(len(c)):
        total = c[-1] * float(math.comb(len(c) - 1, k))
        for n in range(len(c) - 2, k - 1, -1):
            total = total * begin + c[n] * float(math.comb(n, k))
        found.append(total * power if k else total)
        power = power * length
    return found


def _power(source: SourceLaw, of: Interval, begin: Any, length: Any) -> list[Any]:
    """The power p of a source over a piece, as the parabola through its three values between two samples."""
    first = of.elapsed + of.share * begin
    whole = of.share * length
    line = 4.0 * source.p_middle - 3.0 * source.p_begin - source.p_end
    curve = 2.0 * (source.p_begin - 2.0 * source.p_middle + source.p_end)
    return _shifted([source.p_begin, line, curve], first, whole)


def _next_inverse(volts: Sequence[Any], inverse: Sequence[Any]) -> Any:
    """The next coefficient of 1/v."""
    n = len(inverse)
    return -inverse[0] * _sum([volts[k] * inverse[n - k] for k in range(1, n + 1)]) if n else 1.0 / volts[0]


def _integrals(volts: Sequence[Any], current: Sequence[Any], *, held: bool) -> tuple[Any, Any, Any]:
    """Means of v, v² and v·i over a piece, from their series; ``held``: the third one is that of the power itself."""
    mean = _sum([value * (1.0 / (n + 1)) for n, value in enumerate(volts)])
    rest = _sum([volts[k] * volts[j] * (1.0 / (k + j + 1)) for k in range(1, 4) for j in range(1, 4)])
    squares = volts[0] * (2.0 * mean - volts[0]) + rest
    if held:
        return mean, squares, _sum([one * (1.0 / (n + 1)) for n, one in enumerate(current)])
    taken = volts[0] * _sum([one * (1.0 / (n + 1)) for n, one in enumerate(current)])
    for k in range(1, min(6, len(volts))):
        later = [one * (1.0 / (n + k + 1)) for n, one in enumerate(current) if n + k <= len(current)]
        taken = taken + volts[k] * _sum(later)
    return mean, squares, taken


def _moments(
    volts: Sequence[Any], v_begin: Any, begin: Any, length: Any, places: list[float], size: list[Any], degree: int
) -> list[Any]:
    """∫ (v − v_begin) k x^(k−1) dx of a piece for k = 1 … ``degree``, from values at the nodes of Gauss."""
    found: list[Any] = []
    first = volts[0] - v_begin
    for place, weight in zip(places, size, strict=True):
        away = volts[-1]
        for one in volts[-2:0:-1]:
            away = away * place + one
        away = (away * place + first) * weight
        x = 1.0 - 2.0 * (begin + length * place)
        power = 1.0
        for k in range(degree):
            term = away * (power * (k + 1.0))
            if len(found) > k:
                found[k] = found[k] + term
            else:
                found.append(term)
            power = power * x
    return found


def _sum(terms: Sequence[Any]) -> Any:
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def _nothing(*values: Any) -> bool:
    return all(isinstance(value, float) and value == 0.0 for value in values)
