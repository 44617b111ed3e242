"""A transfer function of one loop: from matrices to polynomials, its response, and the classical margins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

_ROUNDING_DB = 200.0
"""A gain margin beyond this is none: rounding moves a pole at s = 0 or a zero at infinity by some 1e-15 of the others,
and the loop then turns by half a turn where its gain is 1e13 or 1e-13."""


@dataclass(frozen=True)
class LoopMargins:
    """Classical margins of one loop; None where the loop crosses no such line."""

    gain_margin_db: float | None
    phase_margin_deg: float | None
    delay_margin_s: float | None
    crossover_rad_s: float | None


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """N(s)/D(s). ``numerator``, ``denominator``: real coefficients, the highest power of s first.

    For another library: ``control.tf(loop.numerator, loop.denominator)``.
    """

    numerator: Array
    denominator: Array

    def __call__(self, s: Any) -> Any:
        """The response at a complex frequency in rad/s, or at an array of them."""
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)

    def closed(self) -> TransferFunction:
        """The loop closed by unity feedback: N/(D + N)."""
        denominator = np.polyadd(self.denominator, self.numerator)
        return TransferFunction(self.numerator, np.asarray(denominator, dtype=float))


def transfer_function(A: Array, b: Array, c: Array) -> TransferFunction:
    """c (sI − A)⁻¹ b of a model with one input and one output: A (n, n), b (n, 1), c (1, n).

    Faddeev and LeVerrier's recursion, adj(sI − A) = Σ N_k sⁿ⁻¹⁻ᵏ: no polynomial is the difference of two others, so a
    coefficient that is zero by the model's structure has no rounding that could look like a far zero.
    """
    n, N = len(A), np.eye(len(A))
    numerator, denominator = [], [1.0]
    for k in range(1, n + 1):
        numerator.append((c @ N @ b).item())
        AN = A @ N
        denominator.append(-float(np.trace(AN)) / k)
        N = AN + denominator[-1] * np.eye(n)
    return TransferFunction(np.array(numerator), np.array(denominator))


def loop_margins(open_loop: TransferFunction) -> LoopMargins:
    """Margins of a single loop closed with unity feedback: where it has several, the one nearest to the limit.

    The crossings are roots of polynomials in ω²: |N|² = |D|², and Im(N D*) = 0 where N D* is not positive.
    """
    N_re, N_im = _along_the_axis(open_loop.numerator)
    D_re, D_im = _along_the_axis(open_loop.denominator)
    # ω N_im and ω D_im are the imaginary parts, and x = ω².
    no_pole_at_zero = open_loop.denominator[-1] != 0.0
    responses = open_loop(1j * _frequencies(N_im * D_re - N_re * D_im, zero=no_pole_at_zero))
    turned = responses[(responses.real <= 0.0) & (responses != 0.0)]
    gain_db = min((-20.0 * np.log10(np.abs(turned))).tolist(), key=abs, default=np.inf)
    x = np.poly1d([1.0, 0.0])
    crossovers = _frequencies(N_re * N_re + x * N_im * N_im - D_re * D_re - x * D_im * D_im)
    # From −180° up to 180°: how far the phase is from half a turn.
    phases_deg = np.remainder(np.degrees(np.angle(open_loop(1j * crossovers))), 360.0) - 180.0
    margins = list(zip(phases_deg.tolist(), crossovers.tolist(), strict=True))
    phase_deg, omega = min(margins, key=lambda one: abs(one[0]), default=(None, None))
    return LoopMargins(
        gain_margin_db=gain_db if abs(gain_db) < _ROUNDING_DB else None,
        phase_margin_deg=phase_deg,
        delay_margin_s=None if phase_deg is None or omega is None else float(np.deg2rad(phase_deg)) / omega,
        crossover_rad_s=omega,
    )


def _along_the_axis(polynomial: Array) -> tuple[np.poly1d, np.poly1d]:
    """p(jω) = r(x) + jω i(x) with x = ω²: the real polynomials r and i."""
    rising = np.asarray(polynomial, dtype=float)[::-1]
    parts = (rising[0::2], rising[1::2])
    r, i = (np.poly1d((part * (-1.0) ** np.arange(len(part)))[::-1] if len(part) else [0.0]) for part in parts)
    return r, i


def _frequencies(in_x: np.poly1d, zero: bool = False) -> Array:
    """ω > 0 in rad/s at which a polynomial in ω² vanishes; also ω = 0 where that is asked for."""
    roots = in_x.roots if in_x.order > 0 else np.zeros(0)
    x = np.real(roots[np.isreal(roots)])
    return np.sqrt(np.concatenate([np.zeros(1 if zero else 0), x[x > 0.0]]))
