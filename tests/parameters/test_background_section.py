"""The sections [background] and [sensors]: ranges, draws that repeat by numbers, and every fault at once."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from tests.parameters.documents import build, case_document, faults_of
from vsgdesign.study.parameters import background as background_file
from vsgdesign.study.parameters import sensors as sensors_file
from vsgdesign.study.parameters.background import LEVELS, BackgroundSpec
from vsgdesign.study.parameters.sensors import CHANNELS, SensorSpec


def document(section: str, **fields: Any) -> dict[str, Any]:
    return case_document() | {section: fields}


def background(**fields: Any) -> BackgroundSpec:
    spec = build(document("background", **fields)).background
    assert spec is not None
    return spec


def sensors(**fields: Any) -> SensorSpec:
    spec = build(document("sensors", **fields)).sensors
    assert spec is not None
    return spec


def test_without_them_there_are_none_and_empty_ones_do_nothing() -> None:
    study = build(case_document())
    assert study.background is None
    assert study.sensors is None
    assert not background().distorts
    assert not sensors().act


def test_numbers_and_ranges() -> None:
    spec = background(level="dirty", seed=4, frequency_offset=["-20 mHz", "20 mHz"], harmonic_11=0, phase="30 deg")
    assert spec.phase == pytest.approx(math.pi / 6.0)
    assert -0.02 < spec.frequency_offset < 0.02
    assert 0.9 < spec.voltage_factor < 1.1
    assert [c.order for c in spec.components] == [-1.0, -5.0, 7.0, 13.0]
    assert all(0.0 < c.amplitude_pu < 0.03 for c in spec.components)


def test_a_number_for_one_quantity_changes_no_other() -> None:
    drawn, given = background(level="dirty", seed=4), background(level="dirty", seed=4, harmonic_5=0.01)
    assert given.voltage_factor == drawn.voltage_factor
    assert given.components[2:] == drawn.components[2:]
    assert given.components[1].phase == drawn.components[1].phase
    assert background(level="dirty", seed=5).voltage_factor != drawn.voltage_factor


def test_draws_fill_their_range() -> None:
    grid, sensing = background(level="dirty", seed=0), sensors(level="dirty", seed=0)
    values = [grid.redrawn(seed).frequency_offset for seed in range(200)]
    # Least and largest of 200 uniform numbers: within 5 % of the ends but for one draw in 15,000.
    assert -0.5 <= min(values) < -0.45
    assert 0.45 < max(values) <= 0.5
    noise = [sensing.redrawn(seed).noise for seed in range(200)]
    below = sum(value < math.sqrt(0.001 * 0.005) for value in noise)  # half, in the logarithm
    assert 70 < below < 130


@pytest.mark.parametrize("level", LEVELS)
def test_what_was_drawn_repeats_by_numbers(level: str) -> None:
    """The section that results.json holds, read as a study, is the same background."""
    drawn = background(level=level, seed=9, modulation=[0, 0.01], modulation_frequency="25 Hz", voltage_step=[0.1, 0.2])
    again = background(**json.loads(json.dumps(drawn.document())))
    assert {k: v for k, v in vars(again).items() if k != "ranges"} == {
        k: v for k, v in vars(drawn).items() if k != "ranges"
    }


@pytest.mark.parametrize("level", sensors_file.LEVELS)
def test_sensors_repeat_by_numbers(level: str) -> None:
    drawn = sensors(level=level, seed=9)
    again = sensors(**json.loads(json.dumps(drawn.document())))
    assert {k: v for k, v in vars(again).items() if k != "ranges"} == {
        k: v for k, v in vars(drawn).items() if k != "ranges"
    }
    assert drawn.act == (level != "ideal")


def test_sensors_as_given() -> None:
    spec = sensors(bits=10, gain_error=0.01, offset_errors=["1 %"] * 9, skew="0.1 deg")
    assert spec.range_pu == 3.0
    assert len(spec.gain_errors) == len(CHANNELS)
    assert 0.001 < max(map(abs, spec.gain_errors)) <= 0.01
    assert spec.offset_errors == (0.01,) * 9
    assert sensors(range_pu=2.0).act


def messages(document: dict[str, Any]) -> list[str]:
    return [str(fault) for fault in faults_of(document)]


def test_every_fault_of_a_background_at_once() -> None:
    said = messages(
        document(
            "background",
            level="dirtier",
            seed=-1,
            frequency_offset=["0.5 Hz", "-0.5 Hz"],
            voltage_factor=[0.9, 1.0, 1.1],
            harmonic_5=math.nan,
            harmonic_3=0.01,
            negative_sequence="1 Hz",
            frequency_wander="1.7 mHz",
            modulation=0.01,
            interharmonic=0.01,
            interharmonic_frequency=["-10 Hz", "10 Hz"],
            phase="400 deg",
        )
    )
    text = "\n".join(said)
    for expected in (
        "background.level",
        "background.seed",
        "background.frequency_offset",
        "the range is reversed. Give the lower end first",
        "a range has two ends",
        "background.harmonic_5",
        "must be a finite number",
        "background.harmonic_3: unknown field. Did you mean",
        "background.negative_sequence",
        "background.frequency_deviation",
        "Give frequency_deviation, which pulls it back",
        "background.modulation_frequency: missing",
        "a dc voltage lies in it",
        "background.phase",
    ):
        assert expected in text, (expected, text)
    assert len(said) == 11


def test_every_fault_of_sensors_at_once() -> None:
    said = messages(
        document(
            "sensors",
            noise="5 V",
            bits=12.5,
            range_pu=0.5,
            gain_error=0.01,
            gain_errors=[0.0] * 9,
            offset_errors=[0.0] * 8,
            skew="30 deg",
            ofset_error=0.1,
        )
    )
    text = "\n".join(said)
    for expected in (
        "sensors.noise",
        "sensors.bits",
        "sensors.range_pu",
        "gain_errors gives the errors themselves. Give one of them",
        "must have 9 values. In this order: v_a, v_b, v_c, i_s_a",
        "sensors.skew",
        "sensors.ofset_error: unknown field. Did you mean offset_error",
    ):
        assert expected in text, (expected, text)
    assert len(said) == 7


def test_the_page_has_the_levels_of_the_code() -> None:
    """Every number of the two tables of levels in docs/study-file.md."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "study-file.md").read_text(encoding="utf-8")
    for heading, module in (("a background", background_file), ("sensors", sensors_file)):
        body = page.split(f"### Levels of {heading}\n")[1].split("\n## ")[0]
        rows = {
            row[0]: row[1:] for row in re.findall(r"^\| `(\w+)` \| (.+?) \| (.+?) \| (.+?) \|$", body, re.MULTILINE)
        }
        assert rows
        for name, cells in rows.items():
            for level, cell in zip(module.LEVELS, cells, strict=True):
                if name == "bits":
                    assert int(cell) == sensors(level=level).bits
                else:
                    low, high = module.LEVELS[level][name]
                    assert numbers(cell) == pytest.approx((low, high), rel=1e-3), (name, level)
        silent = {name for level in module.LEVELS.values() for name, ends in level.items() if ends != (0.0, 0.0)}
        assert silent - {"modulation_frequency", "interharmonic_frequency"} <= set(rows)


def numbers(cell: str) -> tuple[float, float]:
    """Both ends of "0.1 to 0.2 mrad", SI."""
    text = cell.replace("−", "-").replace("π", str(math.pi))
    found = [float(value) for value in re.findall(r"-?\d[\d.]*", text)]
    scale = 1e-3 if " mHz" in text or " mrad" in text else 0.01 if "%" in text else 1.0
    return found[0] * scale, found[-1] * scale
