"""The page about the field estimator's measurements: its numbers that do not come from a run."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from evidence._field_converters import converter_named
from vsgdesign.estimator.bound import sensor_noise, tracked_probe_bound
from vsgdesign.study.parameters.grid import Place

PAGE = Path(__file__).resolve().parents[2] / "docs" / "field-estimator-evidence.md"
CURRENT_PU, X_OVER_R = 0.003, 3.0


def least_error_pct(name: str, scr: float, noise: float, memory: float) -> float:
    """With 0.3 % of rated current in each line."""
    study = converter_named(name).study
    c, part, grid = study.converter, study.filter, Place(scr, X_OVER_R, "impedance").grid(study.converter)
    R, L = grid.R_g + part.R_2, grid.L_g + part.L_2
    sensors = sensor_noise(c, (noise, noise), 12, 3.0)
    i = [CURRENT_PU * c.I_rated_pk] * 2
    lines = [1.5 * c.omega_n, 2.5 * c.omega_n]
    samples = 2.0 * math.pi / c.omega_n / c.T_s
    bound = tracked_probe_bound(i, lines, c.omega_n, sensors, samples, memory, R, L)
    return 100.0 * bound.Z * math.hypot(R, c.omega_n * L) / math.hypot(grid.R_g, c.omega_n * grid.L_g)


@pytest.mark.parametrize(("name", "rate"), [("5 kVA", 20), ("1 MVA", 6)])
@pytest.mark.parametrize("noise_pct", [0.2, 0.5])
def test_the_bound_is_what_the_page_says(name: str, rate: int, noise_pct: float) -> None:
    begin = f"| {name}, {rate} kHz, noise {noise_pct:g} % |"
    (line,) = [one for one in PAGE.read_text(encoding="utf-8").splitlines() if one.startswith(begin)]
    for scr, cell in zip((5.0, 10.0, 15.0, 20.0), line.removeprefix(begin).strip(" |").split("|"), strict=True):
        short, long = (least_error_pct(name, scr, 0.01 * noise_pct, memory) for memory in (100.0, 300.0))
        assert cell.strip() == f"{short:.1f} ({long:.1f})"
