"""The inner loops by hand: controller and circuit in plain numbers, and what the power loops see of them on an arc.

Written from docs/theory/full-order-proof.md, not from the code that made the proof.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.certificate.recheck.polynomials import Polynomial, Space
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import NotchConstants, notch
from vsgdesign.study.parameters.study import Study

Array = Any

GRID = Space(2, 5)
"""Of the first coordinate and the angle of a cell."""
ARC = Space(3, 4)
"""Of these two and the frequency."""


@dataclass(frozen=True, kw_only=True)
class Inner:
    """The numbers of a study's inner loops and of the circuit around them, in SI."""

    T: float
    omega: float
    """Of the grid, rad/s."""
    omega_n: float
    Z_base: float
    by_reactance: bool
    L_1: float
    R_1: float
    C: float
    R_c: float
    L_2: float
    R_2: float
    delay: int
    numerators: dict[str, Array]
    """Coefficients of s^0, s^1, … of the bridge voltage by each input, and of the denominator."""
    filters: tuple[tuple[float, NotchConstants], ...]
    """Of P and of Q: 1 − exp(−T/τ), or 1, and the notch."""
    apart: bool = False
    """Whether small signals end at the node of equal units, whose rest is the one on the grid."""

    @classmethod
    def of(cls, study: Study, apart: bool = False) -> Inner:
        """Of a study's own converter."""
        c, f = study.converter, study.filter
        settings = study.controller_settings()
        constants = NotchConstants(settings.notch_gain, settings.notch_step, settings.notch_back)
        lags = [1.0 if tau == 0.0 else -math.expm1(-c.T_s / tau) for tau in (study.tau_P, study.tau_Q)]
        return cls(
            T=c.T_s,
            omega=study.grid_source.omega_g,
            omega_n=c.omega_n,
            Z_base=c.Z_base,
            by_reactance=study.scr_basis == "reactance",
            L_1=f.L_1,
            R_1=f.R_1,
            C=f.C,
            R_c=f.R_c,
            L_2=f.L_2,
            R_2=f.R_2,
            delay=c.delay_samples,
            numerators=_controller(study, float(settings.smoothing_t)),
            filters=tuple((lag, constants) for lag in lags),
            apart=apart,
        )

    @property
    def zeros(self) -> int:
        """How many zeros the polynomial of the inner loops has."""
        return 3 + len(self.numerators["own"]) - 1 + self.delay


def _controller(study: Study, smoothing: float) -> dict[str, Array]:
    """The quotients of the controller. With s the operator of a sample's difference over T, the integrators are
    1/s, and the transient impedance sees s/(s + smoothing/T) of the grid current."""
    c, f, g = study.converter, study.filter, study.inner_gains
    T, w = c.T_s, c.omega_n
    lead = np.exp(1j * w * (c.delay_samples + 0.5) * T)
    ahead = (g.kappa if c.delay_samples else 0.0) * T / f.L_1
    yields = g.R_t != 0.0 or g.X_t != 0.0
    low = np.array([smoothing / T, 1.0]) if yields else np.array([1.0])
    s = np.array([0.0, 1.0])
    a, b = np.array([g.K_ic, g.K_pc]), np.array([g.K_iv, g.K_pv])

    def product(*factors: Any) -> Array:
        total = np.array([1.0 + 0.0j])
        for factor in factors:
            total = np.convolve(total, factor)
        return total

    def total(*terms: Array) -> Array:
        found = np.zeros(max(map(len, terms)), dtype=complex)
        for term in terms:
            found[: len(term)] += term
        return found

    own = product(s, s, low)
    voltage = total(
        -product(a, b, low),
        (1j * w * f.C + ahead) * product(a, s, low),
        own,
    )
    drop = product(a, b, s) * (g.R_t + 1j * g.X_t) if yields else np.zeros(1)
    return {
        "own": own,
        "i_s": lead * total(-(1.0 - 1j * ahead * w * f.L_1) * product(a, s, low), 1j * w * f.L_1 * own),
        "v": lead * voltage,
        "i_g": lead * total(g.K_ff * product(a, s, low), -drop),
        "u": -lead * ahead * np.exp(-0.5j * w * T) * product(a, s, low),
        "V": lead * rms_to_peak(1.0) * product(a, b, low),
    }


@dataclass(frozen=True)
class Cells:
    """What depends on the grid alone, as polynomials of GRID with a column for each cell."""

    size: Polynomial
    """\\|Z_g\\| in Ω."""
    inverse: Polynomial
    along: Polynomial
    across: Polynomial
    """R/\\|Z_g\\| and X/\\|Z_g\\|, at the rated frequency."""
    stepping: tuple[tuple[Polynomial, ...], ...]
    """(Φ − 1)/T over scaled states."""
    driven: tuple[Polynomial, ...]
    """Γ/T of the bridge over scaled states."""
    scales: Array
    """Of the states, (3, N)."""
    rest: tuple[tuple[Polynomial, Polynomial], ...]
    """At rest, i_s, the bridge's voltage and the source's: by one volt at the control point, and by one ampere into the
    grid."""


def cells_of(inner: Inner, low: Array, high: Array) -> Cells:
    """Of cells between limits (N, 2) of the first coordinate and the angle."""
    first = GRID.variable(low[:, 0], high[:, 0], 0)
    across, along = (GRID.sine(low[:, 1], high[:, 1], 1, k) for k in (0, 1))
    size = first * inner.Z_base / across if inner.by_reactance else first * inner.Z_base
    R, L = size * along + inner.R_2, size * across * (1.0 / inner.omega_n) + inner.L_2
    A, source, stepping, driven, scales = _circuit(inner, R, L)
    turn = np.exp(1j * inner.omega * inner.T)
    start = (turn - 1.0) / inner.T
    by_bridge, det_b = _solved([[start * (i == j) - stepping[i][j] for j in range(3)] for i in range(3)], driven)
    by_source, det_g = _solved([[1j * inner.omega * (i == j) - A[i][j] for j in range(3)] for i in range(3)], source)
    of_b, of_g = ([x * scale for x, scale in zip(xs, scales, strict=True)] for xs in (by_bridge, by_source))
    v_b, v_g = (x[1] + (x[0] - x[2]) * inner.R_c for x in (of_b, of_g))
    both = (v_b * of_g[2] - v_g * of_b[2]).reciprocal()
    # What a volt and an ampere ask of the bridge and of the source, each over its own determinant.
    ask = ((of_g[2] * both, -(of_b[2] * both)), (-(v_g * both), v_b * both))
    rest = []
    for of in (
        lambda one: of_b[0] * one[0] + of_g[0] * one[1],
        lambda one: det_b * one[0],
        lambda one: det_g * one[1],
    ):
        rest.append((of(ask[0]), of(ask[1])))
    if inner.apart:
        _, _, stepping, driven, scales = _circuit(inner, size * 0.0 + inner.R_2, size * 0.0 + inner.L_2)
    return Cells(
        size, size.reciprocal(), along, across, tuple(map(tuple, stepping)), tuple(driven), scales, tuple(rest)
    )  # fmt: skip


def _circuit(inner: Inner, R: Polynomial, L: Polynomial) -> tuple[Any, Any, Any, Any, Array]:
    """A and the column of the source, (Φ − 1)/T and Γ/T of the bridge with R and L behind the capacitor, all over
    scaled states; and the scales."""
    over_L = L.reciprocal()
    fixed = np.ones(len(over_L.radius))
    scales = np.array([fixed / math.sqrt(inner.L_1), fixed / math.sqrt(inner.C), np.sqrt(np.abs(over_L.centre))])
    nothing = R * 0.0
    A: list[list[Polynomial]] = [[nothing] * 3 for _ in range(3)]
    A[0] = [nothing + x / inner.L_1 for x in (-(inner.R_1 + inner.R_c), -1.0, inner.R_c)]
    A[1] = [nothing + x / inner.C for x in (1.0, 0.0, -1.0)]
    A[2] = [over_L * inner.R_c, over_L, -(over_L * (R + inner.R_c))]
    A = [[A[i][j] * (scales[j] / scales[i]) for j in range(3)] for i in range(3)]
    bridge = [nothing + 1.0 / inner.L_1 / scales[0], nothing, nothing]
    source = [nothing, nothing, -over_L * (1.0 / scales[2])]
    psi = _averaged(A, inner.T)
    return A, source, _matrix(A, psi), [_dot(row, bridge) for row in psi], scales


def _averaged(A: list[list[Polynomial]], T: float) -> list[list[Polynomial]]:
    """1 + TA/2! + (TA)²/3! + …, with a bound of what is left out in the largest row sum."""
    B = [[x * T for x in row] for row in A]
    size = float(np.max([sum(x.most for x in row) for row in B]))
    if not size < 30.0:
        raise ValueError(f"the circuit is too fast for a sample: |T A| = {size:.3g}")
    terms = 4
    while size ** (terms + 1) / math.factorial(terms + 2) > 1e-17:
        terms += 1
    total = [[B[0][0] * 0.0 + float(i == j) for j in range(3)] for i in range(3)]
    for k in range(terms + 1, 1, -1):
        product = _matrix(B, total)
        total = [[product[i][j] * (1.0 / k) + float(i == j) for j in range(3)] for i in range(3)]
    left = size ** (terms + 1) / math.factorial(terms + 2) * math.exp(size)
    return [[x.widened(left) for x in row] for row in total]


def _matrix(A: Any, B: Any) -> list[list[Polynomial]]:
    return [[_dot(row, [B[k][j] for k in range(3)]) for j in range(3)] for row in A]


def _dot(a: Any, b: Any) -> Polynomial:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _solved(W: Any, x: Any) -> tuple[list[Polynomial], Polynomial]:
    """det W · W⁻¹x, and det W, by Cramer's rule."""

    def det(M: Any) -> Polynomial:
        return (
            M[0][0] * (M[1][1] * M[2][2] - M[1][2] * M[2][1])
            - M[0][1] * (M[1][0] * M[2][2] - M[1][2] * M[2][0])
            + M[0][2] * (M[1][0] * M[2][1] - M[1][1] * M[2][0])
        )

    columns = [[[x[i] if j == k else W[i][j] for j in range(3)] for i in range(3)] for k in range(3)]
    return [det(M) for M in columns], det(W)


@dataclass(frozen=True)
class Arcs:
    """On arcs, polynomials of ARC with a column for each."""

    s: Polynomial
    answers: tuple[tuple[Polynomial, ...], tuple[Polynomial, ...]]
    """At z, and the conjugate of those at the conjugate of z: v over v at rest and \\|Z\\| i_g over v at rest, by jδ
    (the part of v at rest, and that of y) and by ln V: (v_1, v_y, v_V, i_1, i_y, i_V)."""
    characteristic: tuple[Polynomial, Polynomial]
    """The inner loops' polynomial at z and at the conjugate of z."""
    filters: tuple[Polynomial, Polynomial]
    """Of P and of Q."""


_PLACES = (0, 1)


def arcs_of(inner: Inner, cells: Cells, index: Array, low: Array, high: Array, alpha: float) -> Arcs:
    """On arcs between frequencies (n,) in rad/s, each of the cell at its ``index``."""
    s = ARC.exponential(1j * inner.T, -alpha * inner.T, low, high, 2) * (1.0 / inner.T)

    def on_arcs(x: Polynomial) -> Polynomial:
        return x.take(index).into(ARC, _PLACES)

    size, inverse = on_arcs(cells.size), on_arcs(cells.inverse)
    stepping = [[on_arcs(x) for x in row] for row in cells.stepping]
    driven, scales = [on_arcs(x) for x in cells.driven], cells.scales[:, index]
    rest = [(on_arcs(a), on_arcs(b)) for a, b in cells.rest[:2]]
    plus = _answers(inner, s, stepping, driven, scales, rest, (size, inverse))
    minus = _answers(inner, s.conjugate(), stepping, driven, scales, rest, (size, inverse))
    filters = tuple(_filtered(inner, s, *one) for one in inner.filters)
    others = tuple(x.conjugate() for x in minus[0])
    return Arcs(s, (tuple(plus[0]), others), (plus[1], minus[1]), (filters[0], filters[1]))


def _answers(
    inner: Inner, s: Polynomial, stepping: Any, driven: Any, scales: Array, rest: Any, sizes: Any
) -> tuple[list[Polynomial], Polynomial]:
    turn = np.exp(1j * inner.omega * inner.T)
    turned = s * turn + (turn - 1.0) / inner.T
    W = [[turned - stepping[i][j] if i == j else -stepping[i][j] for j in range(3)] for i in range(3)]
    x, det = _solved(W, driven)
    i_s, v_c, i_g = (one * scale for one, scale in zip(x, scales, strict=True))
    v = v_c + (i_s - i_g) * inner.R_c
    n = {name: _at(coefficients, s) for name, coefficients in inner.numerators.items()}
    z = s * inner.T + 1.0
    own = n["own"]
    held = own * (z * turn) - n["u"] if inner.delay else own
    characteristic = held * det - n["i_s"] * i_s - n["v"] * v - n["i_g"] * i_g
    inverse = characteristic.reciprocal()
    # δ turns what is measured back, and the bridge's new voltage forward; that which waits is at rest in αβ.
    fresh = own * turn - n["u"] if inner.delay else own
    (is_v, is_i), (b_v, b_i) = rest
    by_v = (fresh * b_v - n["i_s"] * is_v - n["v"]) * inverse * 1j
    by_y = (fresh * b_i - n["i_s"] * is_i - n["i_g"]) * inverse * sizes[1] * 1j
    by_V = n["V"] * (1.0 / rms_to_peak(1.0)) * inverse
    current = i_g * sizes[0]
    return [v * by_v, v * by_y, v * by_V, current * by_v, current * by_y, current * by_V], characteristic


def _at(coefficients: Array, s: Polynomial) -> Polynomial:
    """A polynomial of numbers, each off by rounding, at s."""
    total = s * 0.0 + coefficients[-1]
    for c in coefficients[-2::-1]:
        total = (total * s + c).widened(1e-13 * abs(c))
    return total


def _filtered(inner: Inner, s: Polynomial, smoothing: float, constants: NotchConstants) -> Polynomial:
    """The filtered power of a sample over the measured one."""
    z = s * inner.T + 1.0
    found = s * 0.0 + 1.0
    if smoothing < 1.0:
        found = z * smoothing / (s * inner.T + smoothing)
    if constants.gain:
        # Rows of the notch from one unit of the power, of the ripple and of the mean.
        (direct, b_1, b_2), (c_1, a_11, a_21), (c_2, a_12, a_22) = (
            notch(power, ripple, mean, *constants) for power, ripple, mean in np.eye(3).tolist()
        )
        over = ((z - a_11) * (z - a_22) - a_12 * a_21).reciprocal()
        first, second = (z - a_22) * b_1 + a_12 * b_2, (z - a_11) * b_2 + a_21 * b_1
        found = found * ((first * c_1 + second * c_2) * over + direct)
    return found
