"""The recipe of docs/gain-table-file.md, followed step by step by a small runtime that knows nothing but the file.

It uses the standard library alone. Its gains are compared with those of this project's runtimes on random places.
"""

from __future__ import annotations

import json
import math
import re
from bisect import bisect_right
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.equations.power_flow import LEAST_SHARE, POWER_MARGIN
from vsgdesign.runtime import table_schedule
from vsgdesign.runtime.updating import gain_lookup

PAGE = Path(__file__).resolve().parents[2] / "docs" / "gain-table-file.md"
SCR, X_OVER_R = (1.5, 2.0, 5.0, 20.0), (0.3, 1.0, 3.0, 10.0)


def axis_position(axis: list[float], value: float) -> tuple[int, float]:
    """Step 3."""
    value = min(max(value, axis[0]), axis[-1])
    low = min(bisect_right(axis, value) - 1, len(axis) - 2)
    return low, (value - axis[low]) / (axis[low + 1] - axis[low])


def gains_of_the_page(f: dict[str, Any], R_g: float, L_g: float, P: float, Q: float, V: float) -> Any:
    """Steps 1 to 13: the eight gains, and which of the two limits acted."""
    if not (math.isfinite(R_g) and math.isfinite(L_g)) or L_g <= 0.0:  # 1
        return None
    base = f["base"]
    omega, Z_base = base["omega_n"], 3.0 * base["V_rated_rms"] ** 2 / base["S_rated"]
    X_g = omega * L_g
    scr = Z_base / (math.hypot(R_g, X_g) if base["scr_basis"] == "impedance" else X_g)  # 2
    row, r = axis_position(f["scr"], scr)  # 3
    column, c = axis_position([1.0 / x for x in reversed(f["x_over_r"])], R_g / X_g)
    weights = {(0, 0): (1 - r) * (1 - c), (0, 1): (1 - r) * c, (1, 0): r * (1 - c), (1, 1): r * c}

    def node(values: Any, at: tuple[int, int]) -> Any:
        return values[row + at[0]][::-1][column + at[1]]

    if any(w != 0.0 and node(f["status"], at) == "outside" for at, w in weights.items()):  # 4
        return None
    T = f["time_scale"]
    scale = {"k_1": T * T, "d_1": T, "k_2": T}
    n = {
        name: sum(w * node(values, at) for at, w in weights.items()) / scale.get(name, 1.0)
        for name, values in f["columns"].items()
    }
    R, X = R_g + base["R_2"], omega * (L_g + base["L_2"])  # 5
    h = 3 * V * V / math.sqrt(max(1.3**2 * (P * P + Q * Q) * (R * R + X * X), (3 * V * V) ** 2))  # 6
    R, X = h * R, h * X
    b, g = 3 * V * V * X / (R * R + X * X), 3 * V * V * R / (R * R + X * X)  # 7
    clipped = min(max(Q, -0.8 * b), 0.8 * b)
    A, B, C, D = b - clipped, (P + g) / V, P - g, (b + clipped) / V  # 8
    if f["law"] == "inertia":  # 9
        k_1 = A * omega / (2 * n["H"] * base["S_rated"])
        d_1 = 2 * n["zeta"] * math.sqrt(k_1)
    else:
        k_1, d_1 = n["k_1"], n["d_1"]
    k_2, share_P, share_Q = n["k_2"], n["share_P"], n["share_Q"]
    droop = (0.0 if f["structure"] == "published" else f["D_q"]) + n["q"] * D  # 10
    det = A * (D + droop) - share_P * B * share_Q * C  # 11
    w11, w12, w21, w22 = (D + droop) / det, -share_P * B / det, -share_Q * C / det, A / det
    acted = (h < 1.0, clipped != Q)
    if f["structure"] != "angle_damped":  # 12
        return (k_1 * w11, d_1 / (k_1 * w11), k_2 * w22, droop, k_1 * w12, k_2 * w21, 0.0, 0.0), acted
    D_p = f["D_p"]  # 13
    p = 0.0 if f["law"] == "inertia" else k_2 * D_p
    A_V = A - p / (1 + (p * w11) ** 3)
    det_V = A_V * (D + droop) - share_P * B * share_Q * C
    k_d = d_1 - k_1 * w11 * D_p
    K_iq, K_qp = k_2 * A_V / det_V, -k_2 * share_Q * C / det_V
    return (k_1 * w11, D_p, K_iq, droop, k_1 * w12, K_qp, k_d * w11, k_d * w12), acted


@pytest.mark.parametrize(
    ("structure", "law"),
    [("published", "poles"), ("decoupled", "poles"), ("angle_damped", "poles"), ("angle_damped", "inertia")],
)
def test_a_runtime_that_follows_the_page_has_the_gains_of_the_product(structure: str, law: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    first, second = ("H", "zeta") if law == "inertia" else ("k_1", "d_1")
    shares = {} if structure == "published" else {"share_P": rng.uniform(0, 1, (4, 4)), "share_Q": 0.7}
    stiffness, damping = rng.uniform(2, 20, (4, 4)), rng.uniform(0.2, 0.9, (4, 4))  # ζ < 1, or the file is refused
    columns = {first: stiffness, second: damping if law == "inertia" else 2.0 * damping * np.sqrt(stiffness)}
    columns["k_2"] = rng.uniform(3, 5, (4, 4))
    status = np.full((4, 4), "met", dtype="<U7")
    status[1, 2] = "outside"
    made = table(structure, law, SCR, X_OVER_R, columns | shares, status=status)
    write_table_file(made, tmp_path / "t.json")
    file = json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))
    schedule = table_schedule(made)
    lookup = gain_lookup(schedule, V_n_rms=110.0)

    drawn_in = clipped = refused = 0
    for _ in range(600):
        # Beyond both axes, a negative R_g now and then, powers up to twice the rated 5 kVA.
        Z, ratio = 7.26 / math.exp(rng.uniform(math.log(0.8), math.log(30.0))), rng.uniform(-0.2, 4.0)
        X_g = Z / math.hypot(1.0, ratio)
        R_g, L_g = ratio * X_g, X_g / (100.0 * math.pi)
        P, Q, V = rng.uniform(-1e4, 1e4), rng.uniform(-1e4, 1e4), rng.uniform(90.0, 140.0)
        ours = gains_of_the_page(file, R_g, L_g, P, Q, V)
        assert (ours is not None) == bool(schedule.place(R_g, L_g).designed)
        place = lookup.coordinates(R_g, L_g)
        normalised = lookup.normalised(*place)
        assert (ours is None) == (normalised is None)
        if ours is None or normalised is None:
            refused += 1
            continue
        gains, (by_impedance, by_Q) = ours
        drawn_in, clipped = drawn_in + by_impedance, clipped + by_Q
        np.testing.assert_allclose(schedule.gains_measured(R_g, L_g, P, Q, V), gains, rtol=1e-12)
        if ratio > 0.0:  # a place has no sign of R
            np.testing.assert_allclose(lookup.gains(normalised, *place, P, Q, V), gains, rtol=1e-12)
    assert min(drawn_in, clipped, refused) > 10, "the limits and the undesigned node must be met"


def test_an_unusable_estimate_gives_no_gains(tmp_path: Path) -> None:
    write_table_file(table(), tmp_path / "t.json")
    file = json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))
    for R_g, L_g in ((math.nan, 1e-3), (1.0, math.inf), (1.0, 0.0), (1.0, -1e-3)):
        assert gains_of_the_page(file, R_g, L_g, 1e3, 0.0, 110.0) is None


def test_the_constants_on_the_page_are_those_of_the_equations() -> None:
    text = PAGE.read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `([A-Z_]+)` \| ([\d.]+) \|", text, re.MULTILINE))
    assert {name: float(value) for name, value in rows.items()} == {
        "POWER_MARGIN": POWER_MARGIN,
        "LEAST_SHARE": LEAST_SHARE,
    }
