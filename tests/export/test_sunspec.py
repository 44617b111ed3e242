"""The map to SunSpec's models: every point of the published models, in their units, and the values of a study."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.export.unit_loop import unit_with
from vsgdesign.export.sunspec import MODELS, PROPOSED, WITHOUT, export_sunspec, sunspec_map
from vsgdesign.export.unit import unit_of
from vsgdesign.study.parameters import study_from_text


def published(number: int) -> dict[str, Any]:
    """A model as the package pysunspec2 has it."""
    found = importlib.util.find_spec("sunspec2")
    assert found is not None
    assert found.origin is not None
    text = (Path(found.origin).parent / "models" / "json" / f"model_{number}.json").read_text(encoding="utf-8")
    model: dict[str, Any] = json.loads(text)["group"]
    return model


def points(group: dict[str, Any], path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    for point in group.get("points", []):
        yield f"{path}{point['name']}", point
    for inner in group.get("groups", []):
        yield from points(inner, f"{path}{inner['name']}.")


@pytest.mark.parametrize("number", [number for number in MODELS if number != PROPOSED])
def test_every_point_of_a_published_model_is_there_in_its_unit(number: int) -> None:
    model = published(number)
    known = dict(points(model))
    assert MODELS[number].name == model["name"]
    assert MODELS[number].points == tuple(known)
    told = sunspec_map(unit_with(1))["models"][str(number)]["points"]
    for name, one in told.items():
        if "unit" in one:
            assert one["unit"] == known[name].get("units", ""), name
        symbols = {symbol["name"]: symbol["value"] for symbol in known[name].get("symbols", [])}
        if symbols and "value" in one:
            assert symbols[one["note"]] == one["value"], name


def test_a_point_has_a_value_a_port_or_a_reason() -> None:
    for unit in (unit_with(1), unit_with(0, 'kind = "scheduled", estimate = "field"')):
        document = sunspec_map(unit)
        for number, model in document["models"].items():
            assert tuple(model["points"]) == MODELS[int(number)].points
            for name, one in model["points"].items():
                kinds = {"value", "port", "no counterpart"} & one.keys()
                assert len(kinds) == 1, (number, name)
                assert "value" not in one or np.isfinite(one["value"])
        assert "is a proposal" in document["proposal"]
    assert all(set(WITHOUT[number]) <= set(model.points) for number, model in MODELS.items())
    assert "schedule over R_g and L_g" in str(document["without a point"])


def test_the_values_are_those_of_the_study(tmp_path: Path) -> None:
    """By hand: 12.5 kVA, 400 V, a limit of 1.2 pu, droops of 5 %, R_t = 0.08 pu, a low-pass of 5 ms."""
    made = export_sunspec(unit_with(1), tmp_path / "s")
    read = json.loads((made.folder / "sunspec.json").read_text(encoding="utf-8"))
    told = {
        number: {name: one["value"] for name, one in model["points"].items() if "value" in one}
        for number, model in read["models"].items()
    }
    expected = {"WMaxRtg": 12_500.0, "VAMaxRtg": 12_500.0, "VNomRtg": 400.0, "AMaxRtg": 12_500.0 / (3**0.5 * 400.0)}
    for name, value in expected.items():
        assert told["702"][name] == pytest.approx(value, rel=1e-12), name
    assert told["704"]["WSet"] == pytest.approx(0.3 * 12_500.0)
    assert told["704"]["WSetPct"] == pytest.approx(30.0)
    assert told["711"]["Ctl.KOf"] == pytest.approx(0.05)
    forming = told["64416"]
    assert forming["DroopP"] == pytest.approx(0.05)
    assert forming["VirtualR"] == pytest.approx(0.08)
    assert forming["FilterTms"] == pytest.approx(5.0)
    assert forming["IMaxCont"] == pytest.approx(1.2 * expected["AMaxRtg"])
    assert forming["HzRef"] == pytest.approx(50.0)


def test_what_a_study_has_not_says_why() -> None:
    text = """base = "case:lab_12kva_lcl"
power_loops = { tau_P = "0 s", tau_Q = "0 s" }
controllers = [{ name = "one", kind = "fixed" }]
simulation = { duration = "1 s", P_ref = "0 W", Q_ref = "0 var" }"""
    forming = sunspec_map(unit_of(study_from_text(text)))["models"]["64416"]["points"]
    assert "no low-pass" in forming["FilterTms"]["no counterpart"]
