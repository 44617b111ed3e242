"""Mangled studies: whatever is deleted, renamed or replaced, only a StudyError may come out."""

from __future__ import annotations

import copy
import math
from typing import Any

from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from tests.examples import examples
from tests.parameters.documents import case_document, to_toml
from vsgdesign.errors import StudyError
from vsgdesign.study.parameters import Study, study_from_text

DOCUMENT: dict[str, Any] = case_document() | {
    "network": {"load": {"P": "1 kW", "series": {"R_pu": 2.0, "X_L_pu": 0.5}}}
}
DOCUMENT["events"] += [
    {"time": 51.0, "fault": {"kind": "phase_to_phase", "at": 0.5, "R": "1 ohm", "phases": "ca"}, "breaker": "open"},
    {"time": 52.0, "fault": "cleared", "sag": {"type": "C", "V_pu": 0.5, "angle": "-20 deg"}},
    {"time": 53.0, "sag": "none", "breaker": "closed", "synchro_check": {"angle": "5 deg", "around": 0.1}},
]


def paths_of(value: Any, above: tuple = ()) -> list[tuple]:
    """Every place of a document: tables, lists and leaves."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path for key, item in items for path in [(*above, key), *paths_of(item, (*above, key))]]


PATHS = paths_of(DOCUMENT)

LEAVES = st.one_of(
    st.sampled_from(["", " ", "nan", "inf", "-1 V", "0 s", "1e999", "1e999999999 GW", "5 kVA", "50 Hz", "1 ms", "LCL",
                     "LC", "fixed", "cold", "pwm", "case:hoang2025_5kva", "20 ms", "45 deg", "\u0663 s", "µ"]),
    st.sampled_from([0, -1, 1, 2, 64, 10**30, 10**400, True, False, math.nan, math.inf, -math.inf, 0.0, -0.0, 1e-320,
                     1e308, 1e-4, 0.02]),
    st.floats(),
    st.integers(-100, 100000),
    st.text(st.characters(exclude_categories=("Cs",)), max_size=12),
)  # fmt: skip
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.sampled_from(["scr", "x_over_r", "R_g", "L_g", "name", "kind", "time", "K_ip"]), inner),
    ),
    max_leaves=5,
)
CHANGE = st.tuples(st.sampled_from(PATHS), st.sampled_from(["delete", "replace", "rename", "swap"]), VALUES)


def mangle(document: dict[str, Any], path: tuple, action: str, value: Any) -> None:
    """Do one thing to one place, if it is still there."""
    here: Any = document
    for step in path[:-1]:
        if not (isinstance(here, dict) and step in here) and not (isinstance(here, list) and step in range(len(here))):
            return
        here = here[step]
    last = path[-1]
    if isinstance(here, list):
        if not isinstance(last, int) or last >= len(here):
            return
        if action == "delete":
            del here[last]
        else:
            here[last] = value
    elif isinstance(here, dict):
        if action == "delete":
            here.pop(last, None)
        elif action == "rename" and last in here:
            here[f"{last}_"] = here.pop(last)
        elif action == "swap" and len(here) > 1:  # a field gets its neighbour's value: the wrong unit, mostly
            here[last] = copy.deepcopy(next(iter(here.values())))
        else:
            here[last] = value


HEALTH_CHECKS: Any = list(HealthCheck)


def attempt(text: str) -> tuple[Study | None, StudyError | None]:
    """The study, or why not. Anything but a StudyError goes through and fails the test."""
    try:
        return study_from_text(text), None
    except StudyError as error:
        return None, error


@examples(150, suppress_health_check=HEALTH_CHECKS)
@given(st.lists(CHANGE, min_size=1, max_size=5))
def test_only_a_study_error_comes_out(changes: list[tuple[tuple, str, Any]]) -> None:
    document = copy.deepcopy(DOCUMENT)
    for change in changes:
        mangle(document, *change)
    study, error = attempt(to_toml(document))
    if study is None:
        assert error is not None
        assert all(fault.problem and fault.field for fault in error.faults)
        return
    # What passes is usable: no NaN hides in a resolved study.
    for value in (study.converter.T_s, study.grid.R_g, study.grid.L_g, *study.inner_gains, study.target.settling_time):
        assert math.isfinite(value)
    for event in study.events:
        assert math.isfinite(event.t_s)
        assert event.grid is None or (math.isfinite(event.grid.R_g) and event.grid.L_g > 0.0)


@examples(60)
@given(st.text(st.characters(exclude_categories=("Cs",)), max_size=200))
def test_any_text_at_all(text: str) -> None:
    study, error = attempt(text)
    assert study is not None or (error is not None and error.faults)
