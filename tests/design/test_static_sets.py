"""The operating points that a certificate is about are those that the design of a table is about."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from tests.design.test_certificate_proof import evaluated
from vsgdesign.artifacts.certificate_record import StaticLimits, certificate_record
from vsgdesign.artifacts.table_text import certificate_sentence
from vsgdesign.certificate import Certificate, Region, certify, step_budget
from vsgdesign.certificate.boxes import Boxes, whole_region
from vsgdesign.certificate.enclosure import programs
from vsgdesign.certificate.lyapunov import Motion
from vsgdesign.certificate.proof import EMPTY, look_at
from vsgdesign.certificate.region import System, random_points
from vsgdesign.certificate.step_certificates import _BUDGET
from vsgdesign.certificate.step_proof import _parameters, _programs
from vsgdesign.certificate.step_terms import LevelShape, acting_limits
from vsgdesign.certificate.taylor_kernel import LANES
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.linear.operating_point.equilibrium import static_limits
from vsgdesign.runtime import closed_form_schedule
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.verbs.cli.program import main

Array = NDArray[np.float64]

STUDY = """
base = "case:lab_12kva_lcl"
converter = { current_limit_pu = 1.2, current_limiter = "projection", V_dc = "640 V", V_max_pu = 1.1 }
filter = { R_c = "0.5 ohm" }
power_loops = { structure = "angle_damped", P_droop = "5 %", Q_droop = "50 %" }
simulation = { duration = "1 s", P_ref = "1 kW", Q_ref = "0 var" }
controllers = [{ name = "damped", kind = "scheduled" }]
"""
REGION = Region((1.5, 20.0), (0.3, 10.0), (-18e3, 18e3), (-9e3, 9e3), 0.1)


@cache
def study() -> Study:
    return study_from_text(STUDY, "a study")


def uses(points: Array) -> dict[str, Array]:
    """Share of each static limit, from phasors at the capacitor."""
    c, f = study().converter, study().filter
    Z, angle, P, Q = c.Z_base * points[:, 0], points[:, 1], points[:, 2], points[:, 3]
    R, X = Z * np.cos(angle) + f.R_2, Z * np.sin(angle) + c.omega_n * f.L_2
    with np.errstate(invalid="ignore"):
        V, _ = operating_point(P, Q, study().grid_source.V_g_rms, R, X)
        shunt = 1.0 / (f.R_c + 1.0 / (1j * c.omega_n * f.C))
        current = np.conj((P + 1j * Q) / (3.0 * V)) + shunt * V
        bridge = V + (f.R_1 + 1j * c.omega_n * f.L_1) * current
        return {
            "power transfer": 1.3 * np.hypot(P, Q) * np.hypot(R, X) / (3.0 * V**2),
            "least voltage": c.V_min_pu * c.V_rated_rms / V,
            "largest voltage": V / (c.V_max_pu * c.V_rated_rms),
            # The limiter's soft limit of 1.15 pu, less what a sampled bridge needs.
            "current": np.abs(current) * 3.0 * c.V_rated_rms / c.S_rated / (0.995 * 1.15),
            "bridge voltage": np.sqrt(2.0) * np.abs(bridge) / (0.995 * c.v_max_pk),
        }


def drawn() -> tuple[Array, Array]:
    """Points of the region that have an operating point, and the most that each uses of a static limit."""
    points = random_points(REGION, 30_000, np.random.default_rng(3))
    found = uses(points)
    most = np.max(list(found.values()), axis=0)
    # Every limit is the closest one of some points.
    nearest = np.argmax(list(found.values()), axis=0)[np.isfinite(most) & (most < 1.2) & (most > 0.9)]
    assert set(nearest) == set(range(len(found)))
    return points[np.isfinite(most)], most[np.isfinite(most)]


def test_cells_are_those_within_the_limits_of_the_design() -> None:
    points, most = drawn()
    system = System(study(), closed_form_schedule(study(), study().controllers[0].target))
    kept = {tuple(point) for point in system.cells(points, partial=True).points}
    near = np.abs(most - 1.0) < 1e-9
    assert not near.any()
    assert kept == {tuple(point) for point in points[most < 1.0]}


def test_an_empty_box_holds_no_operating_point_and_a_wide_one_is_not_empty() -> None:
    """Boxes as narrow as a point, of both proofs: empty where a limit is exceeded, and nowhere else."""
    points, most = drawn()
    points[:, 4:], s = 0.0, System(study(), closed_form_schedule(study(), study().controllers[0].target), REGION)
    c = study().converter
    clear = np.abs(most - 1.0) > 1e-3
    points, most = points[clear][:600], most[clear][:600]
    R = points[:, 0] * np.cos(points[:, 1]) * c.Z_base + study().filter.R_2
    X = points[:, 0] * np.sin(points[:, 1]) * c.Z_base + c.omega_n * study().filter.L_2
    V, _ = operating_point(points[:, 2], points[:, 3], study().grid_source.V_g_rms, R, X)
    power = points[:, 0] * c.Z_base / V**2
    places = np.column_stack([points[:, :2], points[:, 2] * power, points[:, 3] * power, points[:, 4:]])
    whole = whole_region(s, REGION)
    narrow = whole.take(np.zeros(len(places), dtype=int))
    narrow.low[:], narrow.high[:] = places - 1e-9, places + 1e-9
    _, state, _ = look_at(s, programs(s, REGION, Motion(REGION, False).weights, np.eye(3)[None], 1.0), narrow, whole)
    np.testing.assert_array_equal(state == EMPTY, most > 1.0)
    assert 100 < np.sum(most > 1.0) < 500
    # The proof of the steps has P and Q themselves, in per unit of the rated power.
    own = np.column_stack([points[:, :2], points[:, 2:4] / c.S_rated, points[:, 4:]])[:60]
    ready = _programs(s, REGION, LevelShape.of(np.eye(3), 0.85, 1.1), acting_limits(study()), 0.5)
    narrow = Boxes(own, own, np.zeros(len(own), dtype=int))
    parameters = _parameters(s, narrow, whole, np.zeros((0, len(whole))))
    held = np.zeros(len(own), dtype=bool)
    for program, conditions in zip(ready.programs, ready.conditions, strict=True):
        values = np.array(
            [evaluated(program, own[k], np.repeat(parameters[:, k : k + 1], LANES, axis=1)) for k in range(len(own))]
        )[:, -len(conditions) :]
        held |= ((values >= conditions[:, 0]) & (values <= conditions[:, 1])).all(axis=1)
    np.testing.assert_array_equal(held, most[:60] < 1.0)


@pytest.mark.parametrize("json", [False, True])
def test_no_certificate_is_given_beyond_the_limits(tmp_path: Path, json: bool) -> None:
    """Twice the rated power: it was certified, with a current at rest of 2 pu."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    result = CliRunner().invoke(
        main, ["certify", str(path), "--boxes", "0", "--p-pu", "1.8", "1.9", *(["--json"] if json else [])]
    )
    assert result.exit_code == 1
    assert "no cell within the static limits: at SCR" in result.output
    assert "% of the limit of current is used" in result.output


def test_the_set_is_named_and_one_of_before_has_its_own_name() -> None:
    region = Region((3.0, 8.0), (1.0, 5.0), (-6e3, 6e3), (-2e3, 2e3), 0.1)
    found = certify(study(), study().controllers[0], region, budget=0, nodes_per_axis=5, fresh=500)
    assert isinstance(found, Certificate)
    assert found.limits == static_limits(study())
    bridge = 0.995 * study().converter.v_max_pk / (np.sqrt(2.0) * study().converter.V_rated_rms)
    expected = StaticLimits(V_low=0.85, V_high=1.1, power_transfer=1.3, current=0.995 * 1.15, bridge_voltage=bridge)
    assert asdict(found.limits) == pytest.approx(asdict(expected))
    record = found.as_record()
    assert record.region.limits == found.limits
    named = "within the static limits of V, power transfer, current and bridge voltage, one"
    assert named in certificate_sentence(record)
    before = {name: value for name, value in record.document.items() if name != "static_limits"}
    text = certificate_sentence(certificate_record(before))
    assert "within the static limits of V and power transfer alone, one" in text
    with pytest.raises(ValueError, match=r"certificate\.static_limits\.current: must be a number"):
        certificate_record({**record.document, "static_limits": {"current": "much"}})


def test_certify_and_a_table_build_give_the_steps_the_same_boxes() -> None:
    """They gave different steps for one table: 150,000 boxes for a row against 15,000."""
    (boxes,) = (option for option in main.commands["certify"].params if option.name == "boxes")
    assert isinstance(boxes.default, int)
    assert step_budget(boxes.default) == _BUDGET
