"""Proofs with a function for every place: against the coupled model of one unit, and against what contradicts them."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.design.robust_studies import robust_study, scenarios
from tests.design.test_pair import OMEGA, paired
from tests.gain_tables import PUBLISHED_BASE, table
from vsgdesign.artifacts.certificate_record import certificate_record
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.table_text import certificate_failed, certificate_sentence
from vsgdesign.certificate import Counterexample, Places, Region, by_place, of_a_pair
from vsgdesign.certificate.checking import check_certificate
from vsgdesign.certificate.places import joined
from vsgdesign.design.evaluation import between_units, model_in
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.report.gain_table.overview import table_answer
from vsgdesign.runtime.of_study import schedule_of
from vsgdesign.runtime.table import table_schedule
from vsgdesign.study.parameters import ControllerSpec, Study
from vsgdesign.study.parameters.grid import Place

Array = NDArray[np.float64]

REGION = Region((2.4, 5.2), (4.8, 5.2), (-4e3, 4e3), (-1e3, 1e3), 0.02)
QUICK: dict[str, Any] = {"nodes_per_axis": 3, "fresh": 200, "budget": 20_000}


def asked() -> tuple[Study, ControllerSpec]:
    study = replace(paired(3.0), specification=None)
    return study, next(one for one in study.controllers if one.name == "angle_damped")


@pytest.fixture(scope="module")
def pair() -> Places:
    found = of_a_pair(*asked(), REGION, **QUICK)
    assert isinstance(found, Places)
    return found


def test_no_place_and_no_error_contradicts_the_proof_of_a_pair(pair: Places) -> None:
    """On random grids, powers and wrong estimates, by the coupled model of one unit on each of its two impedances,
    which the proof does not use."""
    study, spec = asked()
    schedule, c, f = schedule_of(study, spec), study.converter, study.filter
    assert pair.proof == "gap-free"
    assert pair.differential is not None
    assert pair.differential.proof == "gap-free"
    decays = pair.decay, pair.differential.decay or 0.0
    assert min(decays) > 0.5
    rng = np.random.default_rng(11)
    lags = study.power_lags._replace(tau_P=0.0, tau_Q=0.0)
    for _ in range(40):
        grid = Place(rng.uniform(*REGION.scr), rng.uniform(*REGION.x_over_r), study.scr_basis).grid(c)
        P, Q = np.array([rng.uniform(*REGION.P)]), np.array([rng.uniform(*REGION.Q)])
        R, X = f.R_2 + grid.R_g, c.omega_n * (f.L_2 + grid.L_g)
        V, delta = operating_point(P, Q, c.V_rated_rms, R, X)
        e_R, e_L = np.round(rng.uniform(-1.0, 1.0, 2)) * REGION.error
        gains = schedule.gains_measured(grid.R_g * (1.0 + e_R), grid.L_g * (1.0 + e_L), P, Q, V)  # type: ignore[attr-defined]
        one = PowerLoopGains(*(np.full(1, value) for value in gains))
        s = scenarios(robust_study(), 3.0, 1.0).take(np.array([0]))
        s = replace(s, P=P, Q=Q, V_rms=V, delta=delta, omega_g=np.array([OMEGA]))
        s = replace(s, R=np.array([R]), X=np.array([X]), V_g_rms=np.array([c.V_rated_rms]))
        for at, decay in zip((s, between_units(s, f.R_2, f.L_2)), decays, strict=True):
            assert np.linalg.eigvals(model_in(one, at, lags).A[0]).real.max() < -decay


def test_the_places_cover_the_region_and_are_told(pair: Places) -> None:
    scr = sorted(part.region.scr for part in pair.parts)
    assert scr[0][0] == REGION.scr[0]
    assert scr[-1][1] == REGION.scr[1]
    assert all(before[1] == after[0] for before, after in pairwise(scr))
    record = pair.as_record()
    text = certificate_sentence(record)
    assert f"for each of {len(pair.parts)} places" in text
    assert "Units against each other" in text
    assert record.differential == pair.differential
    refused = certificate_record({"certified": False, "reason": "Nothing exists."})
    assert certificate_failed(replace(pair, differential=refused).as_record())


@dataclass(frozen=True)
class Crossed:
    """A schedule whose gains between P and Q are several times too high."""

    schedule: Any
    factor: float

    def gains_measured(self, R_g: Any, L_g: Any, P: Any, Q: Any, V_rms: Any) -> PowerLoopGains:
        gains = self.schedule.gains_measured(R_g, L_g, P, Q, V_rms)
        return gains._replace(K_pq=self.factor * gains.K_pq, K_qp=self.factor * gains.K_qp)


def test_gains_that_are_unstable_between_the_units_are_refused() -> None:
    study, spec = asked()
    wrong = Crossed(schedule_of(study, spec), 40.0)
    region = replace(REGION, error=0.0, scr=(2.4, 2.6))
    found = by_place(study, spec, region, schedule=wrong, apart=True, **QUICK)
    assert isinstance(found, Counterexample)
    assert found.eigenvalue.real > 0.0


def test_a_move_takes_over_no_more_than_the_factor() -> None:
    """Random states over random functions; of two functions the best factor is the root of both ways together."""
    rng = np.random.default_rng(2)
    roots = rng.normal(size=(3, 4, 4))
    functions = [10.0**k * (root @ root.T + 0.1 * np.eye(4)) for k, root in enumerate(roots)]
    scaled, factor = joined(functions)
    x = rng.normal(size=(500, 4))
    values = np.array([np.einsum("ni,ij,nj->n", x, P, x) for P in scaled])
    assert (values[:, None] <= factor * values[None] * (1.0 + 1e-9)).all()
    one, two = functions[:2]
    both = [np.linalg.eigvals(np.linalg.solve(a, b)).real.max() for a, b in ((one, two), (two, one))]
    assert joined([one, two])[1] == pytest.approx(np.sqrt(both[0] * both[1]), rel=1e-6)


def damaged(table: GainTable, change: Callable[[dict[str, Any]], None]) -> tuple[str, ...]:
    """The faults of a table's certificate after a change of its document."""
    assert table.certificate is not None
    document = copy.deepcopy(dict(table.certificate.document))
    change(document)
    return check_certificate(replace(table, certificate=certificate_record(document))).faults


def test_a_table_keeps_both_proofs_and_a_check_finds_what_is_wrong_in_them() -> None:
    study = robust_study()
    study = replace(study, filter=replace(study.filter, L_2=3e-4, R_2=0.03))
    spec = next(one for one in study.controllers if one.kind == "scheduled")
    base = replace(PUBLISHED_BASE, L_2=3e-4, R_2=0.03)
    c, f = study.converter, study.filter
    kept = {
        "converter": {"V_dc": c.V_dc, "f_sw": c.f_sw},
        "filter": {"L_1": f.L_1, "R_1": f.R_1, "C": f.C, "R_c": f.R_c},
    }
    bare = table(scr=(2.0, 5.0), x_over_r=(2.0, 4.0), base=base, design_inputs=kept)
    region = Region((2.2, 4.8), (2.2, 3.8), (-2e3, 2e3), (-5e2, 5e2), 0.0)
    found = of_a_pair(study, spec, region, schedule=table_schedule(bare), **QUICK)
    assert isinstance(found, Places)
    whole = replace(bare, certificate=found.as_record())
    check = check_certificate(whole)
    assert check.faults == ()
    assert len(check.carried) == 2  # looked at, both of them
    assert "1/s between units" in str(table_answer(whole))

    def turned(document: dict[str, Any]) -> None:
        place = document["differential"]["places"][0]
        place["P"] = np.linalg.inv(np.array(place["P"])).tolist()

    assert any("certificate.differential.places[0].decay" in one for one in damaged(whole, turned))
    assert any("cover" in one for one in damaged(whole, lambda document: document["places"].pop()))
    faults = damaged(whole, lambda document: document["move"].update(factor=1.0))
    assert any("certificate.move.factor is 1" in one for one in faults)
