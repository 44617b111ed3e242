"""The proof of the sampled full-order loop beside a method of its own: the structured singular value on a grid of
frequencies, for cells of three studies (docs/theory/full-order-proof.md, "A second opinion").

A cell is a box about its middle in 1/SCR, the angle of the grid, P, Q and the two errors of the estimate; its
half-widths are multiplied by r. At one frequency the loop is det S(z, p) of three rows (:eq:`second-loop`), taken of
the model that the product linearises, and nothing of the proof. The upper bound with scalings D and G is a semidefinite
program of cvxpy. With dkpy in the environment its bound for complex blocks is compared; it takes no real ones.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from evidence._kept_runs import kept_runs
from evidence._tables import leave, table
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import Region, prove_full_order
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.moving.places import loops_at
from vsgdesign.certificate.region import System
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

ALPHA, FREQUENCIES, DRAWN, MOST, STEPS = 0.5, 40, 200, 3.0, 6
"""Decay that is proved, 1/s; frequencies; random points of a cell; largest multiple of the half-widths that is tried;
halvings of the interval in which the largest one lies."""


class Cell(NamedTuple):
    """Study, controller, middle (SCR on \\|Z\\|, X/R, P and Q in pu)."""

    study: str
    controller: str
    middle: tuple[float, float, float, float]


CELLS = {
    "laboratory, SCR 5, X/R 3": Cell("studies/laboratory/study.toml", "scheduled", (5.0, 3.0, 0.5, 0.1)),
    "utility, SCR 3, X/R 6": Cell("studies/utility/study.toml", "scheduled", (3.0, 6.0, 0.5, 0.05)),
    "table, SCR 3, X/R 0.6": Cell("studies/table/study.toml", "closed_form", (3.0, 0.6, 0.3, 0.0)),
    "table, SCR 5, X/R 3": Cell("studies/table/study.toml", "closed_form", (5.0, 3.0, 0.5, 0.1)),
}
HALF = np.array([0.1, 0.1, 0.2, 0.1, 0.2, 0.2])
"""Half-widths at r = 1: 1/SCR relative to its middle, rad, pu, pu, and both errors."""


class Situation(NamedTuple):
    """A cell with its study, and the middle as a point (6,)."""

    study: Study
    system: System
    middle: Array
    half: Array

    @classmethod
    def of(cls, cell: Cell) -> Situation:
        """From its numbers."""
        study = replace(load_study(cell.study), scr_basis="impedance")
        spec = next(one for one in study.controllers if one.name == cell.controller)
        scr, ratio, P, Q = cell.middle
        S = study.converter.S_rated
        middle = np.array([1.0 / scr, np.arctan(ratio), P * S, Q * S, 0.0, 0.0])
        half = HALF * [1.0 / scr, 1.0, S, S, 1.0, 1.0]
        own = cls(study, None, middle, half)  # type: ignore[arg-type]
        system, _ = prepared(study, spec, own.region(1.0), NOTHING, None, None)
        return own._replace(study=study.with_limit_of(spec), system=system)

    def region(self, r: float) -> Region:
        """The cell as a region."""
        low, high = self.middle - r * self.half, self.middle + r * self.half
        ratio = float(np.tan(low[1])), float(np.tan(high[1]))
        return Region((1.0 / high[0], 1.0 / low[0]), ratio, (low[2], high[2]), (low[3], high[3]), r * self.half[4])

    def matrices(self, shares: Array, r: float) -> tuple[Array, list[int]]:
        """A (N, n, n) where the coordinates are off the middle by shares (N, 6) of r half-widths, NaN outside the
        static limits, and the places of the power loops' states."""
        points = self.middle + shares * (r * self.half)
        loops = loops_at(self.study, self.system, points)
        A = np.where(self.system.within_limits(points)[:, None, None], loops.A, np.nan)
        return A, loops.moved


def shares_of_cell() -> Array:
    """The middle, both sides of it along each coordinate, all corners, and random points (N, 6)."""
    sides = np.concatenate([np.eye(6), -np.eye(6)])
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=6)))
    drawn = np.random.default_rng(5).uniform(-1.0, 1.0, (DRAWN, 6))
    return np.concatenate([np.zeros((1, 6)), sides, corners, drawn])


SHARES = shares_of_cell()


def holds(A: Array, T_s: float) -> bool:
    """Whether all matrices are those of a rest within the limits, with their eigenvalues inside the circle."""
    return bool(np.isfinite(A).all()) and float(np.abs(np.linalg.eigvals(A)).max()) < np.exp(-ALPHA * T_s)


class Uncertain(NamedTuple):
    """1 + left Δ right at one frequency: Δ has ``ranks`` times each of six real numbers, then one complex number for
    each of ``covered`` entries, all of at most 1."""

    M: Any
    ranks: tuple[int, ...]
    covered: int


def loops_of(A: Array, moved: list[int], z: complex) -> tuple[Any, Any]:
    """S(z) (N, 3, 3) of the power loops around all other states, and det(z − A) of these alone (N,)
    (:eq:`second-loop`)."""
    others = [k for k in range(A.shape[1]) if k not in moved]
    inner = z * np.eye(len(others)) - A[:, others][:, :, others]
    through = A[:, moved][:, :, others] @ np.linalg.solve(inner, A[:, others][:, :, moved].astype(complex))
    own = z * np.eye(3) - A[:, moved][:, :, moved] - through
    sign, size = np.linalg.slogdet(inner)
    return own, sign * np.exp(size - size[0])


def uncertain(values: Any, cover: bool) -> Uncertain:
    """Values (N, m, m) at SHARES as the middle times 1 + Σ δ_k N_k and, with ``cover``, one complex number for each
    entry of the rest, as large as it is at any of the points."""
    relative = values @ np.linalg.inv(values[0])
    count = values.shape[1]
    slopes = 0.5 * (relative[1:7] - relative[7:13])
    rest = relative - np.eye(count) - np.einsum("nk,kij->nij", SHARES, slopes)
    left, right, ranks = [], [], []
    for slope in slopes:
        u, s, vh = np.linalg.svd(slope)
        rank = int((s > 1e-6 * max(s[0], 1e-12)).sum()) if s[0] > 1e-12 else 0
        left.append(u[:, :rank] * np.sqrt(s[:rank]))
        right.append(np.sqrt(s[:rank])[:, None] * vh[:rank])
        ranks.append(rank)
    covered = 0
    if cover:
        most = np.abs(rest).max(axis=0)
        for i, j in itertools.product(range(count), repeat=2):
            if most[i, j] > 1e-12:
                left.append(np.eye(count)[:, [i]] * np.sqrt(most[i, j]))
                right.append(np.eye(count)[[j]] * np.sqrt(most[i, j]))
                covered += 1
    return Uncertain(-np.concatenate(right) @ np.concatenate(left, axis=1), tuple(ranks), covered)


def below_one(u: Uncertain) -> bool:
    """Whether the upper bound with D and G is below 1: no Δ makes it singular (:eq:`second-bound`)."""
    n = len(u.M)
    if n == 0 or np.linalg.norm(balanced(u.M), 2) < 1.0:
        return True
    return solved(u, 1.0, real=True)


def balanced(M: Any) -> Any:
    """M with scalings that make its rows as large as its columns."""
    size = np.abs(M) ** 2
    d = np.ones(len(M))
    for _ in range(30):
        scaled = size * (d[:, None] / d) ** 2
        row, column = scaled.sum(axis=1), scaled.sum(axis=0)
        d = d * (np.maximum(column, 1e-300) / np.maximum(row, 1e-300)) ** 0.125
    return M * (d[:, None] / d)


def solved(u: Uncertain, bound: float, real: bool) -> bool:
    """Whether M*DM + j(GM − M*G) < bound² D has D > 0 and, with ``real``, G: checked at what the solver finds."""
    import cvxpy

    D, G = [], []
    for rank in u.ranks:
        if rank:
            D.append(cvxpy.Variable((rank, rank), hermitian=True))
            G.append(cvxpy.Variable((rank, rank), hermitian=True))
    D += [cvxpy.Variable((1, 1), nonneg=True) for _ in range(u.covered)]
    G += [np.zeros((1, 1))] * u.covered
    whole, other = _diagonal(D), _diagonal(G if real else [0.0 * np.eye(one.shape[0]) for one in D])
    eye, M, t = np.eye(len(u.M)), u.M, cvxpy.Variable()
    inequality = M.conj().T @ whole @ M - bound**2 * whole
    if real:
        inequality = inequality + 1j * (other @ M - M.conj().T @ other)
    limits = [whole >> eye, inequality << t * eye, t >= -1.0]
    try:
        cvxpy.Problem(cvxpy.Minimize(t), limits).solve(solver=cvxpy.CLARABEL)
    except cvxpy.SolverError:
        return False
    if whole.value is None or inequality.value is None:
        return False
    d = np.linalg.eigvalsh(0.5 * (whole.value + whole.value.conj().T))
    found = inequality.value
    return bool(d.min() > 0.0 and np.linalg.eigvalsh(0.5 * (found + found.conj().T)).max() < 0.0)


def _diagonal(blocks: list[Any]) -> Any:
    import cvxpy

    sizes = [one.shape[0] for one in blocks]
    every = range(len(blocks))
    return cvxpy.bmat([[blocks[i] if i == j else np.zeros((sizes[i], sizes[j])) for j in every] for i in every])


def no_zero(at: Situation, r: float, cover: bool, T_s: float) -> bool:
    """Whether the bound excludes a zero at each frequency, and the middle is inside the circle."""
    A, moved = at.matrices(SHARES, r)
    if not np.isfinite(A).all() or not holds(A[:1], T_s):
        return False
    for omega in np.concatenate([[0.0], np.geomspace(0.1, np.pi / T_s, FREQUENCIES - 1)]):
        z = complex(np.exp((-ALPHA + 1j * omega) * T_s))
        own, others = loops_of(A, moved, z)
        if not all(below_one(uncertain(values, cover)) for values in (others[:, None, None], own)):
            return False
    return True


def largest(good: Any, most: float = MOST) -> float:
    """The largest multiple up to ``most`` at which something holds, to within a factor; 0 where it never does."""
    if good(most):
        return most
    low, high = 0.0, most
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if good(middle) else (low, middle)
    return low


def cell(name: str) -> dict[str, Any]:
    """Both methods on one cell."""
    at = Situation.of(CELLS[name])
    T_s = at.study.converter.T_s
    row: dict[str, Any] = {"cell": name, "true": largest(lambda r: holds(at.matrices(SHARES, r)[0], T_s))}
    beyond = at.matrices(SHARES, row["true"] + MOST * 0.5**STEPS)[0]
    row["ends"] = "end" if row["true"] == MOST else "mode" if np.isfinite(beyond).all() else "limit"
    for key, cover in (("affine", False), ("covered", True)):
        begin = time.process_time()
        row[key] = largest(lambda r, cover=cover: no_zero(at, r, cover, T_s), row["true"])
        row[f"{key}_s"] = time.process_time() - begin
    spec = next(one for one in at.study.controllers if one.name == CELLS[name].controller)
    prove_full_order(at.study, spec, at.region(0.05), decay=ALPHA, workers=1)  # compiles
    for key, r in (("same", row["covered"]), ("all", row["true"])):
        if r > 0.0:
            begin = time.process_time()
            try:
                found = prove_full_order(at.study, spec, at.region(r), decay=ALPHA, workers=1, seconds=300.0)
                row[key] = {"proved": found.proved, "boxes": found.boxes, "s": time.process_time() - begin}
            except InfeasibleStudyError as error:
                row[key] = {"refused": str(error)}
    return row | {"dkpy": _dkpy(at, max(0.5 * row["covered"], 0.1), T_s)}


def _dkpy(at: Situation, r: float, T_s: float) -> dict[str, Any] | str:
    """The bound for complex blocks at three frequencies: that of dkpy, and the least one at which ``solved`` holds."""
    try:
        import dkpy  # type: ignore[import-not-found]
    except ImportError:
        return 'dkpy is not installed ("pip install dkpy"): its bound is not compared.'
    A, moved = at.matrices(SHARES, r)
    found = []
    for omega in (1.0, 30.0, 300.0):
        u = uncertain(loops_of(A, moved, complex(np.exp((-ALPHA + 1j * omega) * T_s)))[0], True)
        blocks = [dkpy.ComplexDiagonalBlock(rank) for rank in u.ranks if rank]
        blocks += [dkpy.ComplexFullBlock(1, 1)] * u.covered
        try:
            theirs = dkpy.SsvLmiBisection(n_jobs=None, bisection_rtol=1e-3).compute_ssv(u.M[:, :, None], blocks)[0]
        except ValueError:
            return "dkpy found no bound."
        low, high = 0.5 * float(theirs[0]), 2.0 * float(theirs[0])
        for _ in range(11):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if solved(u, middle, real=False) else (middle, high)
        found.append([omega, float(theirs[0]), high])
    return {"at": found}


def main(folder: Path) -> None:
    """Both methods on all cells."""
    rows = kept_runs(cell, list(CELLS), folder / "second_opinion.jsonl", "cells", workers=1)
    head = ("cell", "stable at points up to r", "μ, first order", "μ, with the rest covered", "frequencies", "CPU s")
    head += ("zero exclusion at this r", "at the r of the points")
    leave(folder, "second_opinion", rows, table(head, [_row(row) for row in rows]))


def _row(row: dict[str, Any]) -> list[str]:
    def proved(one: dict[str, Any] | None) -> str:
        if one is None or "refused" in one:
            return "–" if one is None else one["refused"]
        share = "all" if one["proved"] >= 1.0 else f"{100.0 * one['proved']:.4g} %"
        return f"{share}, {one['boxes']:,} boxes, {one['s']:.2g} s"

    numbers = [f"{row[key]:.3g}" for key in ("true", "affine", "covered")]
    numbers[0] += {"limit": " (static limit)", "mode": " (a mode)", "end": " (no more was tried)"}[row["ends"]]
    numbers += [str(FREQUENCIES), f"{row['covered_s']:.0f}"]
    return [row["cell"], *numbers, *(proved(row.get(key)) for key in ("same", "all"))]
