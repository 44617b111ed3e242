"""The paper's open and closed power loops as transfer functions, and the classical margins of a loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.model import decoupled_loops

Array = NDArray[np.floating[Any]]


class Transfer(NamedTuple):
    """A transfer function: polynomials of s, highest power first, the denominator's first coefficient 1."""

    numerator: Array
    denominator: Array

    def __call__(self, s: Any) -> Any:
        """Its value at s, in 1/s."""
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)

    @property
    def closed(self) -> Transfer:
        """The loop closed with unity feedback."""
        return Transfer(self.numerator, np.polyadd(self.denominator, self.numerator))


@dataclass(frozen=True)
class PowerLoops:
    """G_op and G_cl of both loops, in W/W and var/var."""

    P_open: Transfer
    Q_open: Transfer

    @property
    def P_closed(self) -> Transfer:
        """G_cl of the P loop."""
        return self.P_open.closed

    @property
    def Q_closed(self) -> Transfer:
        """G_cl of the Q loop."""
        return self.Q_open.closed


@dataclass(frozen=True)
class LoopMargins:
    """Classical margins of one loop; None where the loop crosses no such line."""

    gain_margin_db: float | None
    phase_margin_deg: float | None
    delay_margin_s: float | None
    crossover_rad_s: float | None


def transfer_of(A: Array, b: Array, c: Array) -> Transfer:
    """c (sI − A)⁻¹ b of A (n, n), b (n, 1) and c (1, n), by Faddeev and LeVerrier: what is zero stays exactly zero."""
    step, numerator, denominator = np.eye(len(A)), [], [1.0]
    for k in range(1, len(A) + 1):
        numerator.append(float((c @ step @ b)[0, 0]))
        moved = A @ step
        denominator.append(-float(np.trace(moved)) / k)
        step = moved + denominator[-1] * np.eye(len(A))
    return Transfer(np.trim_zeros(np.array(numerator), "f"), np.array(denominator))


def power_loops(gains: PowerLoopGains, A: float, D: float) -> PowerLoops:
    """The decoupled loops (:eq:`decoupled-loops`; the paper's G_op and G_cl) for a Jacobian's A and D."""
    loop_P, loop_Q = decoupled_loops(gains, A, D)
    return PowerLoops(transfer_of(loop_P.A, loop_P.b, loop_P.c), transfer_of(loop_Q.A, loop_Q.b, loop_Q.c))


def loop_margins(open_loop: Transfer) -> LoopMargins:
    """Margins of a single loop closed with unity feedback: where it has several, the one nearest to the limit."""
    over = [(1j) ** np.arange(len(part) - 1, -1, -1) * part for part in open_loop]  # polynomials of ω
    (up_real, up_imag), (down_real, down_imag) = ((part.real, part.imag) for part in over)
    flips = np.polysub(np.polymul(up_imag, down_real), np.polymul(up_real, down_imag))
    response = open_loop(1j * _positive_roots(flips))
    negative = response[response.real < 0.0].real
    gains = 1.0 / np.abs(negative)
    crossings = _positive_roots(np.polysub(_square(up_real, up_imag), _square(down_real, down_imag)))
    phases = np.remainder(np.angle(open_loop(1j * crossings), deg=True), 360.0) - 180.0
    nearest = int(np.argmin(np.abs(phases))) if len(phases) else None
    phase, crossover = (None, None) if nearest is None else (float(phases[nearest]), float(crossings[nearest]))
    return LoopMargins(
        gain_margin_db=float(20.0 * np.log10(gains[np.argmin(np.abs(np.log(gains)))])) if len(gains) else None,
        phase_margin_deg=phase,
        delay_margin_s=None if phase is None or crossover is None else float(np.deg2rad(phase) / crossover),
        crossover_rad_s=crossover,
    )


def _square(real: Array, imag: Array) -> Array:
    """|p(jω)|² as a polynomial of ω."""
    return np.polyadd(np.polymul(real, real), np.polymul(imag, imag))


def _positive_roots(polynomial: Array) -> Array:
    """Real roots above zero, ascending."""
    found = np.roots(polynomial)
    return np.sort(found[np.isreal(found) & (found.real > 0.0)].real)
