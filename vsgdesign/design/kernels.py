"""Figures of many small linear systems: step responses and disk margins. Knows no equation of the plant.

The functions of one sample are plain Python of numbers in lists. They are traced once for each order of the systems
and run as machine code, for many systems at once (docs/theory/machine-code.md).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.blocks import Traced, Writer, chosen, expression, larger, root
from vsgdesign.codegen.llvm import Loop, LoopSpec, best_lanes, compiled_loop, empty_rows
from vsgdesign.metrics.step_response import SETTLING_BAND

Array = NDArray[np.float64]
Matrix = list[list[Any]]
Complex = tuple[Any, Any]
"""Real and imaginary part."""

FIGURES = ("overshoot_P", "settling_P", "overshoot_Q", "settling_Q", "cross_P", "cross_Q", "disk_margin")
"""Columns of :func:`figures`. Overshoots and cross peaks are fractions of the step, settling times in s."""

STEPS_PER_SETTLING = 40
"""Time steps within a settling time: the peak of a response is then met to 1e-4 of the step."""

HORIZON = 3.2
"""How long a response is looked at, in settling times."""

_TAYLOR = 10
_HALF_NORM = 0.5


def figures(
    A: Array,
    B: Array,
    C: Array,
    A_K: Array,
    B_K: Array,
    C_K: Array,
    J: Array,
    final_Q: Array,
    stable: NDArray[np.bool_],
    settling: float,
    omegas: Array,
) -> Array:
    """FIGURES (N, 7) of N closed loops: A (N, n, n), B (N, n, 2) from (P_ref, Q_ref), C (N, 2, n) to (P, Q).

    ``final_Q`` (N,): what Q goes to after a unit step of its reference (its droop keeps some). Unstable loops
    have infinite figures and no margin.
    """
    out = np.full((len(A), len(FIGURES)), np.inf)
    out[:, 6] = 0.0
    which = np.flatnonzero(stable)
    if len(which) == 0:
        return out
    n, h = A.shape[1], settling / STEPS_PER_SETTLING
    own = {"A": A, "B": B, "C": C, "A_K": A_K, "B_K": B_K, "C_K": C_K, "J": J}
    lanes = {name: _in_lanes(values[which].reshape(len(which), -1)) for name, values in own.items()}
    phi, drive = _transition(lanes["A"], lanes["B"], n, h)
    ends = np.stack([np.ones(len(which)), final_Q[which]], axis=1)
    steps = _Rows(_loop(_step_sample, n), phi=phi, drive=drive, C=lanes["C"], final=_in_lanes(ends))
    steps.fill(before=1.0)
    steps.run(1, int(HORIZON * STEPS_PER_SETTLING) + 1, h=h)
    margins = _Rows(_loop(_disk_sample, n), **{name: lanes[name] for name in ("A_K", "B_K", "C_K", "J")})
    margins.run(0, len(omegas), cyclic=omegas)
    count = len(which)
    overshoot, settled, peak = (_out_of_lanes(steps[name], count) for name in ("overshoot", "settled", "peak"))
    largest = _out_of_lanes(margins["largest"], count)[:, 0]
    columns = (overshoot[:, 0], settled[:, 0], overshoot[:, 1], settled[:, 1], peak[:, 1], peak[:, 0])
    out[which] = np.stack([*columns, 1.0 / np.sqrt(largest)], axis=1)
    return out


def _transition(A: Array, B: Array, n: int, h: float) -> tuple[Array, Array]:
    """exp(A h) and ∫ exp(A s) ds B over h, by scaling and squaring of Taylor series (to rounding for ‖A h‖ ≤ 1/2)."""
    norm = np.abs(A.reshape(len(A), n, n, -1)).sum(axis=2).max(axis=1) * h
    squarings = np.ceil(np.log2(np.maximum(norm / _HALF_NORM, 1.0)))
    step = (h / 2.0**squarings)[:, None]
    one = np.eye(n).reshape(1, -1, 1)
    series = _Rows(_loop(_taylor_sample, n), A=A, step=step)
    series.fill(term=one, phi=one, psi=one * step)
    series.run(1, _TAYLOR + 1)
    doubled = _Rows(_loop(_doubling_sample, n), squarings=squarings[:, None])
    doubled.fill(phi=series["phi"], psi=series["psi"])
    doubled.run(0, int(squarings.max()))
    psi, into = doubled["psi"].reshape(len(A), n, n, -1), B.reshape(len(B), n, 2, -1)
    drive = sum(psi[:, :, j, None] * into[:, None, j] for j in range(n))
    return doubled["phi"], np.asarray(drive).reshape(len(A), 2 * n, -1)


# One sample of each loop. Numbers are floats or traced; a name that is returned is the number of the next sample.


def _taylor_sample(k: Any, A: Matrix, step: Any, term: Matrix, phi: Matrix, psi: Matrix) -> dict[str, Any]:
    """The k-th term of both series."""
    n = len(A)
    term = [[value * (step / k) for value in row] for row in _product(term, A)]
    return {
        "term": term,
        "phi": [[phi[i][j] + term[i][j] for j in range(n)] for i in range(n)],
        "psi": [[psi[i][j] + term[i][j] * (step / (k + 1.0)) for j in range(n)] for i in range(n)],
    }


def _doubling_sample(k: Any, squarings: Any, phi: Matrix, psi: Matrix) -> dict[str, Any]:
    """Twice the time, where that is still to be done."""
    n, goes_on = len(phi), k < squarings
    further, twice = _product(phi, psi), _product(phi, phi)
    return {
        "phi": [[chosen(goes_on, twice[i][j], phi[i][j]) for j in range(n)] for i in range(n)],
        "psi": [[chosen(goes_on, psi[i][j] + further[i][j], psi[i][j]) for j in range(n)] for i in range(n)],
    }


def _step_sample(
    k: Any,
    h: Any,
    phi: Matrix,
    drive: Matrix,
    C: Matrix,
    final: Sequence[Any],
    x: Matrix,
    overshoot: Sequence[Any],
    settled: Sequence[Any],
    before: Sequence[Any],
    peak: Sequence[Any],
) -> dict[str, Any]:
    """One time step after a unit step of P_ref and, in another run, of Q_ref: overshoot and settling of the own
    channel, and the other channel's peak."""
    n, found = len(phi), {name: [] for name in ("x", "overshoot", "settled", "before", "peak")}
    for own in range(2):
        new = [_sum([drive[i][own], *(phi[i][j] * x[own][j] for j in range(n))]) for i in range(n)]
        y = _sum([C[own][i] * new[i] for i in range(n)]) / final[own]
        z = _sum([C[1 - own][i] * new[i] for i in range(n)])
        error = abs(y - 1.0)
        since = (k - (SETTLING_BAND - error) / (before[own] - error)) * h
        inside = chosen(before[own] > SETTLING_BAND, since, settled[own])
        found["x"].append(new)
        found["overshoot"].append(larger(overshoot[own], y - 1.0))
        found["settled"].append(chosen(error > SETTLING_BAND, np.inf, inside))
        found["before"].append(error)
        found["peak"].append(larger(peak[own], abs(z)))
    return found


def _disk_sample(omega: Any, A_K: Matrix, B_K: Matrix, C_K: Matrix, J: Matrix, largest: Any) -> dict[str, Any]:
    """What 1/margin² of the balanced disk margin at the plant's output is at one more frequency (:eq:`disk-margin`)."""
    (l11, l12), (l21, l22) = _loop_gain(omega, A_K, B_K, C_K, J)
    a11, a12, a21, a22 = _less_than_one(l11), _negated(l12), _negated(l21), _less_than_one(l22)
    inverse = _inverted(difference(times(a11, a22), times(a12, a21)))
    m11, m22 = times(a22, inverse), times(a11, inverse)
    m11, m22 = (m11[0] - 0.5, m11[1]), (m22[0] - 0.5, m22[1])
    m12, m21 = times(_negated(a12), inverse), times(_negated(a21), inverse)
    t = square(m11) + square(m22) + 2.0 * root(square(times(m12, m21)))
    d = square(difference(times(m11, m22), times(m12, m21)))
    return {"largest": larger(largest, 0.5 * (t + root(larger(t * t - 4.0 * d, 0.0))))}


def _loop_gain(omega: Any, A_K: Matrix, B_K: Matrix, C_K: Matrix, J: Matrix) -> list[list[Complex]]:
    """J K(jω), 2 × 2, with K = C_K (jω − A_K)⁻¹ B_K by elimination with partial pivoting."""
    n = len(A_K)
    work: list[list[Complex]] = [
        [*((-A_K[i][j], omega if i == j else 0.0) for j in range(n)), *((value, 0.0) for value in B_K[i])]
        for i in range(n)
    ]
    for k in range(n):
        for i in range(k + 1, n):  # the largest entry of the column comes to the top, row by row
            swap = _size(work[i][k]) > _size(work[k][k])
            for j in range(k, n + 2):
                work[k][j], work[i][j] = _either(swap, work[i][j], work[k][j]), _either(swap, work[k][j], work[i][j])
        work[k][k] = _inverted(work[k][k])  # its inverse is kept there
        for i in range(k + 1, n):
            factor = times(work[i][k], work[k][k])
            for j in range(k + 1, n + 2):
                work[i][j] = difference(work[i][j], times(factor, work[k][j]))
    for column in range(n, n + 2):
        for i in range(n - 1, -1, -1):
            value = work[i][column]
            for j in range(i + 1, n):
                value = difference(value, times(work[i][j], work[j][column]))
            work[i][column] = times(value, work[i][i])
    K = [
        [tuple(_sum([C_K[row][i] * work[i][n + m][part] for i in range(n)]) for part in range(2)) for m in range(2)]
        for row in range(2)
    ]
    return [
        [tuple(J[row][0] * K[0][m][part] + J[row][1] * K[1][m][part] for part in range(2)) for m in range(2)]
        for row in range(2)
    ]  # type: ignore[return-value]


def _product(a: Matrix, b: Matrix) -> Matrix:
    return [[_sum([row[j] * b[j][m] for j in range(len(b))]) for m in range(len(b[0]))] for row in a]


def _sum(terms: Sequence[Any]) -> Any:
    """From the left."""
    return functools.reduce(lambda total, term: total + term, terms)


def times(a: Complex, b: Complex) -> Complex:
    """The product of two complex numbers as pairs of anything that multiplies: numbers, symbols, traced values."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def difference(a: Complex, b: Complex) -> Complex:
    """The difference of two such pairs."""
    return a[0] - b[0], a[1] - b[1]


def _negated(a: Complex) -> Complex:
    return -a[0], -a[1]


def _less_than_one(a: Complex) -> Complex:
    return 1.0 - a[0], -a[1]


def _inverted(a: Complex) -> Complex:
    """1/a without the guards against overflow that make a complex division slow."""
    scale = 1.0 / square(a)
    return a[0] * scale, -a[1] * scale


def _either(condition: Any, one: Complex, other: Complex) -> Complex:
    return chosen(condition, one[0], other[0]), chosen(condition, one[1], other[1])


def square(a: Complex) -> Any:
    """The squared size of such a pair."""
    return a[0] * a[0] + a[1] * a[1]


def _size(a: Complex) -> Any:
    return abs(a[0]) + abs(a[1])


# From a sample to a compiled loop, and from arrays to its rows.

_SHAPES: dict[str, Callable[[int], tuple[int, ...]]] = {
    **dict.fromkeys(("A", "A_K", "term", "phi", "psi"), lambda n: (n, n)),
    **dict.fromkeys(("B_K", "drive"), lambda n: (n, 2)),
    **dict.fromkeys(("C", "C_K", "x"), lambda n: (2, n)),
    "J": lambda _: (2, 2),
    **dict.fromkeys(("final", "overshoot", "settled", "before", "peak"), lambda _: (2,)),
}
"""Of what is no single number."""

_STATES = ("term", "phi", "psi", "x", "overshoot", "settled", "before", "peak", "largest")
_VECTORS = 1


@functools.cache
def _loop(sample: Callable[..., dict[str, Any]], n: int) -> Loop:
    """The compiled loop of a sample for systems of order n. Compiled once in a process, in a tenth of a second."""
    writer = Writer()
    names = sample.__code__.co_varnames[: sample.__code__.co_argcount]
    given: dict[str, Any] = {}
    for name in names:
        shape = _SHAPES[name](n) if name in _SHAPES else ()
        flat = [Traced(writer, writer.input(f"{name}.{index}")) for index in range(int(np.prod(shape)))]
        given[name] = _shaped(flat, shape)
    found = sample(**given)
    for name, values in found.items():
        for index, value in enumerate(_flattened(values)):
            writer.output(f"{name}.{index}", expression(value))
    rows = {name: [f"{name}.{index}" for index in range(len(_flattened(given[name])))] for name in names}
    spec = LoopSpec(
        bodies=(writer.block(),),
        state=tuple((row, row) for name in found for row in rows[name]),
        constant=tuple(row for name in names if name not in (*found, "k", "h", "omega") for row in rows[name]),
        uniform=("h.0",) if "h" in names else (),
        cyclic=("omega.0",) if "omega" in names else (),
        index="k.0" if "k" in names else "",
        lanes=best_lanes(),
        vectors=_VECTORS,
        strict=True,
    )
    return compiled_loop(spec)


def _shaped(flat: list[Any], shape: tuple[int, ...]) -> Any:
    if not shape:
        return flat[0]
    return [flat[k : k + shape[1]] for k in range(0, len(flat), shape[1])] if len(shape) == 2 else flat


def _flattened(values: Any) -> list[Any]:
    if not isinstance(values, list):
        return [values]
    return [one for value in values for one in _flattened(value)]


class _Rows:
    """Rows of a loop by name, (G, numbers, L) each, and its run."""

    def __init__(self, loop: Loop, **constants: Array) -> None:
        self._loop = loop
        self._at: dict[str, slice] = {}
        for at, row in enumerate(loop.spec.rows):
            name = row.partition(".")[0]
            first = self._at[name].start if name in self._at else at
            self._at[name] = slice(first, at + 1)
        self._all = empty_rows(loop.spec, len(next(iter(constants.values()))))
        self.fill(**constants)

    def fill(self, **values: Any) -> None:
        """Sets rows."""
        for name, value in values.items():
            self._all[:, self._at[name]] = value

    def __getitem__(self, name: str) -> Array:
        return self._all[:, self._at[name]]

    def run(self, begin: int, end: int, h: float | None = None, cyclic: Array | None = None) -> None:
        """Moves the rows from sample ``begin`` to before ``end``."""
        uniform = np.array([] if h is None else [h])
        every = None if cyclic is None else np.ascontiguousarray(cyclic, dtype=float)[:, None]
        self._loop(begin, end, self._all, uniform, cyclic=every)


def _in_lanes(values: Array) -> Array:
    """(N, m) as (G, m, L). The last group is filled up with the last system."""
    width = best_lanes() * _VECTORS
    groups = -(-len(values) // width)
    filled = values[np.minimum(np.arange(groups * width), len(values) - 1)]
    return np.ascontiguousarray(filled.reshape(groups, width, -1).transpose(0, 2, 1))


def _out_of_lanes(values: Array, count: int) -> Array:
    """(G, m, L) as (N, m)."""
    return values.transpose(0, 2, 1).reshape(-1, values.shape[1])[:count]
