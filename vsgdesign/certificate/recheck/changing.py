"""Gains that change, by hand: all gains of an estimate in a ball about one of them, and the gain of the loop around the
ball.

Written from docs/theory/full-order-moving.md, not from the code that made the proof.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from vsgdesign.certificate.recheck.inner import Arcs, Cells
from vsgdesign.certificate.recheck.loops import PAIR, Ball, Boxes, Loops, boxes_of, jacobians, loop_of, made_of
from vsgdesign.certificate.recheck.polynomials import Polynomial

Array = Any

_PIECES = 6
"""Of the range of each error on which the gains are enclosed."""


def feeds_of(loops: Loops, at: Boxes, J: tuple[Polynomial, ...]) -> list[list[Any]]:
    """The rows of :eq:`moving-feeds` from the ball's first on, as polynomials of PAIR or numbers."""
    g = made_of(loops, at, J)
    K_ip, K_pq, K_qp, K_iq, k_P, k_Q, D_p = (g[n] for n in ("K_ip", "K_pq", "K_qp", "K_iq", "k_P", "k_Q", "D_p"))
    every: list[list[Any]] = [[k_P, k_Q]]
    if _nothing(k_P) and _nothing(k_Q):
        every += [[K_ip, K_pq], [K_qp, K_iq]]
    else:
        free = 1.0 - k_P * D_p
        every += [
            [K_ip, K_pq + (K_pq * k_P - K_ip * k_Q) * D_p / free],
            [free * K_qp, K_iq - K_qp * D_p * k_Q],
        ]
    return every[_ball(loops).first :]


def middles_of(loops: Loops, at: Boxes) -> list[tuple[Array, tuple[Polynomial, ...]]]:
    """The Jacobians of the middle, each with the boxes in which it is the one that is looked at, (N,): the first that
    may occur there. The ball may be about any gains."""
    found, taken = [], np.zeros(len(at.drop.radius), dtype=np.bool_)
    for good, J in jacobians(loops, at):
        found.append((good & ~taken, J))
        taken = taken | good
    return found


def reach_of(
    loops: Loops, cells: Cells, index: Array, limits: tuple[Array, Array, Array], at: Boxes, middles: Any
) -> Array:
    """β of :eq:`moving-ball` for boxes between limits (N, 6) with their estimates: a bound over all errors and over all
    Jacobians that may occur."""
    low, high, estimates = limits
    ball, most = _ball(loops), np.zeros(len(low))
    inverses = np.linalg.inv(ball.left), np.linalg.inv(ball.right)
    # What an inverse is off by: a few roundings of the product of the sizes.
    off = [np.linalg.norm(np.abs(b) @ np.abs(a)) for a, b in zip((ball.left, ball.right), inverses, strict=True)]
    about = [(good, feeds_of(loops, at, J)) for good, J in middles]
    edges = np.linspace(-loops.region.largest_error, loops.region.largest_error, _PIECES + 1)
    for i, j in itertools.product(range(_PIECES), repeat=2):
        own_low, own_high = low.copy(), high.copy()
        own_low[:, 2:4], own_high[:, 2:4] = (edges[i], edges[j]), (edges[i + 1], edges[j + 1])
        here = boxes_of(loops, cells, index, own_low, own_high, estimates)
        for good, J in jacobians(loops, here):
            others = feeds_of(loops, here, J)
            for own, middle in about:
                both = good & own
                if both.any():
                    size = _size(others, middle, inverses, len(low))
                    most = np.where(both, np.maximum(most, size), most)
    return most * (1.0 + 1e-12 + 1e-13 * float(np.prod(off)))


def _size(others: Any, middle: Any, inverses: tuple[Array, Array], count: int) -> Array:
    """A bound of \\|L⁻¹(G − G_0)R⁻¹\\| on N boxes, from the norms of all coefficients."""
    kind = len(PAIR.exponents)
    c, radius = np.zeros((len(others), 2, kind, count)), np.zeros((len(others), 2, count))
    for i, j in itertools.product(range(len(others)), range(2)):
        difference = others[i][j] - middle[i][j]
        if isinstance(difference, Polynomial):
            c[i, j], radius[i, j] = difference.c.real, difference.radius
        else:
            c[i, j, 0] = difference
    left, right = inverses
    turned = np.einsum("ij,jkmn,kl->nmil", left, c, right)
    rest = np.einsum("ij,jkn,kl->nil", np.abs(left), radius, np.abs(right))
    size = np.linalg.norm(turned, 2, axis=(2, 3)).sum(axis=1) + np.linalg.norm(rest, axis=(1, 2))
    return np.where(np.isfinite(size), size, np.inf)


def difference_of(loops: Loops, arcs: Arcs, arc: Array, at: Boxes, made: Any, box: Array, reach: Array) -> Polynomial:
    """\\|f\\|² − β²Σ\\|n\\|² on pairs of an arc and a box, by their numbers (n,) (:eq:`moving-difference`)."""
    ball = _ball(loops)
    f, m, FG, s, over = loop_of(loops, arcs, arc, at, made, box)
    k = {name: v.take(box) if isinstance(v, Polynomial) else v for name, v in made.items()}
    (P_d, Q_d), (P_V, Q_V) = FG
    m_11, m_12, m_21, m_22 = m
    droops = loops.kept_droops
    D_p, D_q, k_P, k_Q = (k["D_p"], k["D_q"], k["k_P"], k["k_Q"]) if droops else (0.0, 0.0, 0.0, 0.0)
    free = 1.0 - k_P * D_p
    determinant = m_11 * m_22 - m_12 * m_21
    total: Any = 0.0
    columns = np.vstack([np.zeros((ball.first, ball.left.shape[1])), ball.left])
    for a_1, a_2, a_3 in columns.T.tolist():
        b_1 = (s + k["K_ip"] * k["D_p"]) * a_1 + free * a_2
        b_2 = k["slope"] * a_1 + a_3
        delta, V = m_22 * b_1 - m_12 * b_2, m_11 * b_2 - m_21 * b_1
        y_2 = Q_d * delta + Q_V * V + V * D_q
        y_1 = P_d * delta + P_V * V
        if droops:
            y_1 = (y_1 + (s * delta - determinant * a_1) * D_p + y_2 * (k_Q * D_p)) / free
        for one, other in ball.right.tolist():
            n = (y_1 * one + y_2 * other) * over
            total = n * n.conjugate() + total
    beta = (reach[box] * (1.0 + 1e-12)) ** 2
    return f * f.conjugate() - total * beta


def _ball(loops: Loops) -> Ball:
    if loops.ball is None:
        raise ValueError("the gains of these loops do not change")
    return loops.ball


def _nothing(x: Any) -> bool:
    return not isinstance(x, Polynomial) and x == 0.0
