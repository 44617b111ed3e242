"""The controller between its measurements and the bridge as numbers: what the inner loops and the filters of the
powers do in one sample, from the derivatives of the equations themselves.

In the converter's own frame the inner loops are one complex linear system that no grid and no operating point changes.
As polynomials in s = (z − 1)/T_s (:eq:`full-order-controller`) their double integrator is s², multiplied out.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import PowerLoopGains, notch
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.full_order import controller_of, parameters_of
from vsgdesign.linear.operating_point.many import Lanes, lanes_of
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_OFF = 1e-12
"""Of a coefficient's size with all signs positive: more than what its entries, each the result of a few operations,
and the sums of products of at most five of them are off by."""

_REAL = 1e-9
"""Relative difference up to which a block of the derivative counts as one complex number."""


@dataclass(frozen=True)
class Polynomial:
    """Σ coefficients_k s^k, each coefficient known to within a radius."""

    coefficients: tuple[complex, ...]
    radii: tuple[float, ...]

    @property
    def degree(self) -> int:
        """Of the highest power with a coefficient."""
        return max((k for k, c in enumerate(self.coefficients) if c), default=0)


@dataclass(frozen=True)
class InnerRows:
    """The bridge voltage of a sample is Σ numerator·input/denominator (:eq:`full-order-controller`)."""

    denominator: Polynomial
    i_s: Polynomial
    v_c: Polynomial
    i_g: Polynomial
    waiting: Polynomial
    """Of the voltage that waits out the delay; zero without a delay."""
    V: Polynomial
    """Of the commanded voltage, peak."""
    delay: bool
    states: int
    """Of the complex system with the circuit."""


@dataclass(frozen=True)
class PowerFilter:
    """A measured power to the filtered one of the same sample: numerator over denominator."""

    numerator: Polynomial
    denominator: Polynomial

    @property
    def plain(self) -> bool:
        """Whether nothing is filtered."""
        return self.denominator.degree == 0


def determinant(constant: Any, slope: Any) -> Polynomial:
    """det(constant + s·slope) of small matrices (n, n), by all products (:eq:`full-order-controller`)."""
    constant, slope = np.asarray(constant, dtype=complex), np.asarray(slope, dtype=complex)
    n = len(constant)
    total, most = np.zeros(n + 1, dtype=complex), np.zeros(n + 1)
    for order in itertools.permutations(range(n)):
        sign = round(float(np.linalg.det(np.eye(n)[list(order)]))) if n else 1
        product, size = np.array([1.0 + 0.0j]), np.array([1.0])
        for row, column in enumerate(order):
            factor = np.array([constant[row, column], slope[row, column]])
            product, size = np.convolve(product, factor), np.convolve(size, np.abs(factor))
        total[: len(product)] += sign * product
        most[: len(size)] += size
    return Polynomial(tuple(total.tolist()), tuple((_OFF * most).tolist()))


def inner_rows(study: Study) -> InnerRows:
    """The inner loops of a study, from the derivative of its controller.

    Raises InfeasibleStudyError where they are not one complex system: where the limiter or the bridge's limit changes
    what small signals do.
    """
    c = study.converter
    controller = controller_of(study)
    names = ("i_s_d", "i_s_q", "v_c_d", "v_c_q", "i_g_d", "i_g_q", *controller.names)
    # Far from every limit: the derivative of what is linear is the same everywhere.
    V = rms_to_peak(c.V_rated_rms)
    rest = dict.fromkeys(names, 0.0) | {
        "omega_i": c.omega_n,
        "V": c.V_rated_rms,
        "v_c_d": V,
        "limiter_omega": c.omega_n,
    }
    # The current of the capacitor, and the voltage that waits: without them the prediction of the current is far off.
    rest |= {"i_s_q": c.omega_n * study.filter.C * V, "pending_d": V}
    z = np.array([rest[name] for name in names])
    one = np.ones(1)
    grid, source = study.grid, study.grid_source
    lanes = Lanes(grid.R_g * one, grid.L_g * one, source.V_g_rms * one, source.omega_g * one, 0.0 * one, 0.0 * one)
    every, gains = lanes_of(study, lanes, PowerLoopGains(1.0, 1.0, 1.0, 1.0))
    p = parameters_of(study, every, gains)[0]
    D = np.array(controller.linear(z, p)[1])
    outputs = (*controller.names, "applied_d", "applied_q")
    delay = c.delay_samples > 0
    fresh = "pending" if delay else "applied"
    follows = [name for name in ("xi_v", "xi_i", "i_f") if f"{name}_d" in names or f"{name}d" in names]

    def pair(name: str) -> tuple[str, str]:
        return (f"{name}d", f"{name}q") if f"{name}d" in (*names, *outputs) else (f"{name}_d", f"{name}_q")

    def entry(to: str, of: str) -> complex:
        rows, columns = ([outputs.index(x) for x in pair(to)], [names.index(x) for x in pair(of)])
        (a, b), (d, e) = D[np.ix_(rows, columns)]
        size = max(abs(a), abs(b), abs(d), abs(e))
        if abs(a - e) > _REAL * size or abs(b + d) > _REAL * size:
            raise InfeasibleStudyError(
                f"the inner loops are not alike in both axes ({to} by {of}): a limit acts at rest, or the limiter "
                f'"{study.limiter.name}" changes small signals.'
            )
        return complex(a, d)

    own = [outputs.index(x) for name in (*follows, fresh) for x in pair(name)]
    limiter = [k for k, name in enumerate(names) if name.startswith("limiter_")]
    if np.abs(D[np.ix_(own, limiter)]).max(initial=0.0) > _REAL:
        raise InfeasibleStudyError(
            f'the limiter "{study.limiter.name}" changes small signals: the proof has none of it.'
        )
    T = c.T_s
    n = len(follows)
    N = np.array([[entry(to, of) for of in follows] for to in follows]).reshape(n, n)
    back = np.array([entry(fresh, of) for of in follows])
    inputs = ["i_s", "v_c", "i_g", *(["pending"] if delay else [])]
    to_V = [complex(*(D[outputs.index(x), names.index("V")] for x in pair(to))) for to in (*follows, fresh)]
    columns = {of: [entry(to, of) for to in (*follows, fresh)] for of in inputs}
    columns["V"] = [value / rms_to_peak(1.0) for value in to_V]
    still = (np.eye(n) - N) / T
    slope = np.zeros((n + 1, n + 1))
    slope[:n, :n] = np.eye(n)

    def numerator(column: Sequence[complex]) -> Polynomial:
        bordered = np.zeros((n + 1, n + 1), dtype=complex)
        bordered[:n, :n] = still
        bordered[:n, n] = np.array(column[:n]) / T
        bordered[n, :n] = -back
        bordered[n, n] = column[n]
        return determinant(bordered, slope)

    found = {of: numerator(column) for of, column in columns.items()}
    nothing = Polynomial((0j,), (0.0,))
    return InnerRows(
        denominator=determinant(still, np.eye(n)),
        i_s=found["i_s"],
        v_c=found["v_c"],
        i_g=found["i_g"],
        waiting=found.get("pending", nothing),
        V=found["V"],
        delay=delay,
        states=3 + n + delay,
    )


def power_filter(study: Study, of_P: bool) -> PowerFilter:
    """The notch and the filter in front of a power loop, P's or Q's, from their equations run on one unit of each."""
    settings = study.controller_settings()
    smoothing = float(settings.smoothing_P if of_P else settings.smoothing_Q)
    constants = tuple(float(v) for v in (settings.notch_gain, settings.notch_step, settings.notch_back))
    has = study.has_notch

    def sample(power: float, ripple: float, mean: float, filtered: float) -> tuple[float, ...]:
        passed, ripple, mean = notch(power, ripple, mean, *constants)
        filtered = filtered + smoothing * (passed - filtered)
        return ripple, mean, filtered, filtered

    states = [*([0, 1] if has else []), *([2] if smoothing < 1.0 else [])]
    units = np.array([sample(*row) for row in np.eye(4)]).T  # rows: results; columns: power, ripple, mean, filtered
    n, T = len(states), study.converter.T_s
    A = units[np.ix_(states, [1 + k for k in states])]
    bordered = np.zeros((n + 1, n + 1))
    bordered[:n, :n] = (np.eye(n) - A) / T
    bordered[:n, n] = units[states, 0] / T
    bordered[n, :n] = -units[3, [1 + k for k in states]]
    bordered[n, n] = units[3, 0]
    slope = np.zeros((n + 1, n + 1))
    slope[:n, :n] = np.eye(n)
    return PowerFilter(determinant(bordered, slope), determinant(bordered[:n, :n], np.eye(n)))
