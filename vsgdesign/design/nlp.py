"""The robust design of one cell as a smooth program for IPOPT, built once for a law and used for every cell.

Constraints hold in a few scenarios at a time; :mod:`vsgdesign.design.cell` adds the worst one until none is
violated. All are exact and smooth: responses by matrix exponential, disk margins without a singular value.
"""

from __future__ import annotations

import contextlib
import functools
import io
from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.box import Scenarios
from vsgdesign.design.evaluation import LawOfStudy
from vsgdesign.design.kernels import difference, square, times
from vsgdesign.design.search import (
    GUARD_MARGIN,
    MARGIN_AIM,
    MARGIN_RESERVE,
    WEIGHT_DAMPING,
    Variables,
    cell_objective,
    variables,
)
from vsgdesign.equations.power_flow import Lags, scheduled_jacobian, source_behind
from vsgdesign.execution.signals import interrupts_deferred
from vsgdesign.linear.model.compiled import InLanes
from vsgdesign.linear.model.coupled import coupled_function
from vsgdesign.linear.model.power_loops import numpy_on_symbols
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.study.parameters.specification import Specification

Array = NDArray[np.float64]

SLOTS = 6
"""Scenarios in the program at a time."""

KINDS: tuple[str, ...] = ("overshoot", "settling_time", "disk_margin", "inertia")
"""Promises that have a slack."""

_GUARD, _GUARD_PEAK = 0.6, 0.7
"""Shares of the 2 % band, of the overshoot and of the disk margin that a design uses at a node
(:eq:`settling-constraint`): a response that just touches the band would leave it between nodes, and its settling time
would jump; filters and delay take 1 to 2 % of the margin."""

_RESERVE = (0.35, 0.25, MARGIN_RESERVE)
"""What may be added to these shares where a promise would be broken otherwise."""

_FINE, _FINE_STEPS, _COARSE_STEPS = 20, 24, 18
"""Steps within a settling time, how many of those, and how many of twice the length after them."""
_TIMES = (*range(1, _FINE_STEPS + 1), *range(_FINE_STEPS + 2, _FINE_STEPS + 2 * _COARSE_STEPS + 1, 2))
"""When a response is looked at, in steps."""
_STRIDE = 6
"""Steps that are made as one: about the square root of them all."""
_FREQUENCIES = np.geomspace(1.0, 130.0, 10)
_TAYLOR, _LARGEST = 6, 1.6
"""Order of the series of a step, and the size of its matrix: that of fast modes, which are over after one step of
T/_FINE. The poles that are placed are a tenth of it."""
_CLEAR = 0.15
"""Disk margin of the differential mode within its decay, in the program."""
_CLEAR_REAL = 0.02
"""Product of (λ + d)/d over the modes of the loops in the program, where the differential mode is to have the decay d:
about by how much it has more."""
_SLOW = 3
"""States of the loops: angle, frequency and voltage. Those behind them are fast."""
_WEIGHT_RESERVE = 20.0


@dataclass(frozen=True)
class Solution:
    """One local solution: y, slacks by kind, and the constraint kind with the largest multiplier."""

    y: Array
    slacks: dict[str, float]
    prices: dict[str, float]
    """Change of the objective (natural logarithm of inertia, or of what replaces it) for 1 % of a promise."""
    iterations: int
    rest: Array
    """The other variables of the program, with which a next one begins."""


@functools.lru_cache(maxsize=8)
def robust_program(law: LawOfStudy, spec: Specification) -> RobustProgram:
    """The program of a law and a specification, kept for the next cell."""
    return RobustProgram(law, spec)


class RobustProgram:
    """IPOPT's view of a law and a specification: minimises :eq:`cell-objective`."""

    def __init__(self, law: LawOfStudy, spec: Specification) -> None:
        self.variables: Variables = variables(law.structure, spec)
        self._spec = spec
        count = len(self.variables.names)
        y, margin, slack = ca.MX.sym("y", count), ca.MX.sym("margin"), ca.MX.sym("slack", len(KINDS))
        reserve = ca.MX.sym("reserve")
        parameters = ca.MX.sym("p", len(fields(Scenarios)), SLOTS)
        centre, stiffness, pull = ca.MX.sym("centre", count), ca.MX.sym("stiffness"), ca.MX.sym("pull")
        x = ca.vertcat(y, margin, slack, reserve)
        self._rows, self._slopes = _of_all_slots(_slot_function(law, spec, self.variables), count)
        rows = self._rows(x, parameters)
        # H = A ω_0/(2 S k_1) at the design point, in logarithms; stiffness = ln(A ω_0/(2 S)).
        if spec.settles:
            log_inertia = stiffness - y[0] - float(np.log(self.variables.scale[0]))
            held = [
                log_inertia + slack[3] - float(np.log(max(spec.H_min, 1e-9))),
                float(np.log(spec.H_max)) - log_inertia + slack[3],
            ]
            price = -log_inertia
        else:
            held = [slack[3], slack[3]]
            price = WEIGHT_DAMPING * ca.sum1(y[:2])  # no more damping and bandwidth than needed
        aim = MARGIN_AIM * spec.disk_margin
        short = margin - spec.disk_margin * (GUARD_MARGIN - _RESERVE[2] * reserve) * (1.0 - slack[2])
        away = pull * ca.sum1(ca.DM(self.variables.pull) * (y - centre) ** 2)
        objective = cell_objective(price, ca.sum1(slack), _WEIGHT_RESERVE * reserve, aim - margin, away)
        others = ca.vertcat(short, *held)
        g = ca.vertcat(rows, others)
        p = ca.vertcat(ca.vec(parameters), centre, stiffness, pull)
        slopes = ca.vertcat(self._slopes(x, parameters), ca.jacobian(others, x))
        options = {
            "print_time": False,
            "jac_g": ca.Function("nlp_jac_g", [x, p], [g, slopes], ["x", "p"], ["g", "jac_g_x"]),
            "no_nlp_grad": True,
            "calc_lam_p": False,  # nobody asks for multipliers of parameters
            "show_eval_warnings": False,  # IPOPT steps back by itself from where a determinant vanishes
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": 80,
                "tol": 1e-5,
                "acceptable_tol": 1e-3,
                "acceptable_iter": 5,
                "hessian_approximation": "limited-memory",
                "mu_strategy": "adaptive",
                # Many rows, few columns: without these two the linear algebra takes as long as everything else.
                "limited_memory_aug_solver": "extended",
                "mumps_pivot_order": 0,
            },
        }
        self._solver = ca.nlpsol("cell", "ipopt", {"x": x, "p": p, "f": objective, "g": g}, options)
        self._kinds = np.array([*(_row_kinds(spec) * SLOTS), "disk_margin", "inertia", "inertia"])
        self._aim = aim

    def solve(
        self,
        start: Array,
        centre: Array,
        slots: Scenarios,
        stiffness: float,
        pull: float,
        ceiling: Array,
        before: Solution | None = None,
    ) -> Solution | None:
        """A local solution from a start; None where IPOPT fails. ``slots`` holds at most SLOTS scenarios; ``pull``
        is how much being near the centre counts, ``ceiling`` the upper bounds of y. ``before``: a solution in other
        scenarios, whose margin and slacks are those to begin with."""
        v = self.variables
        packed = np.array([getattr(slots, f.name) for f in fields(Scenarios)])
        packed = packed[:, np.arange(SLOTS) % packed.shape[1]]
        parameters = np.concatenate([packed.T.ravel(), centre, [stiffness, pull]])
        first = np.concatenate([[0.9 * self._spec.disk_margin], np.full(len(KINDS), 0.1), [0.5]])
        begin = np.concatenate([start, first if before is None else before.rest])
        low = np.concatenate([v.low, [1e-2], np.zeros(len(KINDS) + 1)])
        high = np.concatenate([ceiling, [max(self._aim, 0.011)], np.full(len(KINDS), 50.0), [1.0]])
        # A start that fails is told by the result. An interrupt would end this solution and nothing else.
        with interrupts_deferred(), contextlib.redirect_stderr(io.StringIO()):
            found = self._solver(x0=begin, p=parameters, lbg=0.0, ubg=np.inf, lbx=low, ubx=high)
        x, multipliers = found["x"].full().ravel(), -found["lam_g"].full().ravel()
        if not np.isfinite(x).all():
            return None
        count = len(v.names)
        prices = {kind: 0.01 * float(np.sum(np.maximum(multipliers[self._kinds == kind], 0.0))) for kind in KINDS}
        slacks = dict(zip(KINDS, x[count + 1 : -1].tolist(), strict=True))
        iterations = int(self._solver.stats()["iter_count"])
        return Solution(np.clip(x[:count], v.low, ceiling), slacks, prices, iterations, x[count:])


def _of_all_slots(slot: ca.Function, count: int) -> tuple[InLanes, InLanes]:
    """(x, scenarios) → the rows of all slots, and their derivatives by x. ``count``: how many of x are y."""
    x, scenario = ca.SX.sym("x", count + len(KINDS) + 2), ca.SX.sym("p", len(fields(Scenarios)))
    one = ca.SX.sym("one")  # in place of a number, with which CasADi would put constants together: other bits
    rows = slot(x[:count], x[count], x[count + 1 : -1], x[-1], scenario)
    slopes = ca.sparsify(ca.jtimes(rows, x, one * ca.SX.eye(x.shape[0])))
    given = [x, scenario, one]
    return (
        InLanes(ca.Function("rows", given, [rows]), SLOTS, [1.0]),
        InLanes(ca.Function("slopes", given, [slopes]), SLOTS, [1.0]),
    )


def _row_kinds(spec: Specification) -> list[str]:
    """The promise behind every row of a slot, in the order of :func:`_slot_function`."""
    kinds: list[str] = []
    if spec.settles:
        peaks, tails = _times()
        kinds += (["overshoot"] * len(peaks) + ["settling_time"] * (2 * len(tails))) * 2
    rows = 2 * len(_FREQUENCIES) + (2 * (len(_FREQUENCIES) + 1) + 1) * (spec.differential_decay > 0.0)
    return kinds + ["disk_margin"] * rows


def _times() -> tuple[list[int], list[int]]:
    """Sample numbers at which overshoot is held, and those from the settling time on at which the band is."""
    coarse = range(_FINE_STEPS, _FINE_STEPS + _COARSE_STEPS)
    return list(range(1, _FINE - 1)), [*range(_FINE - 1, _FINE_STEPS), *coarse[:10], *coarse[11::2]]


def _slot_function(law: LawOfStudy, spec: Specification, v: Variables) -> ca.Function:
    """(y, margin, slacks, scenario) → rows that are ≥ 0 where a design keeps its promises in one scenario."""
    y, margin, slack = ca.SX.sym("y", len(v.names)), ca.SX.sym("margin"), ca.SX.sym("slack", len(KINDS))
    reserve = ca.SX.sym("reserve")
    s = Scenarios(*(ca.SX.sym(f.name) for f in fields(Scenarios)))
    with numpy_on_symbols():
        A_hat, B_hat, C_hat, D_hat = scheduled_jacobian(s.P, s.Q, s.V_rms, s.R_hat, s.X_hat)
        gains = law.gains_of_jacobian(A_hat, B_hat, C_hat, D_hat, v.expression(y, ca.exp))
    lags = law.lags
    model = coupled_function(lags.tau_P > 0.0, lags.tau_Q > 0.0, yields=lags.yields)
    found = model(s.delta, s.V_rms, s.V_g_rms, s.R, s.X, *gains, *lags)
    A, B, C, J = (*found[:3], found[7])
    A_o, B_o, C_o, J_o = found[12:] if lags.yields else found[4:8]
    rows: list[Any] = []
    if spec.settles:
        stiffness = J[1, 1] - J[1, 0] * J[0, 1] / J[0, 0]
        finals = (1.0, stiffness / (stiffness + gains.D_q))
        responses = _responses(A, B[:, :2], C[:2, :], spec.settling_time, _fastest(lags))
        peaks, tails = _times()
        for own, final in zip(responses, finals, strict=True):
            error = [value / final - 1.0 for value in own]
            rows += [
                (_GUARD_PEAK + _RESERVE[1] * reserve) * spec.overshoot * (1.0 + slack[0]) - error[k] for k in peaks
            ]
            band = (_GUARD + _RESERVE[0] * reserve) * SETTLING_BAND * (1.0 + 5.0 * slack[1])
            rows += [band - error[k] for k in tails] + [band + error[k] for k in tails]
    rows += _margin_rows(A_o, B_o, C_o, J_o, margin, _FREQUENCIES / spec.settling_time)
    if law.apart is not None:
        rows += _differential_rows(law, spec, s, gains, slack[2])
    scenario = ca.vertcat(*(getattr(s, f.name) for f in fields(Scenarios)))
    return ca.Function("slot", [y, margin, slack, reserve, scenario], [ca.vertcat(*rows)])


def _differential_rows(law: LawOfStudy, spec: Specification, s: Scenarios, gains: Any, slack: Any) -> list[Any]:
    """A little disk margin of the differential mode, seen by what decays as fast as is asked for: with A + d in place
    of A, no mode is slower than d where the loop keeps clear of −1."""
    lags, (R, L) = law.lags, law.apart or (0.0, 0.0)
    X = s.omega_g * L
    with numpy_on_symbols():
        V_g, delta = source_behind(s.P, s.Q, s.V_rms, R, X)
    model = coupled_function(lags.tau_P > 0.0, lags.tau_Q > 0.0, yields=lags.yields)
    found = model(delta, s.V_rms, V_g, R, X, *gains, *lags)
    A, B, C, J = found[12:] if lags.yields else found[4:8]
    shifted = A + spec.differential_decay * ca.SX.eye(A.shape[0])
    frequencies = np.concatenate([[0.0], _FREQUENCIES / spec.settling_time])
    # Clear of −1 is also what lies behind it: a real mode that is slower than d. The determinant tells the sides apart.
    side = slow_determinant(found[0] + spec.differential_decay * ca.SX.eye(A.shape[0])) / spec.differential_decay**3
    rows = _margin_rows(shifted, B, C, J, _CLEAR * (1.0 - slack), frequencies)
    return [*rows, side - _CLEAR_REAL * (1.0 - slack)]


def slow_determinant(A: Any) -> Any:
    """−det of A without its states from the fourth on: filters and what the plant yields, which are fast. Positive
    where an even number of modes of the others is to the right of zero."""
    n = A.shape[0]
    M = [[A[i, j] for j in range(n)] for i in range(n)]
    for k in range(n - 1, _SLOW - 1, -1):
        for i in range(k):
            factor = M[i][k] / M[k][k]
            for j in range(k):
                M[i][j] = M[i][j] - factor * M[k][j]
    return -ca.det(ca.blockcat([row[:_SLOW] for row in M[:_SLOW]]))


def _fastest(lags: Lags) -> float:
    """The least time constant of what stands between the loops and the power flow, s."""
    return min(lags.tau_P or 1e9, lags.tau_Q or 1e9, 1.0 / lags.omega_t if lags.yields else 1e9)


def _responses(A: Any, B: Any, C: Any, settling_time: float, tau: float) -> tuple[list[Any], list[Any]]:
    """Own-channel unit step responses of P and Q at multiples of T/_FINE, then of twice that."""
    n, h = A.shape[0], settling_time / _FINE
    squarings = max(int(np.ceil(np.log2(h * (1.0 / tau + 20.0 / settling_time) / _LARGEST))), 0)
    # e^M to M^6/6! in three products of matrices, and its integral times B to the order that leaves every mode at its
    # exact rest.
    M = A * (h / 2.0**squarings)
    square_, cube = ca.mtimes(M, M), ca.mtimes(M, ca.mtimes(M, M))
    identity = ca.SX.eye(n)
    phi = identity + M + square_ / 2.0
    phi += ca.mtimes(cube, identity / 6.0 + M / 24.0 + square_ / 120.0 + cube / 720.0)
    term = drive = B * (h / 2.0**squarings)
    for k in range(1, _TAYLOR):
        term = ca.mtimes(M, term) / (k + 1.0)
        drive += term
    step = phi, drive
    for _ in range(squarings):
        step = _after(step, step)
    twice = _after(step, step)
    strides = _after(_after(twice, twice), twice)
    found = []
    for channel in (0, 1):
        # A response after g strides and b steps more: what b steps make of the output, and the state after g strides.
        rows, offsets = [C[channel, :]], [ca.SX(0.0)]
        for _ in range(1, _STRIDE):
            offsets.append(offsets[-1] + ca.mtimes(rows[-1], step[1][:, channel]))
            rows.append(ca.mtimes(rows[-1], step[0]))
        states = [ca.SX.zeros(n)]
        for _ in range(_TIMES[-1] // _STRIDE):
            states.append(ca.mtimes(strides[0], states[-1]) + strides[1][:, channel])
        found.append([ca.mtimes(rows[k % _STRIDE], states[k // _STRIDE]) + offsets[k % _STRIDE] for k in _TIMES])
    return found[0], found[1]


def _after(later: tuple[Any, Any], first: tuple[Any, Any]) -> tuple[Any, Any]:
    """Transition and drive of two stretches of time, one after the other."""
    return ca.mtimes(later[0], first[0]), later[1] + ca.mtimes(later[0], first[1])


def _margin_rows(A_K: Any, B_K: Any, C_K: Any, J: Any, margin: Any, omegas: Array) -> list[Any]:
    """:func:`_rows_at` at each frequency: written once, with a symbol for the frequency."""
    out = ca.mtimes(J, C_K)
    matrices = [ca.mtimes(A_K, A_K), B_K, out, ca.mtimes(out, A_K)]
    A_sq, B, C, CA = symbols = [ca.SX.sym("k", matrix.shape[0], matrix.shape[1]) for matrix in matrices]
    r, omega = ca.SX.sym("r"), ca.SX.sym("omega")
    at = ca.Function("at", [*symbols, r, omega], _rows_at(A_sq, B, C, CA, r, omega))
    return [row for value in omegas for row in at.call([*matrices, 1.0 / margin**2, ca.SX(float(value))])]


def _rows_at(A_sq: Any, B: Any, C: Any, CA: Any, r: Any, omega: Any) -> list[Any]:
    """With r = 1/α²: r² − t r + d ≥ 0 and r ≥ t/2 at a frequency (:eq:`margin-constraint`), both over r's size.

    The loop is C(jω − A)⁻¹B = −(CA + jωC)(A² + ω²)⁻¹B, so that what is solved is real.
    """
    x = _solved(A_sq + omega**2 * ca.SX.eye(A_sq.shape[0]), B)
    re, im = -ca.mtimes(CA, x), -omega * ca.mtimes(C, x)
    L = [[(re[i, j], im[i, j]) for j in (0, 1)] for i in (0, 1)]
    one = (1.0, 0.0)
    a11, a22 = difference(one, L[0][0]), difference(one, L[1][1])
    a12, a21 = difference((0.0, 0.0), L[0][1]), difference((0.0, 0.0), L[1][0])
    inverse = _reciprocal(difference(times(a11, a22), times(a12, a21)))
    m11, m22 = (difference(times(a, inverse), (0.5, 0.0)) for a in (a22, a11))
    m12, m21 = times(a12, inverse), times(a21, inverse)
    t = square(m11) + square(m22) + 2.0 * ca.sqrt(square(times(m12, m21)) + 1e-18)
    d = square(difference(times(m11, m22), times(m12, m21)))
    return [1.0 - t / r + d / r**2, 1.0 - 0.5 * t / r]


def _solved(M: Any, B: Any) -> Any:
    """M⁻¹ B, by elimination from the last state up."""
    n = M.shape[0]
    rows = [ca.horzcat(M[i, :], B[i, :]) for i in range(n)]
    for k in range(n - 1, -1, -1):
        rows[k] = rows[k] / rows[k][k]
        for i in range(k):
            left = ca.horzcat(rows[k][:k], ca.SX(1, n - k), rows[k][n:])
            rows[i] = rows[i] - rows[i][k] * left
    x: list[Any] = []
    for k in range(n):
        x.append(rows[k][n:] - sum((rows[k][j] * x[j] for j in range(k)), ca.SX.zeros(1, B.shape[1])))
    return ca.vertcat(*x)


def _reciprocal(a: Any) -> tuple[Any, Any]:
    size = square(a)
    return a[0] / size, -a[1] / size
