"""Damaged suite files: whatever stands in a field, the answer is a suite or a list of faults."""

from __future__ import annotations

import copy
import random
from typing import Any

import pytest

from vsgdesign.campaigns.compliance.reading import packaged_document, suite_from_document
from vsgdesign.errors import StudyError

JUNK: tuple[Any, ...] = (
    None, True, -1, 0, 1e308, float("nan"), float("inf"), "", " ", "5 kg", "none", "open", [], [[]], [1, "x", 2.0],
    {}, [{}], {"type": "A"}, {"kind": "three_phase", "R_pu": -1}, ["50 ms", "50 ms"], "\u2028", 10**400,
)  # fmt: skip


def places(value: Any, way: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The way to every value of a document."""
    found = [way] if way else []
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        found += places(item, (*way, key))
    return found


def damaged(document: dict[str, Any], draw: random.Random) -> dict[str, Any]:
    document = copy.deepcopy(document)
    for _ in range(draw.randint(1, 3)):
        *way, last = draw.choice(places(document))
        part: Any = document
        for key in way:
            part = part[key]
        action = draw.random()
        if action < 0.2 and isinstance(part, dict):
            del part[last]
        elif action < 0.3 and isinstance(part, dict):
            part[draw.choice(["P_pu", "sag", "load", "fault", "breaker", "lasts", "over", "x"])] = copy.deepcopy(
                draw.choice(JUNK)
            )
        else:
            part[last] = copy.deepcopy(draw.choice(JUNK))
        if not document:
            break
    return document


@pytest.mark.parametrize("name", ["aemo", "fingrid", "own"])
def test_a_damaged_suite_is_refused_in_words(name: str) -> None:
    draw = random.Random(f"suite {name}")
    whole = packaged_document(name)
    if name == "own":  # a few of its sweeps, so that this stays quick
        whole["tests"] = [table for table in whole["tests"] if "island" in table["name"] or "ladder" in table["name"]]
    refused = []
    for _ in range(60):
        try:
            suite_from_document(damaged(whole, draw), "damaged", "damaged")
        except StudyError as error:
            refused.append(error)
    assert len(refused) > 30
    for error in refused:
        assert len(set(error.faults)) == len(error.faults)
        assert all(fault.field and fault.problem for fault in error.faults), str(error)
