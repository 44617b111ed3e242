"""The proof of equal units at one node: all of them together, and against each other."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.simulation.test_plants import plant_of
from tests.stability.test_modes_of_units import STEEP, equal_units, rest_of
from vsgdesign.artifacts.proof_file import PROOF_FILE
from vsgdesign.artifacts.table_text import full_order_complete, full_order_sentence
from vsgdesign.certificate import proof_file, prove_full_order, region_of
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order import points as points_of_search
from vsgdesign.certificate.full_order import statement
from vsgdesign.certificate.full_order.points import decays_at
from vsgdesign.certificate.recheck import verdict
from vsgdesign.certificate.recheck.verdict import check_proof
from vsgdesign.certificate.region import Region
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.circuit_of_units import grid_of_unit
from vsgdesign.linear.stability.modes_of_units import split_matrices
from vsgdesign.report.gain_table.full_order import full_order_text, proof_check_text
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.power_plant import behind_its_path
from vsgdesign.verbs.pipeline.full_order import _shortened
from vsgdesign.verbs.pipeline.one_unit import as_unit
from vsgdesign.verbs.pipeline.table import _holds

GAINS = STEEP._replace(D_q=0.0)
"""At rest Q is that of the set point."""

REGION = Region((8.0, 8.2), (3.0, 3.01), (5e3, 6e3), (0.0, 5e2), 0.02)


class _Fixed:
    """The same gains for every estimate."""

    def gains_measured(self, *_: Any, **_named: Any) -> Any:
        return GAINS


@pytest.mark.parametrize("count", [2, 5])
def test_the_modes_of_units_are_those_of_the_whole_plant(count: int) -> None:
    """The slowest mode of units against each other by the rest on n Z_g, and by the whole plant at its own rest."""
    study = equal_units(count)
    unit = plant_of(study).units[0]
    rest = rest_of(study, GAINS)
    grid = grid_of_unit(study, unit, rest.model.situation.topology)
    (_, C), (_, D) = split_matrices(rest)
    own = replace(behind_its_path(study, unit), plant=None, scr_basis="impedance")
    c = own.converter
    angle = np.arctan(c.omega_n * grid.L_g / grid.R_g)
    point = [np.hypot(grid.R_g, c.omega_n * grid.L_g) / c.Z_base, angle, unit.P_ref, unit.Q_ref, 0.0, 0.0]
    spec, _ = region_of(study := load_study("studies/laboratory/study.toml"), "scheduled", None, None)
    system, _ = prepared(study, spec, REGION, statement.NOTHING, _Fixed(), None)
    for apart, matrix in ((False, C), (True, D)):
        found = decays_at(own, replace(system, study=own, apart=apart), np.array([point]))
        wanted = -np.log(np.abs(np.linalg.eigvals(matrix)).max()) / c.T_s
        assert found[0] == pytest.approx(wanted, rel=1e-6)


@functools.cache
def made() -> Any:
    """One of four units on strong grids, with a proof of few boxes of both modes."""
    study = replace(as_unit(load_study("studies/plant/study.toml"), "a test"), scr_basis="impedance")
    closed = replace(study.controllers[0], schedule="closed_form", table_file=None)
    study = replace(study, controllers=(closed,))
    found = prove_full_order(study, closed, REGION, decay=0.5, pair=True, workers=1)
    return study, found, proof_file(study, found, None)


@pytest.fixture
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the search for slow points had found nothing: boxes and arcs alone decide, in less time."""
    monkeypatch.setattr(verdict, "_decays", lambda *_: (1.0, []))


@pytest.mark.usefixtures("no_search")
def test_both_modes_are_proved_kept_and_looked_at_again(tmp_path: Path) -> None:
    study, found, proof = made()
    assert found.complete
    assert found.differential.complete
    text = full_order_text(found)
    assert "all units together: Proved." in text
    assert "units against each other: Proved." in text
    PROOF_FILE.write(proof, tmp_path / "a.proof")
    assert PROOF_FILE.read(tmp_path / "a.proof") == proof
    checked = check_proof(proof, study, None)
    assert not checked.faults
    assert checked.apart is not None
    for one in (checked, checked.apart):
        assert one.looked is not None
        assert one.looked.boxes == one.looked.of > 0
    assert "a.proof, units against each other: confirmed" in proof_check_text("a.proof", checked)
    # A table that states both is held by a proof of both alone.
    said = _shortened(found.as_document())
    assert full_order_complete(said)
    assert "Units against each other" in full_order_sentence(said)
    assert _holds(said, checked)
    assert not _holds(said, replace(checked, apart=None))


@pytest.mark.usefixtures("no_search")
def test_boxes_of_one_mode_do_not_stand_for_the_other() -> None:
    """Each file has its right hash. A faster decay than the units have against each other is refused by the boxes."""
    study, found, proof = made()
    assert "has no boxes" in check_proof(replace(proof, apart=()), study, None).faults[-1]
    faster = proof.statement["differential"] | {"decay": 1.2 * found.differential.slowest.decay}
    wrong = replace(proof, statement=proof.statement | {"differential": faster})
    faults = check_proof(wrong, study, None).faults
    assert any("units against each other: a box is not confirmed" in fault for fault in faults), faults


def test_a_plant_that_is_not_stable_between_its_units_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the inner loops of one converter the units of the same plant swing against each other on weak grids."""
    monkeypatch.setattr(points_of_search, "_KEPT", 6)
    study = replace(as_unit(load_study("studies/plant/usual.toml"), "a test"), scr_basis="impedance")
    spec = study.controllers[-1]
    region = Region((1.5, 1.6), (1.0, 2.0), (9e3, 11e3), (0.0, 1e3), 0.2)
    found = prove_full_order(study, spec, region, pair=True, workers=1)
    assert not found.complete
    assert found.unstable
    text = full_order_text(found)
    assert "all units together: Not looked at, because the plant is not stable" in text
    assert "units against each other: Not stable" in text


def test_units_with_nothing_between_them_are_refused() -> None:
    study = load_study("studies/table/study.toml")
    spec, _ = region_of(study, "closed_form", None, None)
    with pytest.raises(InfeasibleStudyError, match="nothing lies between the units"):
        prove_full_order(study, spec, REGION, pair=True, workers=1)
