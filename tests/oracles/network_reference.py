"""The circuit with load, fault and breaker in phases a, b and c, from its branches and nodes alone.

It shares nothing with the library's circuit. Each branch has its own equation for each phase, every node its law of
currents, and the neutral points float. The unknowns that have no derivative of their own are found numerically: the
equations and their time derivatives are solved together, as they stand.
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.study.parameters import Grid, Study
from vsgdesign.study.parameters.grid import Load, Network

Array = NDArray[np.float64]

_RANK = 1e-11


class _Descriptor:
    """E dz/dt = A z + (inputs), row by row, of named unknowns. Units: A, V, ms, so that the entries are of one size."""

    def __init__(self) -> None:
        self.unknown: dict[str, int] = {}
        self.rows: list[tuple[dict[str, float], dict[str, float], dict[str, float]]] = []

    def use(self, *names: str) -> None:
        for name in names:
            self.unknown.setdefault(name, len(self.unknown))

    def row(self, derivative: dict[str, float], of: dict[str, float], inputs: dict[str, float] | None = None) -> None:
        self.use(*derivative, *of)
        self.rows.append((derivative, of, inputs or {}))

    def branch(
        self, i: str, begin: str | None, end: str | None, L: float, R: float, v: str = "", emf: str = ""
    ) -> None:
        """L di/dt = v_begin − v_end − R i − v + emf; None is a node without voltage."""
        of = {i: -R}
        for node, sign in ((begin, 1.0), (end, -1.0), (v or None, -1.0)):
            if node is not None:
                of[node] = of.get(node, 0.0) + sign
        self.row({i: 1e3 * L} if L else {}, of, {emf: 1.0} if emf else {})

    def matrices(self, inputs: list[str]) -> tuple[Array, Array, Array]:
        n = len(self.unknown)
        E, A, B = np.zeros((len(self.rows), n)), np.zeros((len(self.rows), n)), np.zeros((len(self.rows), len(inputs)))
        for k, (derivative, of, given) in enumerate(self.rows):
            for name, value in derivative.items():
                E[k, self.unknown[name]] = value
            for name, value in of.items():
                A[k, self.unknown[name]] = value
            for name, value in given.items():
                B[k, inputs.index(name)] = value
        return E, A, B


def states(shares: tuple[float, ...], load: bool) -> list[str]:
    """Names of the quantities that the oracle integrates, each of three phases."""
    named = ["i_s", "v_c", "i_2", *(f"i_g{k}" for k in range(len(shares) + 1))]
    return [*named, "i_lp", "v_cp", "i_ls", "v_cs"] if load else named


def describe(study: Study, grid: Grid, network: Network, shares: tuple[float, ...], load: bool) -> _Descriptor:
    """Kirchhoff's laws of the three phases."""
    d = _Descriptor()
    for p in "abc":
        d.use(*(f"{name}{p}" for name in states(shares, load)))
    for p in "abc":
        _describe_filter(d, study, p)
        at_pcc = {f"i_2{p}": 1.0, f"i_g0{p}": -1.0}
        if load:
            _describe_load(d, network.load or Load(), p, at_pcc)
        _describe_grid(d, grid, network, shares, p, at_pcc)
    d.row({}, {f"i_s{p}": 1.0 for p in "abc"})
    d.row({}, {f"i_c{p}": 1.0 for p in "abc"})
    if network.load is not None:
        currents = [f"{kind}{p}" for kind in ("i_r", "i_cp", "i_lp", "i_ls") for p in "abc"]
        d.row({}, dict.fromkeys([name for name in currents if name in d.unknown], 1.0))
        # The neutral voltage of capacitors follows from their charge, which begins at nothing.
        for name, there in (("v_cp", network.load.C_parallel), ("v_cs", network.load.C_series)):
            if there is not None:
                d.row({}, {f"{name}{p}": 1.0 for p in "abc"})
    if network.fault is not None and network.fault.kind == "three_phase":
        d.row({}, {f"i_f{p}": 1.0 for p in "abc"})
    return d


def _describe_filter(d: _Descriptor, study: Study, p: str) -> None:
    """The bridge's middle "m" and the neutral of the capacitors "n" float; that of the source is the reference."""
    f = study.filter
    d.branch(f"i_s{p}", "m", f"node{p}", f.L_1, f.R_1, emf=f"b{p}")
    d.row({}, {f"i_c{p}": 1.0, f"i_s{p}": -1.0, f"i_2{p}": 1.0})
    d.row({f"v_c{p}": 1e3 * f.C}, {f"i_c{p}": 1.0})
    d.row({}, {f"node{p}": 1.0, "n": -1.0, f"v_c{p}": -1.0, f"i_c{p}": -f.R_c})
    d.branch(f"i_2{p}", f"node{p}", f"pcc{p}", f.L_2, f.R_2)


def _describe_load(d: _Descriptor, load: Load, p: str, at_pcc: dict[str, float]) -> None:
    """Branches between the PCC and the neutral of the load. One that is not there has neither current nor charge."""
    if load.R_parallel is not None:
        d.branch(f"i_r{p}", f"pcc{p}", "load", 0.0, load.R_parallel)
        at_pcc[f"i_r{p}"] = -1.0
    if load.C_parallel is not None:
        d.row({f"v_cp{p}": 1e3 * load.C_parallel}, {f"i_cp{p}": 1.0})
        d.row({}, {f"pcc{p}": 1.0, "load": -1.0, f"v_cp{p}": -1.0})
        at_pcc[f"i_cp{p}"] = -1.0
    else:
        d.row({}, {f"v_cp{p}": 1.0})
    at_pcc[f"i_lp{p}"] = at_pcc[f"i_ls{p}"] = -1.0
    if load.L_parallel is not None:
        d.branch(f"i_lp{p}", f"pcc{p}", "load", load.L_parallel, 0.0)
    else:
        d.row({}, {f"i_lp{p}": 1.0})
    if (load.R_series, load.L_series, load.C_series) != (None, None, None):
        d.branch(f"i_ls{p}", f"pcc{p}", "load", load.L_series or 0.0, load.R_series or 0.0, v=f"v_cs{p}")
    else:
        d.row({}, {f"i_ls{p}": 1.0})
    if load.C_series is not None:
        d.row({f"v_cs{p}": 1e3 * load.C_series}, {f"i_ls{p}": 1.0})
    else:
        d.row({}, {f"v_cs{p}": 1.0})


def _describe_grid(
    d: _Descriptor, grid: Grid, network: Network, shares: tuple[float, ...], p: str, at_pcc: dict[str, float]
) -> None:
    """The grid's impedance in pieces, its breaker, and the fault at one of its nodes."""
    cuts = [0.0, *shares, 1.0]
    nodes, places = [at_pcc], [f"pcc{p}"]
    for k in range(len(cuts) - 1):
        share, last = cuts[k + 1] - cuts[k], k == len(cuts) - 2
        begin = places[-1]
        if k == 0 and not network.connected:  # an open breaker, whose voltage may be anything
            begin = f"open{p}"
            d.row({}, {f"i_g0{p}": 1.0})
        end = None if last else f"cut_{k + 1}{p}"
        d.branch(f"i_g{k}{p}", begin, end, share * grid.L_g, share * grid.R_g, emf=f"g{p}" if last else "")
        if end is not None:
            nodes.append({f"i_g{k}{p}": 1.0, f"i_g{k + 1}{p}": -1.0})
            places.append(end)
    if (fault := network.fault) is not None:
        at = cuts.index(fault.at)
        if fault.kind == "three_phase":
            d.branch(f"i_f{p}", places[at], "star", 0.0, fault.R)
            nodes[at][f"i_f{p}"] = -1.0
        elif p in fault.phases:  # from one phase to the other through the whole resistance
            first, second = fault.phases
            nodes[at]["i_f"] = -1.0 if p == first else 1.0
            if p == second:
                d.branch("i_f", places[at][:-1] + first, places[at], 0.0, fault.R)
    for node in nodes:
        d.row({}, node)


def explicit(d: _Descriptor, kept: int) -> tuple[Array, Array, Array]:
    """dx/dt = F x + G u of the first ``kept`` unknowns x, and P: what they become when this circuit begins.

    z and its derivatives solve E z' = A z + B u, E z'' = A z' + B u' and so on; what these say of x' is unique.
    """
    inputs = [f"{source}{p}" for source in "bg" for p in "abc"]
    E, A, B = d.matrices(inputs)
    m, n = A.shape
    # Unknown: the rest of z, its three derivatives, and two of u. Given: x and u.
    rest, zero, no_input = n - kept, np.zeros((m, n)), np.zeros_like(B)
    S = np.block(
        [
            [-A[:, kept:], E, zero, zero, no_input, no_input],
            [np.zeros((m, rest)), -A, E, zero, -B, no_input],
            [np.zeros((m, rest)), zero, -A, E, no_input, -B],
        ]
    )
    right = np.zeros((3 * m, kept + len(inputs)))
    right[:m, :kept], right[:m, kept:] = A[:, :kept], B
    left, sizes, _ = np.linalg.svd(S)
    rank = int(np.sum(sizes > _RANK * sizes[0]))
    solved = np.linalg.lstsq(S, right, rcond=_RANK)[0]
    slopes: Array = np.asarray(1e3 * solved[rest : rest + kept], dtype=np.float64)
    # x is possible where the equations have a solution for some u; how far inputs are free does not matter.
    obstacles = left[:, rank:].T @ right
    assert np.abs(obstacles[:, kept:]).max(initial=0.0) < 1e-9, "an input forces a state"
    _, sizes, basis = np.linalg.svd(obstacles[:, :kept])
    forbidden = basis[: int(np.sum(sizes > 1e-9))]
    mass = np.array([_mass(d, name) for name in list(d.unknown)[:kept]])
    return slopes[:, :kept], slopes[:, kept:], _nearest(mass, forbidden)


def _mass(d: _Descriptor, name: str) -> float:
    """L of a current, C of a voltage, zero where there is none."""
    return sum(derivative.get(name, 0.0) for derivative, _, _ in d.rows)


def _nearest(mass: Array, forbidden: Array) -> Array:
    """The possible state that an impulse of the forces of constraint reaches: M (x⁺ − x⁻) = forbiddenᵀ λ, and
    forbidden x⁺ = 0. What has no mass follows from forbidden x⁺ = 0 alone."""
    count, kept = forbidden.shape
    system = np.block([[np.diag(mass), -forbidden.T], [forbidden, np.zeros((count, count))]])
    given = np.zeros((kept + count, kept))
    given[:kept] = np.diag(mass)
    return np.asarray(np.linalg.lstsq(system, given, rcond=1e-13)[0][:kept], dtype=np.float64)


def clarke_matrices() -> tuple[Array, Array]:
    """From phases to (α, β), and back without zero sequence."""
    turns = [cmath.exp(2j * math.pi * k / 3.0) for k in range(3)]
    forth = np.array([[2.0 / 3.0 * turn.real for turn in turns], [2.0 / 3.0 * turn.imag for turn in turns]])
    return forth, np.array([[turn.real, turn.imag] for turn in turns])


def network_matrices(
    study: Study, grid: Grid, network: Network, shares: tuple[float, ...], load: bool
) -> tuple[Any, ...]:
    """(A, b, e, A', b', e') and the jump (P, P') on space vectors: dx/dt = A x + A' x* + b v_b + b' v_b* + e v_g + …"""
    names = states(shares, load)
    d = describe(study, grid, network, shares, load)
    order = [f"{name}{p}" for name in names for p in "abc"]
    assert list(d.unknown)[: 3 * len(names)] == [f"{name}{p}" for p in "abc" for name in names]
    F, G, P = explicit(d, 3 * len(names))
    place = [list(d.unknown).index(name) for name in order]
    F, G, P = F[np.ix_(place, place)], G[place], P[np.ix_(place, place)]
    forth, back = clarke_matrices()
    full_forth, full_back = np.kron(np.eye(len(names)), forth), np.kron(np.eye(len(names)), back)
    A, A_conj = _complex(full_forth @ F @ full_back)
    b, b_conj = _complex(full_forth @ G[:, :3] @ back)
    e, e_conj = _complex(full_forth @ G[:, 3:] @ back)
    jump, jump_conj = _complex(full_forth @ P @ full_back)
    found = [A, b[:, 0], -e[:, 0], A_conj, b_conj[:, 0], -e_conj[:, 0]]
    # What is left of the elimination where both axes are alike is rounding.
    unequal = [
        part * (np.abs(part).max() > 1e-10 * np.abs(of).max()) for part, of in zip(found[3:], found[:3], strict=True)
    ]
    return (*found[:3], *unequal), (jump, jump_conj)


def _complex(real: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """A real map of (α, β) pairs as x → A x + A' x*."""
    p, q, r, s = real[0::2, 0::2], real[0::2, 1::2], real[1::2, 0::2], real[1::2, 1::2]
    return 0.5 * (p + s) + 0.5j * (r - q), 0.5 * (p - s) + 0.5j * (r + q)
