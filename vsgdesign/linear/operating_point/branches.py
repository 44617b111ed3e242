"""Equations of branches and nodes, and what is left of them where some hold no derivative (:eq:`network-reduced`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NOTHING = 1e-9
"""Below this an entry of a matrix of signs and directions is zero. All others are of the order of one."""


class Equations(NamedTuple):
    """M dx/dt = (J − R) x + Σ B u and G x = 0, of all branches (:eq:`network-circuit`)."""

    M: Array
    """(n,): L of a current, C of a voltage; zero of a branch without inductance."""
    J: Array
    """(n, n): what voltages do to currents, and currents to voltages."""
    through: Array
    R: Array
    """(r, n) and (r,): the current through every resistance, and its value, Ω."""
    G: Array
    """(g, n): the nodes, and branches that are not there."""
    inputs: tuple[Array, ...]
    """(n, m) each: bridges and sources."""
    order: NDArray[np.intp] | None = None
    """In which order variables are expressed by the others, where there is a choice; None: those without a mass
    first."""


class Reduced(NamedTuple):
    """dq/dt = A q + Σ B u and x = X q + Σ X_u u, with as few states q as there are."""

    A: Array
    inputs: tuple[Array, ...]
    x: Array
    """(n, states): X."""
    of_inputs: tuple[Array, ...]
    """(n, m) each: X_u, where sources drive currents through resistances alone."""
    onto: Array
    """(states, n): what q is made of. Fluxes and charges stay as they are as far as the branches let them."""


class UndeterminedError(ValueError):
    """Some variables are not determined: branches without any resistance side by side, or sources in a loop."""

    def __init__(self, variables: list[int]) -> None:
        super().__init__(f"the variables {variables} are not determined")
        self.variables = variables
        """Those of which nothing says how large they are."""


def reduced(equations: Equations) -> Reduced:
    """The circuit without what holds no derivative. Raises UndeterminedError where the branches do not determine it."""
    M, J, through, R, G, inputs, order = equations
    K = J - through.T * R @ through
    inert = M > 0.0
    # All that the nodes allow. Where there is a choice, currents without inductance are expressed by the others.
    _, T = _pivots_and_null(G, np.argsort(inert, kind="stable") if order is None else order)
    with_mass, loops = _pivots_and_null(T[inert])
    T_m, T_0 = T[:, with_mass], T @ loops
    # Loops without inductance: where they have resistance, Ohm's law says the current. The others force the voltages of
    # capacitors to be equal, whatever current that takes.
    with_loss, bare = _pivots_and_null(through @ T_0)
    T_l, T_w = T_0[:, with_loss], T_0 @ bare
    forced, allowed = _pivots_and_null(T_w.T @ J @ T_m)
    fed = [T_w.T @ B for B in inputs]
    if len(forced) < T_w.shape[1] or any((np.abs(one) > _NOTHING).any() for one in fed):
        # The currents of loops that no capacitor closes, or of all of them where a source lies in one.
        closed = _pivots_and_null((T_w.T @ J @ T_m).T)[1] if len(forced) < T_w.shape[1] else np.eye(T_w.shape[1])
        raise UndeterminedError(np.flatnonzero((np.abs(T_w @ closed) > _NOTHING).any(axis=1)).tolist())
    T_m = T_m @ allowed
    by_law = T_l.T @ K @ T_l
    x = T_m - T_l @ np.linalg.solve(by_law, T_l.T @ K @ T_m)
    # What each of the states that are left is made of: fluxes and charges over their inductances and capacitances.
    mass = T_m.T * M @ T_m
    driven = [-T_l @ np.linalg.solve(by_law, T_l.T @ B) for B in inputs]
    onto, A, *acting = (
        np.asarray(np.linalg.solve(mass, T_m.T @ rows), dtype=np.float64)
        for rows in (np.diag(M), K @ x, *(B + K @ own for B, own in zip(inputs, driven, strict=True)))
    )
    # The currents that keep the forced voltages equal.
    coupled = T.T @ J @ T_w
    left = T.T @ (M[:, None] * (T_m @ A) - K @ x)
    x = x + T_w @ np.linalg.lstsq(coupled, left, rcond=None)[0]
    of_inputs = []
    for B, own, moved in zip(inputs, driven, acting, strict=True):
        left = T.T @ (M[:, None] * (T_m @ moved) - K @ own - B)
        of_inputs.append(own + T_w @ np.linalg.lstsq(coupled, left, rcond=None)[0])
    return Reduced(A, tuple(acting), x, tuple(of_inputs), onto)


def _pivots_and_null(matrix: Array, order: NDArray[np.intp] | None = None) -> tuple[list[int], Array]:
    """Columns of a matrix that are independent, and a basis of what it maps to zero, as columns: by elimination, the
    columns taken in a given order. The entries are of the order of one."""
    rows, size = np.array(matrix), matrix.shape[1]
    pivots: list[int] = []
    for column in range(size) if order is None else order.tolist():
        rank = len(pivots)
        if rank == len(rows):
            break
        best = rank + int(np.argmax(np.abs(rows[rank:, column])))
        if abs(rows[best, column]) < _NOTHING:
            continue
        rows[[rank, best]] = rows[[best, rank]]
        rows[rank] /= rows[rank, column]
        others = np.arange(len(rows)) != rank
        rows[others] -= np.outer(rows[others, column], rows[rank])
        pivots.append(column)
    free = [column for column in range(size) if column not in pivots]
    null = np.zeros((size, len(free)))
    null[free, range(len(free))] = 1.0
    null[pivots] = -rows[: len(pivots)][:, free]
    return pivots, null
