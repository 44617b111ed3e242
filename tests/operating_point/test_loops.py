"""Transfer functions and classical margins of loops against python-control's."""

from __future__ import annotations

import control
import numpy as np
import pytest

from vsgdesign.operating_point.loops import Transfer, loop_margins, transfer_of


def test_a_transfer_function_is_that_of_its_matrices() -> None:
    """At any s, and without a coefficient that only rounding makes."""
    rng = np.random.default_rng(5)
    s = 0.3 + 2.0j
    for n in (1, 2, 4):
        A, b, c = rng.standard_normal((n, n)), rng.standard_normal((n, 1)), rng.standard_normal((1, n))
        found = transfer_of(A, b, c)
        assert found(s) == pytest.approx((c @ np.linalg.solve(s * np.eye(n) - A, b))[0, 0], rel=1e-12)
        closed = found.closed(s)
        assert closed == pytest.approx(found(s) / (1.0 + found(s)), rel=1e-12)
    chain = transfer_of(np.diag([3.0, 7.0], 1) - np.diag([0.1, 0.2, 0.3]), np.eye(3)[:, 2:], np.eye(3)[:1])
    assert chain.numerator.tolist() == pytest.approx([21.0])


@pytest.mark.parametrize("seed", range(40))
def test_margins_are_those_of_python_control(seed: int) -> None:
    """Of loops with a pole at zero, that cross once, several times or never."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    poles, zeros = -(10.0 ** rng.uniform(-1.0, 1.5, n)), -(10.0 ** rng.uniform(-1.0, 1.5, int(rng.integers(0, n))))
    if n > 2:
        poles = np.append(poles[2:], [poles[0] + 1j * poles[1], poles[0] - 1j * poles[1]])
    numerator = 10.0 ** rng.uniform(-2.0, 3.0) * np.atleast_1d(np.poly(zeros)).real
    denominator = np.append(np.poly(poles).real, 0.0) if seed % 2 else np.poly(poles).real
    found = loop_margins(Transfer(numerator, denominator))
    gain, phase, _, _, crossover, _ = control.stability_margins(control.tf(numerator, denominator))
    if np.isfinite(gain):
        assert found.gain_margin_db == pytest.approx(20.0 * np.log10(gain), abs=1e-9)
    else:
        assert found.gain_margin_db is None
    if np.isfinite(crossover):
        assert found.phase_margin_deg == pytest.approx(phase, abs=1e-9)
        assert found.crossover_rad_s == pytest.approx(crossover, rel=1e-9)
        assert found.delay_margin_s == pytest.approx(np.deg2rad(phase) / crossover, rel=1e-9)
    else:
        assert found.phase_margin_deg is found.crossover_rad_s is found.delay_margin_s is None
