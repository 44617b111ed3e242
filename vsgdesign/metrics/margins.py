"""Stability margins from a 2×2 sensitivity: exact disk margin, margins of each loop, peak sensitivity.

Everything is computed from S(jω) = (I + L)⁻¹ of N cells. S is a function that can be evaluated at any frequency, so
that a crossing or a peak on a frequency grid is then refined to machine precision. Grids are (F,), or (N, F) if every
cell has its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

SensitivityAt = Callable[[NDArray[np.intp], Array], Complex]
"""(cells (k,), ω (k,)) → S (k, 2, 2)."""

_MOST_ROUNDS = 120
"""Rounds of a search that converges nowhere; eight to fifteen are the rule."""
_NEAR = 1.5e-8
"""Distance from a maximum within which the values differ by rounding alone, relative to 1 + |ln ω|."""
_REACH = 1e5
"""A value between two points of the grid is expected beyond the highest (lowest) of three neighbours by at most so many
times their spread. What cannot become an extreme or a crossing by this is not refined. Every mode has points of its own
within its width, so a resonance shows in the spread."""
_EQUAL = 1e-12
"""Relative difference of values that rounding alone may make."""
_ROUNDING = 4.4e-16
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)
_PEAKS = 3
"""Number of the highest local maxima of a cell that are refined, because the second may be the highest between the
points.
"""


@dataclass(frozen=True)
class LoopMarginTable:
    """Margins of one loop with the other closed, for each cell; infinite if there is no crossing."""

    gain_margin_db: Array
    gain_crossing_rad_s: Array
    phase_margin_deg: Array
    phase_crossing_rad_s: Array
    delay_margin_s: Array
    """Smallest delay over all gain crossings that makes the loop unstable."""
    delay_crossing_rad_s: Array


@dataclass(frozen=True)
class PeakTable:
    """For each cell, the value of a peak over frequency and its frequency."""

    value: Array
    omega: Array


def disk_margin_per_frequency(S: Complex) -> Array:
    """1/μ of S − I/2 for 2×2 matrices (…, 2, 2): the balanced disk margin at each frequency (:eq:`disk-margin`).

    μ with two complex uncertainties is the larger root of a quadratic in μ², exact and smooth.
    """
    m11, m12 = S[..., 0, 0] - 0.5, S[..., 0, 1]
    m21, m22 = S[..., 1, 0], S[..., 1, 1] - 0.5
    t = _square(m11) + _square(m22) + 2.0 * np.abs(m12 * m21)
    d = _square(m11 * m22 - m12 * m21)
    mu_sq = 0.5 * (t + np.sqrt(np.maximum(t * t - 4.0 * d, 0.0)))
    return 1.0 / np.sqrt(mu_sq)


def guaranteed_margins(alpha: Array) -> tuple[Array, Array]:
    """Gain factor and phase (deg) that a disk margin α guarantees in every channel at the same time."""
    factor = np.where(alpha < 2.0, (1.0 + alpha / 2.0) / np.where(alpha < 2.0, 1.0 - alpha / 2.0, 1.0), np.inf)
    return factor, np.degrees(2.0 * np.arctan(alpha / 2.0))


def largest_singular_value(S: Complex) -> Array:
    """σ_max of 2×2 matrices (…, 2, 2), in closed form."""
    total = _square(S).sum(axis=(-2, -1))
    determinant = _square(S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] * S[..., 1, 0])
    return np.sqrt(0.5 * (total + np.sqrt(np.maximum(total * total - 4.0 * determinant, 0.0))))


def disk_margin_steps(S_grid: Complex, omega: Array, at: SensitivityAt) -> Steps:
    """Steps to the smallest disk margin over frequency of N cells, from S on a grid (N, F, 2, 2): a PeakTable."""
    values = -disk_margin_per_frequency(S_grid)
    grid = _per_cell(omega, values)
    highest, where = yield from _highest(values, grid, at, lambda S, _: -disk_margin_per_frequency(S))
    return PeakTable(-highest, where)


def peak_sensitivity_steps(S_grid: Complex, omega: Array, at: SensitivityAt) -> Steps:
    """Steps to M_s = max σ_max(S) over frequency of N cells: a PeakTable."""
    values = largest_singular_value(S_grid)
    grid = _per_cell(omega, values)
    return PeakTable(*(yield from _highest(values, grid, at, lambda S, _: largest_singular_value(S))))


def loop_margins_steps(S_grid: Complex, omega: Array, at: SensitivityAt, loop: int) -> Steps:
    """Steps to the gain, phase and delay margins of one loop (0: P, 1: Q) with the other closed: a LoopMarginTable.

    The loop is L = 1/S_ii − 1. Crossings are bracketed on the grid and then bisected. If the loop only comes close to
    a crossing on the grid, a pair of crossings is searched between the points.
    """

    def gain(S: Complex) -> Complex:
        return _loop_gain(S[:, loop, loop])

    L = _loop_gain(S_grid[:, :, loop, loop])
    count, omega = L.shape[0], _per_cell(omega, L)
    of_one = _crossings(_log_size(L), omega, at, lambda S: _log_size(gain(S)))
    of_axis = _crossings(L.imag, omega, at, lambda S: gain(S).imag)
    (cells, w), (on_axis, w_axis) = yield from _together([of_one, of_axis])
    phase = np.angle(-gain(at(cells, w)))  # distance to −1 along the unit circle
    PM, PM_at = _least_per_cell(np.abs(np.degrees(phase)), w, cells, count)
    delay = np.mod(phase, 2.0 * np.pi) / w
    DM, DM_at = _least_per_cell(delay, w, cells, count)

    value = gain(at(on_axis, w_axis)).real
    on_negative = value < 0.0
    cells, w, value = on_axis[on_negative], w_axis[on_negative], value[on_negative]
    GM, GM_at = _least_per_cell(np.abs(20.0 * np.log10(-value)), w, cells, count)
    return LoopMarginTable(GM, GM_at, PM, PM_at, DM, DM_at)


def _loop_gain(S: Complex) -> Complex:
    """L = 1/S − 1; infinite in both parts where a gain is so large that S is rounded to zero."""
    inverse: Complex = np.full(S.shape, complex(np.inf, np.inf), dtype=np.complex128)
    np.divide(1.0, S, out=inverse, where=S != 0.0)
    return inverse - 1.0


def _log_size(L: Complex) -> Array:
    """ln |L|; that of the least number where a gain is so small that L is rounded to zero."""
    return np.log(np.maximum(np.abs(L), np.finfo(float).tiny))


class _Curves(NamedTuple):
    """A real function of frequency for each of k intervals: ``of(S, k)`` of S in the cell of interval k."""

    at: SensitivityAt
    cells: NDArray[np.intp]
    of: Callable[[Complex, NDArray[np.intp]], Array]


class _Peaks(NamedTuple):
    """A question for the maximum of each curve between low and high (ln ω), with the values ``known`` at low, inside
    and high. The answer is (values, ln ω)."""

    curves: _Curves
    low: Array
    inside: Array
    high: Array
    known: tuple[Array, Array, Array]


class _Zeros(NamedTuple):
    """A question for the change of sign of each curve between low and high (ln ω). The answer is ln ω."""

    curves: _Curves
    low: Array
    high: Array


Steps = Generator[list[_Peaks | _Zeros], list[Any], Any]
"""Margins that are being computed: a generator that asks for maxima and zeros, and returns a table."""


def refined(margins: Sequence[Steps]) -> list[Any]:
    """The tables of several margins. What they ask for at the same time is searched together, because a search takes
    as long for many intervals as for one. The results do not depend on which margins are computed together."""
    steps, answers = _together(margins), None
    while True:
        try:
            asked = steps.send(answers)  # type: ignore[arg-type]
        except StopIteration as end:
            return end.value
        answers = [None] * len(asked)
        for kind in (_Peaks, _Zeros):
            places = [k for k, one in enumerate(asked) if isinstance(one, kind)]
            for k, answer in zip(places, _searched([asked[k] for k in places]) if places else (), strict=True):
                answers[k] = answer


def _together(several: Sequence[Steps]) -> Steps:
    """Several steps side by side: the list of what they return."""
    found: list[Any] = [None] * len(several)
    asked: dict[int, list[_Peaks | _Zeros]] = {}

    def go_on(k: int, answers: list[Any] | None) -> None:
        try:
            asked[k] = several[k].send(answers)  # type: ignore[arg-type]
        except StopIteration as end:
            found[k] = end.value

    for k in range(len(several)):
        go_on(k, None)
    while asked:
        now = asked.copy()
        asked.clear()
        answers = iter((yield [one for questions in now.values() for one in questions]))
        for k, questions in now.items():
            go_on(k, [next(answers) for _ in questions])
    return found


def _searched(asked: Sequence[Any]) -> list[Any]:
    """The answers to questions of one kind."""
    function = _of_all([one.curves for one in asked])
    cuts = np.cumsum([len(one.low) for one in asked])[:-1]
    low, high = (np.concatenate([getattr(one, name) for one in asked]) for name in ("low", "high"))
    if isinstance(asked[0], _Zeros):
        return np.split(_roots(low, high, function), cuts)
    inside = np.concatenate([one.inside for one in asked])
    f_low, f_inside, f_high = (np.concatenate(values) for values in zip(*(one.known for one in asked), strict=True))
    best, at = _maxima(low, inside, high, (f_low, f_inside, f_high), function)
    return list(zip(np.split(best, cuts), np.split(at, cuts), strict=True))


def _of_all(curves: Sequence[_Curves]) -> Callable[[NDArray[np.intp], Array], Array]:
    """The curves one after another as one function of the interval's number (ascending) and ln ω. S is evaluated once
    for all neighbours of the same loop."""
    starts = np.cumsum([0, *(len(one.cells) for one in curves)])
    cells = np.concatenate([one.cells for one in curves])
    loops = [(at, list(group)) for at, group in itertools.groupby(range(len(curves)), lambda k: curves[k].at)]

    def function(k: NDArray[np.intp], x: Array) -> Array:
        ends, omega, values = np.searchsorted(k, starts).tolist(), np.exp(x), np.empty(len(k))
        for at, group in loops:
            first, last = ends[group[0]], ends[group[-1] + 1]
            if first == last:
                continue
            S = at(cells[k[first:last]], omega[first:last])
            for j in group:
                begin, end = ends[j], ends[j + 1]
                if begin < end:
                    values[begin:end] = curves[j].of(S[begin - first : end - first], k[begin:end] - starts[j])
        return values

    return function


def _square(x: Complex) -> Array:
    return x.real * x.real + x.imag * x.imag


def _per_cell(omega: Array, values: NDArray[Any]) -> Array:
    return np.broadcast_to(omega, values.shape)


def _crossings(values: NDArray[Any], omega: Array, at: SensitivityAt, of: Callable[[Complex], NDArray[Any]]) -> Steps:
    """Every sign change of (N, F) values along the grids, refined by bisection: cells and frequencies."""
    negative, log_omega = np.signbit(values), np.log(omega)
    fine = np.isfinite(values)
    cells, k = np.nonzero((negative[:, 1:] != negative[:, :-1]) & fine[:, 1:] & fine[:, :-1])
    low, high = log_omega[cells, k], log_omega[cells, k + 1]
    # A value that comes close to zero and turns back may have crossed twice in between.
    size = np.abs(values)
    turns = (size[:, 1:-1] < size[:, :-2]) & (size[:, 1:-1] <= size[:, 2:]) & fine[:, 2:]
    turns &= (negative[:, 1:-1] == negative[:, :-2]) & (negative[:, 1:-1] == negative[:, 2:])
    turns &= _REACH * (np.maximum(size[:, :-2], size[:, 2:]) - size[:, 1:-1]) >= size[:, 1:-1]
    turned, k = np.nonzero(turns)
    sign = np.where(negative[turned, k + 1], -1.0, 1.0)
    left, right = log_omega[turned, k], log_omega[turned, k + 2]
    k += 1
    known = -sign * values[turned, k - 1], -sign * values[turned, k], -sign * values[turned, k + 1]
    close = _Curves(at, turned, lambda S, k: -sign[k] * of(S))
    [(nearest, x)] = yield [_Peaks(close, left, log_omega[turned, k], right, known)]
    beyond = nearest > 0.0
    cells = np.concatenate([cells, turned[beyond], turned[beyond]])
    low, high = np.concatenate([low, left[beyond], x[beyond]]), np.concatenate([high, x[beyond], right[beyond]])
    [zeros] = yield [_Zeros(_Curves(at, cells, lambda S, _: of(S)), low, high)]
    return cells, np.exp(zeros)


def _least_per_cell(value: Array, omega: Array, cells: NDArray[np.intp], count: int) -> tuple[Array, Array]:
    """Smallest value of each cell and its frequency; infinity and NaN for cells without one."""
    least, where = np.full(count, np.inf), np.full(count, np.nan)
    order = np.argsort(-value, kind="stable")  # the smallest is written last
    least[cells[order]] = value[order]
    where[cells[order]] = omega[order]
    return least, where


def _highest(values: Array, omega: Array, at: SensitivityAt, of: Callable[[Complex, NDArray[np.intp]], Array]) -> Steps:
    """Largest of (N, F) values for each cell and its frequency; the highest local maxima are refined between their
    neighbours.
    """
    count, points = values.shape
    bounded = np.pad(values, ((0, 0), (1, 1)), constant_values=-np.inf)
    local = np.where((values >= bounded[:, :-2]) & (values >= bounded[:, 2:]), values, -np.inf)
    kept = min(_PEAKS, points)
    k = np.argpartition(local, points - kept, axis=1)[:, points - kept :]
    cells, chosen = np.repeat(np.arange(count), kept), k.ravel()
    left, right = np.maximum(chosen - 1, 0), np.minimum(chosen + 1, points - 1)
    own, lower = values[cells, chosen], np.minimum(values[cells, left], values[cells, right])
    may_be_highest = own + _REACH * (own - lower) >= values.max(axis=1)[cells]
    at_peak = np.flatnonzero((local[cells, chosen] > -np.inf) & may_be_highest)
    cells, chosen, own = cells[at_peak], chosen[at_peak], own[at_peak]
    left, right, log_omega = left[at_peak], right[at_peak], np.log(omega)
    ends = log_omega[cells, left], log_omega[cells, chosen], log_omega[cells, right]
    known = values[cells, left], own, values[cells, right]
    [(best, x)] = yield [_Peaks(_Curves(at, cells, of), *ends, known)]
    # The grid's own point may be the highest: at its edge, or exactly on the peak.
    peak = np.where(own > best, omega[cells, chosen], np.exp(x))
    least, where = _least_per_cell(-np.maximum(best, own), peak, cells, count)
    return -least, where


def _maxima(
    low: Array, inside: Array, high: Array, known: tuple[Array, Array, Array], function: Callable
) -> tuple[Array, Array]:
    """Maxima of ``function(k, x)``, one in each interval k with low ≤ x ≤ high: values and x.

    Brent's method: a parabola through the three best points where it converges, else a golden section. It begins with
    the values that are ``known`` at low, inside and high. All intervals advance together, and those that are done
    are not evaluated any more.
    """
    f_low, f_inside, f_high = known
    low, high, x, f = low.copy(), high.copy(), inside.copy(), -f_inside
    nearer = f_low > f_high
    second, third = np.where(nearer, low, high), np.where(nearer, high, low)
    f_second, f_third = np.where(nearer, -f_low, -f_high), np.where(nearer, -f_high, -f_low)
    step = high - low
    last = step.copy()
    for _ in range(_MOST_ROUNDS):
        middle, least = 0.5 * (low + high), _NEAR * (1.0 + np.abs(x))
        wide = np.abs(x - middle) > 2.0 * least - 0.5 * (high - low)
        k = np.flatnonzero(wide & (np.maximum(f_second, f_third) - f > _EQUAL * np.abs(f)))
        if k.size == 0:
            break
        a, b, at, f_at, tol = low[k], high[k], x[k], f[k], least[k]
        r, q = (at - second[k]) * (f_at - f_third[k]), (at - third[k]) * (f_at - f_second[k])
        p, q = (at - third[k]) * q - (at - second[k]) * r, 2.0 * (q - r)
        p, q = np.where(q > 0.0, -p, p), np.abs(q)
        fits = (np.abs(last[k]) > tol) & (np.abs(p) < np.abs(0.5 * q * last[k]))
        fits &= (p > q * (a - at)) & (p < q * (b - at))
        parabola = p / np.where(fits, q, 1.0)
        near_edge = (at + parabola - a < 2.0 * tol) | (b - at - parabola < 2.0 * tol)
        parabola = np.where(near_edge, np.where(at < middle[k], tol, -tol), parabola)
        larger_part = np.where(at < middle[k], b - at, a - at)
        last[k] = np.where(fits, step[k], larger_part)
        move = np.where(fits, parabola, (1.0 - _GOLDEN) * larger_part)
        step[k] = move
        tried = at + np.where(np.abs(move) >= tol, move, np.copysign(tol, move))
        f_tried = -function(k, tried)
        better, right = f_tried <= f_at, tried >= at
        low[k] = np.where(better & right, at, np.where(~better & ~right, tried, a))
        high[k] = np.where(better & ~right, at, np.where(~better & right, tried, b))
        as_second = ~better & ((f_tried <= f_second[k]) | (second[k] == at))
        as_third = ~better & ~as_second & ((f_tried <= f_third[k]) | (third[k] == at) | (third[k] == second[k]))
        third[k] = np.where(better | as_second, second[k], np.where(as_third, tried, third[k]))
        f_third[k] = np.where(better | as_second, f_second[k], np.where(as_third, f_tried, f_third[k]))
        second[k] = np.where(better, at, np.where(as_second, tried, second[k]))
        f_second[k] = np.where(better, f_at, np.where(as_second, f_tried, f_second[k]))
        x[k], f[k] = np.where(better, tried, at), np.where(better, f_tried, f_at)
    return -f, x


def _roots(low: Array, high: Array, function: Callable) -> Array:
    """Changes of the sign of ``function(k, x)``, one in each interval k with low ≤ x ≤ high, to machine precision.

    Chandrupatla's method: inverse quadratic interpolation where it is safe, else bisection. All intervals advance
    together, and those that are done are not evaluated any more.
    """
    every = np.arange(len(low))
    b, a = low.copy(), high.copy()
    f_b, f_a = function(every, b), function(every, a)
    share = np.full(len(low), 0.5)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(_MOST_ROUNDS):
            width, nearest = np.abs(b - a), np.where(np.abs(f_a) < np.abs(f_b), f_a, f_b)
            least = _ROUNDING * (1.0 + np.maximum(np.abs(a), np.abs(b)))
            k = np.flatnonzero((width > 2.0 * least) & (nearest != 0.0))
            if k.size == 0:
                break
            limit = least[k] / width[k]
            tried = a[k] + np.clip(share[k], limit, 1.0 - limit) * (b[k] - a[k])
            f_tried = function(k, tried)
            same = np.signbit(f_tried) == np.signbit(f_a[k])
            c, f_c = np.where(same, a[k], b[k]), np.where(same, f_a[k], f_b[k])
            b[k], f_b[k] = np.where(same, b[k], a[k]), np.where(same, f_b[k], f_a[k])
            a[k], f_a[k] = tried, f_tried
            xi, phi = (a[k] - b[k]) / (c - b[k]), (f_a[k] - f_b[k]) / (f_c - f_b[k])
            safe = (phi * phi < xi) & ((1.0 - phi) ** 2 < 1.0 - xi)
            inverse = f_a[k] / (f_b[k] - f_a[k]) * f_c / (f_b[k] - f_c)
            inverse += (c - a[k]) / (b[k] - a[k]) * f_a[k] / (f_c - f_a[k]) * f_b[k] / (f_c - f_b[k])
            share[k] = np.where(safe & np.isfinite(inverse), inverse, 0.5)
    return np.where(np.abs(f_a) < np.abs(f_b), a, b)
