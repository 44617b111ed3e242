"""The search finds what a plain draw of the same size misses, and says what it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.verification import stand_in
from tests.verification.test_summary import STUDY
from vsgdesign.campaigns.verification.search import APART, FOUND, POPULATION, search, starts_of

EIGHT = starts_of([], 8)


def cornered(study: Any, spec: Any, ready: Any, cases: Any, *, bridge: str, strict: bool) -> Any:
    """The overshoot breaks its promise in one corner alone: weak grid, large P; a share of 2.5e-5 of the cube."""
    found = stand_in.run(study, spec, ready, cases, bridge=bridge, strict=strict)
    c = study.converter
    weak = np.clip(1.0 - np.log(c.Z_base / np.hypot(cases.R_g, c.omega_n * cases.L_g) / 1.5) / np.log(20 / 1.5), 0, 1)
    P = 0.5 + 0.5 * cases.P_ref / (0.9 * c.S_rated)
    found.overshoot = 0.05075 * weak * P
    found.status[:] = 2
    found.settling_s[:] = found.recovery_s[:] = 0.5
    return found


JOB = stand_in.job(STUDY, 1, batch=stand_in.BATCH._replace(run=cornered))


def test_a_rare_failure_is_found() -> None:
    drawn = cornered(STUDY, None, None, stand_in.draw(STUDY, JOB.spec, 0, 2000)[0], bridge="averaged", strict=False)
    assert drawn.overshoot.max() < 0.0505
    found = search(JOB, 2000, {"step": EIGHT})
    assert found.evaluations <= 2000
    first = found.found[0]
    assert (first.family, first.promise, first.broken) == ("step", "overshoot", ("overshoot",))
    assert first.case.severity == pytest.approx(first.case.figures[0] / 0.0505)
    assert found.broken >= 1


def test_found_cases_are_apart_and_in_order_and_the_same_again() -> None:
    found = search(JOB, 6 * POPULATION, {"step": EIGHT, "jump": EIGHT})
    assert found == search(JOB, 6 * POPULATION, {"step": EIGHT, "jump": EIGHT})
    severities = [one.case.severity for one in found.found]
    assert severities == sorted(severities, reverse=True)
    for family in ("step", "jump"):
        rows = [np.array(one.coordinates) for one in found.found if one.family == family]
        assert 1 <= len(rows) <= FOUND
        gaps = [np.abs(a - b).max() for k, a in enumerate(rows) for b in rows[:k]]
        assert min(gaps, default=1.0) >= APART


def test_it_begins_where_it_is_told() -> None:
    corner = np.full((1, 8), 0.5)
    corner[0, [0, 3]] = 0.0, 0.9999
    found = search(JOB, 2 * POPULATION, {"step": corner})
    assert found.broken >= 1


def test_a_case_from_which_it_began_is_not_found_again() -> None:
    """The worst case of all is known; what is found is as bad as it at most, and something else."""
    known = np.full((2, 8), 0.5)
    known[0, [0, 3]] = 0.0, np.nextafter(1.0, 0.0)
    found = search(JOB, 2 * POPULATION, {"step": known}).found
    assert found
    assert min(np.abs(known - one.coordinates).max(axis=1).min() for one in found) > 1e-6


def test_cases_that_are_not_asked_for_are_no_finding() -> None:
    def left_out(*parts: Any, **named: Any) -> Any:
        results = cornered(*parts, **named)
        results.status[:] = 0
        return results

    job = stand_in.job(STUDY, 1, batch=stand_in.BATCH._replace(run=left_out))
    assert search(job, 2 * POPULATION, {"step": EIGHT}).found == ()


@pytest.mark.parametrize(("asked", "made"), [(31, 0), (32, 32), (100, 96), (128 * 5 + 1, 128 * 5)])
def test_it_makes_at_most_what_it_is_asked_for(asked: int, made: int) -> None:
    assert search(JOB, asked, {"step": EIGHT}).evaluations == made


def test_it_also_begins_at_corners() -> None:
    """Of 32 cases of the first generation, 21 are at one of four corners."""
    plain, cornered = (search(JOB, 32, {"step": EIGHT}, edges=edges).broken for edges in ((), (0, 3)))
    assert plain <= 1
    assert cornered >= 4
