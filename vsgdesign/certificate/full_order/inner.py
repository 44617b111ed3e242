"""The inner loops on cells of grids and arcs of the circle: the functions through which they enter the power loops.

The circuit is that of the equations, taken with forms for R_g and L_g. Its exact step is a series with a bound of what
is left out. A bridge voltage answers with one complex number on each quantity, so that the inner loop is scalar
(:eq:`full-order-inner`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.full_order.forms import (
    ARC,
    GRID,
    UP,
    Form,
    Tape,
    Values,
    exponential_less_one,
    sine,
    variable,
)
from vsgdesign.certificate.full_order.rows import InnerRows, Polynomial, PowerFilter
from vsgdesign.certificate.full_order.tape import Program, program_of, run
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES, FilterGrid, capacitor_node_voltage, filter_grid_derivative
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Triple = list[Any]

_LEFT_OUT = 1e-16
"""Of the exponential's series, relative to 1, on the fastest circuit."""

_SPARE = 1.3
"""A circuit may be so much faster than those at the corners of the region before the series is no longer good."""

FUNCTIONS = 12
"""Of an arc, see :class:`ArcFunctions`."""


class CellForms(NamedTuple):
    """What depends on the grid alone, a column for each cell."""

    size: Values
    """\\|Z_g\\| in Ω."""
    inverse: Values
    transition: tuple[Values, ...]
    """A Ψ: (Φ − 1)/T_s, row by row."""
    driven: tuple[Values, ...]
    """Ψ b: Γ/T_s."""
    i_s: tuple[Values, Values]
    """At rest per V at the control point and per A of i_g, in A peak: i_s = first·v + second·i_g."""
    v_b: tuple[Values, Values]
    """The bridge's voltage, alike."""
    rest: tuple[Values, Values]
    """V_g/V = first + second·i_g\\|Z_g\\|/V."""

    def take(self, index: Any) -> list[Values]:
        """What the functions of arcs need, a column for each arc."""
        every = (self.size, self.inverse, *self.transition, *self.driven, *self.i_s, *self.v_b)
        return [values.take(index) for values in every]


class ArcFunctions(NamedTuple):
    """On n arcs. ``functions`` are, in units of 3V²/\\|Z\\|, what δ and ln V do to P + jQ (:eq:`full-order-powers`)."""

    s: Values
    divided: Values
    """1/(s + divisor)³."""
    functions: tuple[Values, ...]
    ratio: Values | None
    """Filter of Q over filter of P; None where both are the same."""
    inner: tuple[Values, Values]
    """The inner loops' polynomial at z and at the conjugate of z (:eq:`full-order-inner`)."""
    filters: tuple[Values, ...]
    """The filters' polynomials."""

    @property
    def every(self) -> list[Values]:
        """All of them, in order."""
        ratio = [] if self.ratio is None else [self.ratio]
        return [self.s, self.divided, *self.functions, *ratio, *self.inner, *self.filters]

    @classmethod
    def made_of(cls, every: Sequence[Values], ratio: bool) -> ArcFunctions:
        """The opposite of ``every``."""
        functions, rest = tuple(every[2 : 2 + FUNCTIONS]), list(every[2 + FUNCTIONS :])
        own = rest.pop(0) if ratio else None
        return cls(every[0], every[1], functions, own, (rest[0], rest[1]), tuple(rest[2:]))


@dataclass(frozen=True, kw_only=True)
class InnerLoop:
    """What the enclosure takes of a study."""

    circuit: FilterGrid
    rows: InnerRows
    filters: tuple[PowerFilter, PowerFilter]
    """Of P and of Q."""
    T_s: float
    omega_g: float
    omega_n: float
    Z_base: float
    scr_basis: str
    alpha: float
    """The circle is \\|z\\| = exp(−α T_s), 1/s."""
    divisor: float
    """det M is divided by (s + divisor)³, 1/s."""
    terms: int
    """Of the series of the exponential."""
    apart: bool = False
    """Whether the loop is that of equal units against each other: the rest is that on the grid, and the circuit ends at
    the units' node (:eq:`full-order-apart`)."""

    @classmethod
    def of(
        cls,
        study: Study,
        rows: InnerRows,
        filters: Any,
        alpha: float,
        divisor: float,
        fastest: float,
        apart: bool = False,
    ) -> InnerLoop:
        """Of a study's converter; ``fastest``: the largest size of T_s A, in states over their energy, at the corners
        of the region."""
        c = study.converter
        far, terms = _SPARE * fastest, 4
        while far ** (terms + 1) / math.factorial(terms + 2) > _LEFT_OUT:
            terms += 1
        return cls(
            circuit=study.circuit(),
            rows=rows,
            filters=filters,
            T_s=c.T_s,
            omega_g=study.grid_source.omega_g,
            omega_n=c.omega_n,
            Z_base=c.Z_base,
            scr_basis=study.scr_basis,
            alpha=alpha,
            divisor=divisor,
            terms=terms,
            apart=apart,
        )

    @property
    def ratio(self) -> bool:
        """Whether the filters of P and Q differ."""
        return self.filters[0] != self.filters[1]


@dataclass(frozen=True)
class InnerTapes:
    """The inner loop of a study, recorded: first the circuit, then its step and rest, then the functions of an arc."""

    loop: InnerLoop
    circuit: Program
    entries: tuple[tuple[int, float], ...]
    """A, then the columns of bridge and source, row by row: which output of ``circuit`` (−1: the number beside it)."""
    step: Program
    arcs: Program

    @classmethod
    def of(cls, loop: InnerLoop) -> InnerTapes:
        """The tapes of an inner loop."""
        circuit, entries = _circuit_tape(loop)
        return cls(loop, circuit, entries, _step_tape(loop, entries), _arc_tape(loop))

    def cells(self, low: Array, high: Array) -> CellForms:
        """What depends on the grid alone in cells between limits (N, 2)."""
        size, inverse, step, rest = self._at(low, high)
        if self.loop.apart:
            # No grid: the first coordinate is zero. What is at rest there is not used.
            none = np.zeros_like(low)
            none[:, 1] = 1.0  # any angle
            step = self._at(none, none)[2]
        transition, driven = tuple(step[:9]), tuple(step[9:])
        return CellForms(size, inverse, transition, driven, (rest[0], rest[1]), (rest[2], rest[3]), (rest[4], rest[5]))

    def _at(self, low: Array, high: Array) -> tuple[Values, Values, list[Values], list[Values]]:
        """\\|Z_g\\| and its inverse, the circuit's step, and what is at rest in cells between limits (N, 2)."""
        count = len(low)
        first = variable(low[:, 0], high[:, 0], 0)
        across, along = (sine(low[:, 1], high[:, 1], 1, quarter) for quarter in (0, 1))
        size, inverse, *forms = run(self.circuit, [first, across, along], count)
        radii = self._left_out(forms)
        found = run(self.step, [size, inverse, *forms], count, radii)
        return size, inverse, found[:12], found[12:]

    def functions(self, cells: CellForms, index: Any, low: Array, high: Array) -> ArcFunctions:
        """The functions on arcs between frequencies (n,) in rad/s, each of the cell at its ``index``."""
        T = self.loop.T_s
        z = exponential_less_one(1j * T, -self.loop.alpha * T, low, high, 2)
        return ArcFunctions.made_of(run(self.arcs, [z, *cells.take(index)], len(low)), self.loop.ratio)

    def _left_out(self, forms: list[Values]) -> Array:
        """What the series leaves out of each entry of Ψ, (9, N).

        Its size is measured in states over scales of equal energy: \\|(T_s A)^k\\| is at most the k-th power of that
        of T_s A.
        """
        loop, count = self.loop, len(forms[0].radius)
        A = [np.full(count, abs(number)) if k < 0 else forms[k - 2].size for k, number in self.entries[:9]]
        # v_c drives i_g through 1/L. Any positive scales are good.
        of_L = np.sqrt(np.abs(forms[self.entries[7][0] - 2].centre))
        scales = [1.0 / np.sqrt(loop.circuit.L_1), 1.0 / np.sqrt(loop.circuit.C), of_L]
        B = [[A[3 * i + j] * loop.T_s * scales[j] / scales[i] for j in range(3)] for i in range(3)]
        far = np.max([sum(row) for row in B], axis=0) * UP
        n = loop.terms
        with np.errstate(invalid="ignore", divide="ignore"):
            left = np.where(far < n + 3, far ** (n + 1) / math.factorial(n + 2) / (1.0 - far / (n + 3)), np.inf) * UP
        return np.array([left * scales[i] / scales[j] * UP for i in range(3) for j in range(3)])


def fastest_step(circuit: FilterGrid, T_s: float, R_g: Array, L_g: Array) -> float:
    """The largest size of T_s A on some grids, in states over scales of equal energy."""
    circuit = circuit._replace(R_g=R_g, L_g=L_g)
    columns = [filter_grid_derivative(a, b, c, 0.0, 0.0, circuit) for a, b, c in np.eye(3).tolist()]
    A = np.array([[np.broadcast_to(columns[j][i], R_g.shape) for j in range(3)] for i in range(3)])
    scales = [1.0 / np.sqrt(circuit.L_1), 1.0 / np.sqrt(circuit.C), np.sqrt(np.abs(A[2, 1]))]
    sizes = [sum(np.abs(A[i, j]) * T_s * scales[j] / scales[i] for j in range(3)) for i in range(3)]
    return float(np.max(sizes))


def _circuit_tape(loop: InnerLoop) -> tuple[Program, tuple[tuple[int, float], ...]]:
    """From the first coordinate 1/SCR, sin and cos of the angle: \\|Z_g\\|, its inverse, and the entries of A, of the
    bridge's column and of the source's, from the equations run on one unit of each state and voltage."""
    tape = Tape()
    first, across, along = (tape.given(GRID) for _ in range(3))
    size: Any = SCR_BASES[loop.scr_basis].magnitude(first * loop.Z_base, across)
    circuit = loop.circuit._replace(R_g=size * along, L_g=size * across * (1.0 / loop.omega_n))
    columns = [filter_grid_derivative(a, b, c, v_b, v_g, circuit) for a, b, c, v_b, v_g in np.eye(5).tolist()]
    results: list[Form] = [size, size.reciprocal()]
    entries: list[tuple[int, float]] = []
    for value in [columns[j][i] for i in range(3) for j in range(3)] + [*columns[3], *columns[4]]:
        if isinstance(value, Form):
            entries.append((len(results), 0.0))
            results.append(value)
        else:
            entries.append((-1, float(value)))
    return program_of(tape, results), tuple(entries)


def _step_tape(loop: InnerLoop, entries: Sequence[tuple[int, float]]) -> Program:
    """From the outputs of the circuit's tape: A Ψ, Ψ b, and the rest."""
    tape = Tape()
    given = [tape.given(GRID) for _ in range(max(k for k, _ in entries) + 1)]
    values = [given[k] if k >= 0 else number for k, number in entries]
    A, bridge, source = [values[:3], values[3:6], values[6:9]], values[9:12], values[12:15]
    T = loop.T_s
    nothing = given[0] * 0.0
    total: list[Triple] = [[nothing + (1.0 if i == j else 0.0) for j in range(3)] for i in range(3)]
    for k in range(loop.terms + 1, 1, -1):
        product = _matrix_product(A, total)
        total = [[product[i][j] * (T / k) + (1.0 if i == j else 0.0) for j in range(3)] for i in range(3)]
    psi = [[total[i][j].widened(3 * i + j) for j in range(3)] for i in range(3)]
    transition = _matrix_product(A, psi)
    driven = [_dot(row, bridge) for row in psi]
    stepped, across = _adjugate_product(_shifted(transition, _start(loop)), driven)
    # The source's own response is that of the continuous circuit. What both have in common cancels.
    of_source, within = _adjugate_product(_shifted(A, 1j * loop.omega_g), source)
    node = [capacitor_node_voltage(x[0], x[1], x[2], loop.circuit) for x in (stepped, of_source)]
    both = (node[0] * of_source[2] - node[1] * stepped[2]).reciprocal()
    per_v = [of_source[2] * both, -(stepped[2] * both)]
    per_i = [-(node[1] * both), node[0] * both]
    results = [*(x for row in transition for x in row), *driven]
    for per in (per_v, per_i):
        results.append(stepped[0] * per[0] + of_source[0] * per[1])
    results += [across * per_v[0], across * per_i[0], within * per_v[1], within * per_i[1] * given[1]]
    return program_of(tape, results)


def _arc_tape(loop: InnerLoop) -> Program:
    """From z − 1 and what :meth:`CellForms.take` gives to :class:`ArcFunctions`."""
    tape = Tape()
    off = tape.given(ARC)
    size, inverse = tape.given(GRID), tape.given(GRID)
    transition = [[tape.given(GRID) for _ in range(3)] for _ in range(3)]
    driven = [tape.given(GRID) for _ in range(3)]
    i_s, v_b = (tape.given(GRID), tape.given(GRID)), (tape.given(GRID), tape.given(GRID))
    s = off * (1.0 / loop.T_s)
    plus, answers = _answers(loop, s, transition, driven, i_s, v_b)
    minus, others = _answers(loop, s.conjugate(), transition, driven, i_s, v_b)
    filters = [(polynomial_at(f.numerator, s), polynomial_at(f.denominator, s)) for f in loop.filters]
    weight: Any = 0.5 * PHASES
    if not loop.filters[0].plain:
        weight = filters[0][0] / filters[0][1] * weight
    ratio = []
    if loop.ratio:
        ratio = [filters[1][0] * filters[0][1] / (filters[1][1] * filters[0][0])]
    found = []
    for one in (answers, [x.conjugate() for x in others]):
        for k, x in enumerate(one):
            scaled = x * size if k in (2, 5) else x * inverse if k == 1 else x
            found.append(scaled * weight)
    one = (s + loop.divisor).reciprocal()
    every = [s, one * one * one, *found, *ratio, plus, minus, *(f[1] for f in filters)]
    return program_of(tape, every)


def _answers(
    loop: InnerLoop, s: Form, transition: list[Triple], driven: Triple, i_s: Any, v_b: Any
) -> tuple[Form, list[Form]]:
    """The inner loops' polynomial, and v and i_g of one sequence for jδ (the part with v and that with i_g at rest)
    and for ln V, per V at rest."""
    rows = loop.rows
    turn = complex(np.exp(1j * loop.omega_g * loop.T_s))
    turning = s * turn + _start(loop)  # (z e^{jω_g T_s} − 1)/T_s
    answer, across = _adjugate_product(_shifted(transition, turning), driven)
    own, k_is, k_vc, k_ig = (polynomial_at(p, s) for p in (rows.denominator, rows.i_s, rows.v_c, rows.i_g))
    held, fresh = own, own
    if rows.delay:
        waiting = polynomial_at(rows.waiting, s)
        held, fresh = own * (turning * loop.T_s + 1.0) - waiting, own * turn - waiting
    polynomial = held * across - k_is * answer[0] - k_vc * answer[1] - k_ig * answer[2]
    inverse = polynomial.reciprocal()
    # v_c at rest is v − R_c (i_s − i_g).
    R_c = loop.circuit.R_c
    direct = k_is - k_vc * R_c
    of_v = (fresh * v_b[0] - direct * i_s[0] - k_vc) * 1j
    of_i = (fresh * v_b[1] - direct * i_s[1] - (k_ig + k_vc * R_c)) * 1j
    of_V = polynomial_at(rows.V, s)
    node = capacitor_node_voltage(answer[0], answer[1], answer[2], loop.circuit) * inverse
    current = answer[2] * inverse
    return polynomial, [node * of_v, node * of_i, current * of_v, current * of_i, node * of_V, current * of_V]


def polynomial_at(polynomial: Polynomial, s: Form) -> Form:
    """A polynomial with its radii at a form."""
    total: Form | None = None
    for c, radius in zip(reversed(polynomial.coefficients), reversed(polynomial.radii), strict=True):
        if total is not None:
            total = (total * s).known_to(c, radius)
        elif c != 0.0 or radius != 0.0:
            total = (s * 0.0).known_to(c, radius)
    return s * 0.0 if total is None else total


def _start(loop: InnerLoop) -> complex:
    """(e^{jω_g T_s} − 1)/T_s."""
    return complex(np.expm1(1j * loop.omega_g * loop.T_s)) / loop.T_s


def _matrix_product(A: list[Triple], B: list[Triple]) -> list[Triple]:
    return [[_dot(row, [B[k][j] for k in range(3)]) for j in range(3)] for row in A]


def _dot(a: Triple, b: Triple) -> Any:
    """Σ a_k b_k without what is zero."""
    terms = [x * y for x, y in zip(a, b, strict=True) if not (_zero(x) or _zero(y))]
    return sum(terms[1:], start=terms[0]) if terms else 0.0


def _zero(x: Any) -> bool:
    return not isinstance(x, Form) and x == 0.0


def _shifted(A: list[Triple], by: Any) -> list[Triple]:
    """by·1 − A."""
    return [[by - A[i][j] if i == j else -A[i][j] for j in range(3)] for i in range(3)]


def _adjugate_product(W: list[Triple], x: Triple) -> tuple[Triple, Any]:
    """adj(W) x, which is W⁻¹x times det W, and det W."""
    cofactors = [[_cofactor(W, i, j) for j in range(3)] for i in range(3)]
    product = [_dot([cofactors[i][j] for i in range(3)], x) for j in range(3)]
    return product, _dot(W[0], cofactors[0])


def _cofactor(W: list[Triple], i: int, j: int) -> Any:
    a, b = (k for k in range(3) if k != i)
    c, d = (k for k in range(3) if k != j)
    if (i + j) % 2:
        c, d = d, c
    return W[a][c] * W[b][d] - W[a][d] * W[b][c]
