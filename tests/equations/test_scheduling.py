"""The scheduler's equations as machine code: the bits of Python that runs the same text, with every guard."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

from tests.codegen.twins import twin
from tests.runtime.test_many import CASES, Inputs
from vsgdesign.equations.scheduler_data import SchedulerInput
from vsgdesign.equations.scheduling import begun, told_and_updated
from vsgdesign.runtime.guards import REASONS, STATUSES
from vsgdesign.runtime.many import ManySchedulers, OneByOne, apart, stacked
from vsgdesign.simulation.compiled_schedulers import CompiledSchedulers


class PlainFloats:
    """The schedulers one after the other, with the plain sine and the like of machine code."""

    def __init__(self, lookup: Any, settings: Any) -> None:
        table, limits, law = lookup.table, settings.limits, twin(lookup.functions)
        self._begun = functools.partial(twin(begun), table, limits)
        self._updated, self._law = functools.partial(twin(told_and_updated), table, limits), law

    def begin(self, R_g: Any, L_g: Any, nearest: bool) -> Any:
        pairs = zip(R_g.tolist(), L_g.tolist(), strict=True)
        states, known = zip(*(self._begun(*pair, nearest, self._law) for pair in pairs), strict=True)
        return stacked(states), np.array(known) != 0

    def update(self, state: Any, told: Any, given: SchedulerInput) -> Any:
        lanes = zip(apart(state), told.tolist(), apart(given), strict=True)
        found = [self._updated(*lane, self._law) for lane in lanes]
        return stacked([one[0] for one in found]), *(np.array([one[k] for one in found]) for k in (1, 2))


def leaves(record: Any) -> list[Any]:
    return [leaf for value in record for leaf in leaves(value)] if isinstance(record, tuple) else [record]


@pytest.mark.parametrize("name", CASES)
def test_machine_code_has_the_bits_of_python(name: str) -> None:
    lookup, settings = CASES[name]()
    count, statuses, reasons = 50, 0, set()
    compiled = ManySchedulers(lookup, settings, count, CompiledSchedulers(lookup, settings))
    plain = ManySchedulers(lookup, settings, count, PlainFloats(lookup, settings))
    inputs = Inputs(5, count)
    for many in (compiled, plain):  # both from the same first state
        many.start(np.full(count, np.nan), np.full(count, np.nan))
    for _ in range(80):
        given = inputs.next()
        compiled.update(**given)
        plain.update(**given)
        for a, b in zip(leaves(compiled.state), leaves(plain.state), strict=True):
            np.testing.assert_array_equal(a, b)
        assert compiled.answers is not None
        assert plain.answers is not None
        np.testing.assert_array_equal(compiled.answers.status, plain.answers.status)
        np.testing.assert_array_equal(compiled.answers.reason, plain.answers.reason)
        statuses |= int(np.bitwise_or.reduce(compiled.answers.status))
        reasons |= set(compiled.answers.reason.tolist())
    # Every guard had its say. A closed form is designed everywhere.
    assert statuses == sum(STATUSES)
    assert len(reasons) == len(REASONS) - (name == "closed form")


@pytest.mark.parametrize("name", CASES)
def test_shipped_python_decides_alike(name: str) -> None:
    """It takes NumPy's logarithm and the like, which differ from those of machine code in the last bit."""
    lookup, settings = CASES[name]()
    compiled = ManySchedulers(lookup, settings, 20, CompiledSchedulers(lookup, settings))
    shipped = ManySchedulers(lookup, settings, 20, OneByOne(lookup, settings))
    inputs = Inputs(6, 20)
    for _ in range(100):
        given = inputs.next()
        gains, wanted = compiled.update(**given), shipped.update(**given)
        assert compiled.answers is not None
        assert shipped.answers is not None
        np.testing.assert_array_equal(compiled.answers.status, shipped.answers.status)
        np.testing.assert_array_equal(compiled.answers.reason, shipped.answers.reason)
        np.testing.assert_allclose(compiled.answers.scr, shipped.answers.scr, rtol=1e-13)
        np.testing.assert_allclose(gains, wanted, rtol=1e-10)


@pytest.mark.parametrize("nearest", [False, True])
def test_starts_on_known_grids_or_at_the_safe_place(nearest: bool) -> None:
    lookup, settings = CASES["decoupled"]()
    L_g = np.array([2e-3, 5e-3, 1e-6, 0.0, np.nan, 15e-3])
    R_g = np.array([0.5, 1.0, 0.5, 0.5, 0.5, 0.1])
    compiled = ManySchedulers(lookup, settings, len(L_g), CompiledSchedulers(lookup, settings))
    plain = ManySchedulers(lookup, settings, len(L_g), PlainFloats(lookup, settings))
    known = compiled.start(R_g, L_g, nearest=nearest)
    np.testing.assert_array_equal(known, plain.start(R_g, L_g, nearest=nearest))
    for a, b in zip(leaves(compiled.state), leaves(plain.state), strict=True):
        np.testing.assert_array_equal(a, b)
    assert 0 < known.sum() < len(known)
