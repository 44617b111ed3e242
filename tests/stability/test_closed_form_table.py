"""What the closed form delivers on the coupled model: the table of the theory page, from an independent route.

The oracle is the page's own transfer function, ΔP/ΔP_ref with c = BC/(AD), as partial fractions on a grid of 10 µs; the
library gets there by automatic differentiation, matrix exponentials and its metrics.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from tests.stability.studies import PUBLISHED, case_study
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.stability.loci import stability_limit
from vsgdesign.linear.stability.maps import cells_under, reduced_cells
from vsgdesign.linear.stability.margins import MarginTable, reduced_margins
from vsgdesign.linear.stability.step_responses import reduced_step_metrics
from vsgdesign.metrics.step_response import ResponseMetrics
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Place

Array = NDArray[np.floating[Any]]

P, Q, S, V_G = 4500.0, 1000.0, 5000.0, 110.0

# SCR (on the reactance): X/R: overshoot %, settling s, least damping, disk margin. T_s = 1 s, ξ = 1, q = 0.01. An
# independent computation, with its settling times taken on a grid of 2.5 ms (see the test).
TABLE: dict[float, dict[float, tuple[float, float, float, float]]] = {
    2: {0.5: (49, 3.79, 0.19, 0.24), 1: (12, 1.51, 0.56, 0.69), 2: (0.5, 1.17, 0.88, 1.18),
        3: (0, 1.58, 0.97, 1.42), 10: (0, 2.12, 0.94, 1.44)},
    5: {0.5: (54, 4.24, 0.16, 0.20), 1: (15, 1.98, 0.52, 0.63), 2: (1.9, 0.98, 0.80, 1.04),
        3: (0.3, 1.22, 0.90, 1.22), 10: (0, 1.52, 0.98, 1.42)},
    25: {0.5: (56, 4.23, 0.15, 0.19), 1: (16, 2.02, 0.50, 0.61), 2: (2.4, 1.53, 0.78, 1.01),
         3: (0.5, 1.16, 0.88, 1.17), 10: (0, 1.43, 0.98, 1.39)},
}  # fmt: skip
CELLS = [(scr, ratio) for scr, row in TABLE.items() for ratio in row]


@dataclass(frozen=True)
class Expected:
    """Figures of one cell from its transfer function."""

    overshoot_pct: float
    settling_s: float
    damping: float


def coupling(scr: float, ratio: float) -> float:
    """c = BC/(AD) at the operating point: A = b − Q, B = (P + g)/V, C = P − g, D = (b + Q)/V."""
    X = 3.0 * V_G**2 / S / scr
    R = X / ratio
    Z_sq = R * R + X * X
    b_0 = 2.0 * (R * P + X * Q) / 3.0 + V_G**2
    V_sq = 0.5 * (b_0 + math.sqrt(b_0**2 - 4.0 * Z_sq * (P * P + Q * Q) / 9.0))
    b, g = 3.0 * V_sq * X / Z_sq, 3.0 * V_sq * R / Z_sq
    return (P + g) * (P - g) / ((b - Q) * (b + Q))


def channel(c: float) -> tuple[Array, Array]:
    """Numerator and denominator of ΔP/ΔP_ref in closed form, with k₁ = 16, d₁ = 8, κ = 4, k₂ = 4/1.01."""
    k_1, d_1, kappa, k_2 = 16.0, 8.0, 4.0, 4.0 / 1.01
    den = np.polyadd(np.polymul([1.0, d_1, k_1], [1.0, kappa]), [-k_1 * k_2 * c])
    return k_1 * np.array([1.0, kappa - k_2 * c]), den


@cache
def expected(scr: float, ratio: float) -> Expected:
    num, den = channel(coupling(scr, ratio))
    poles = np.roots(den)
    residues, exponents, _ = signal.residue(num, np.polymul(den, [1.0, 0.0]))
    t = np.arange(0.0, 12.0, 1e-5)
    y = np.zeros(len(t))
    for r, p in zip(residues, exponents, strict=True):
        if p.imag > 0.0:  # stands for its conjugate too
            y += 2.0 * (r * np.exp(p * t)).real
        elif p.imag == 0.0:
            y += r.real * np.exp(p.real * t)
    outside = np.flatnonzero(np.abs(y - 1.0) > 0.02)
    return Expected(100.0 * max(y.max() - 1.0, 0.0), float(t[outside[-1]]), float((-poles.real / abs(poles)).min()))


def study() -> Study:
    return case_study(PUBLISHED)


def analysed(scr: float, ratio: float) -> tuple[MarginTable, ResponseMetrics | None]:
    s = study()
    grid = Place(scr, ratio, "reactance").grid(s.converter)
    law = gain_law(s, s.controllers[0])
    cells = cells_under(s, law, grid.R_g, grid.L_g, P, Q)
    model = reduced_cells(s, cells)
    return reduced_margins(model), reduced_step_metrics(model, "P_ref", "P")[0]


@pytest.mark.parametrize(("scr", "ratio"), CELLS)
def test_a_cell_of_the_table(scr: float, ratio: float) -> None:
    """Library = fine oracle (overshoot 1e-3 points, settling 0.1 ms, damping 1e-9), and both = what is printed.

    Three printed settling times are rounded one digit above the fine ones (3.79 for 3.784). All fifteen are what the
    first instant inside the band on a grid of 2.5 ms rounds to; so the last digit may be one off.
    """
    table, metrics = analysed(scr, ratio)
    assert metrics is not None
    want = expected(scr, ratio)
    assert metrics.overshoot_pct == pytest.approx(want.overshoot_pct, abs=2e-3)
    assert metrics.settling_time_s == pytest.approx(want.settling_s, abs=1e-4)
    assert table.least_damping[0] == pytest.approx(want.damping, rel=1e-9)
    overshoot, settling, damping, disk = TABLE[scr][ratio]
    digits = 1 if 0.0 < overshoot < 10.0 else 0
    assert abs(want.overshoot_pct - overshoot) <= 0.5 * 10.0**-digits + 0.01
    assert abs(want.settling_s - settling) < 0.01
    on_grid = math.ceil(want.settling_s / 2.5e-3) * 2.5e-3
    assert abs(on_grid - settling) < 0.005 + 1e-9
    assert round(want.damping, 2) == damping
    worst = min(table.disk_output.value[0], table.disk_input.value[0])
    print(
        f"SCR {scr}, X/R {ratio}: {want.overshoot_pct:.2f} %, {want.settling_s:.4f} s, {want.damping:.4f}, {worst:.4f}"
    )
    assert round(float(table.disk_output.value[0]), 2) == disk


@pytest.mark.parametrize("scr", list(TABLE))
def test_a_ratio_of_three_tenths_is_unstable(scr: float) -> None:
    table, metrics = analysed(scr, 0.3)
    assert metrics is None
    assert not table.stable[0]
    assert np.roots(channel(coupling(scr, 0.3))[1]).real.max() > 0.0


def test_the_page_prints_these_figures() -> None:
    """The table of docs/theory/power-loops.md: every cell is the fine oracle's, rounded to the digits printed."""
    page = Path(__file__).resolve().parents[2] / "docs" / "theory" / "power-loops.md"
    text = page.read_text(encoding="utf-8")
    begin = text.index("| SCR | X/R 0.3 |")
    rows = [line for line in text[begin:].split("\n\n")[0].splitlines() if re.match(r"\| \d", line)]
    ratios = (0.3, 0.5, 1.0, 2.0, 3.0, 10.0)
    assert len(rows) == 3
    for row in rows:
        scr, *cells = [cell.strip() for cell in row.strip("|").split("|")]
        for ratio, cell in zip(ratios, cells, strict=True):
            if cell == "unstable":
                assert ratio == 0.3
                continue
            want = expected(float(scr), ratio)
            values = (want.overshoot_pct, want.settling_s, want.damping)
            for printed, value in zip(cell.split("/"), values, strict=True):
                half = 0.5 * 10.0 ** -len(printed.strip().partition(".")[2])
                assert abs(float(printed) - value) < 1.001 * half, (scr, ratio, printed, value)


@pytest.mark.parametrize("scr", [2.0, 5.0, 8.0, 20.0])
def test_the_limit_of_stability(scr: float) -> None:
    """stability_limit against bisection on python-control's poles, to 1e-8; and the page's figures."""
    s = study()
    law = gain_law(s, s.controllers[0])
    found = stability_limit(s, law, scr, P, Q)

    def unstable(ratio: float) -> bool:
        num, den = channel(coupling(scr, ratio))
        return bool(np.real(control.TransferFunction(num, den).poles()).max() > 0.0)

    low, high = 0.2, 1.0
    assert unstable(low)
    assert not unstable(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if unstable(middle) else (low, middle)
    print(f"SCR {scr}: X/R {found:.4f}")
    assert found == pytest.approx(high, rel=1e-8)
    assert round(found, 3) == {2.0: 0.328, 5.0: 0.342, 8.0: 0.346, 20.0: 0.350}[scr]
    # The page's bound −8.08 < c < 1.01 is where it happens: Routh's (d₁ + κ)(k₁ + d₁κ) = k₁(κ − k₂c).
    routh = (4.0 - 12.0 * 48.0 / 16.0) / (4.0 / 1.01)
    assert routh == pytest.approx(-8.08, abs=1e-12)
    assert coupling(scr, found) == pytest.approx(routh, rel=1e-7)
    # On a strong grid c = −(R/X)²: below it the loop is unstable on any.
    assert found < 1.0 / math.sqrt(8.08) == pytest.approx(0.352, abs=5e-4)


def test_no_limit_is_said() -> None:
    """Stable throughout the bracket, and unstable throughout."""
    s = study()
    law = gain_law(s, s.controllers[0])
    with pytest.raises(InfeasibleStudyError, match="stable wherever"):
        stability_limit(s, law, 5.0, P, Q, bracket=(1.0, 10.0))
    with pytest.raises(InfeasibleStudyError, match="unstable throughout"):
        stability_limit(s, law, 5.0, P, Q, bracket=(0.25, 0.3))
