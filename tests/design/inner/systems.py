"""Packaged converters for the tests of designed inner loops."""

from __future__ import annotations

import functools
import tomllib
from importlib import resources

from tests.parameters.documents import build
from vsgdesign.study.parameters.converter import Converter, Filter


@functools.cache
def datasheet(case: str) -> tuple[Converter, Filter]:
    """A packaged converter and its filter. The rule's inner gains only fill the place of those that are designed."""
    text = (resources.files("vsgdesign.study.parameters") / "cases" / f"{case}.toml").read_text(encoding="utf-8")
    study = build(
        tomllib.loads(text)
        | {
            "inner_loops": {"current_response_time": "1 ms", "voltage_response_time": "10 ms"},
            "simulation": {"duration": "1 s", "P_ref": 0, "Q_ref": 0},
            "controllers": [{"name": "scheduled", "kind": "scheduled"}],
        }
    )
    return study.converter, study.filter
