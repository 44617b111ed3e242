"""Processor in the loop: the exported controller in QEMU against the one of this machine, bit by bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vsgdesign as vd
from tests.compilers import require_compiler
from tests.export.unit_loop import on_a_battery, study_with, unit_with
from vsgdesign.errors import ArtifactError
from vsgdesign.export import processor
from vsgdesign.export.processor import MATH, PER_TICK, PROGRAMS, processor_in_the_loop
from vsgdesign.export.unit import unit_of
from vsgdesign.report.processor import processor_sentences

SCHEDULED = 'kind = "scheduled", estimate = "field"'


@pytest.fixture
def installed() -> None:
    for program in PROGRAMS:
        require_compiler(program)


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(("core", "delay", "controller"), [("m4", 1, SCHEDULED), ("m7", 0, 'kind = "fixed"')])
def test_the_processor_has_the_bits_of_this_machine(core: str, delay: int, controller: str) -> None:
    """Through a step, a jump of the grid and a sag in which the current is limited; one of them on a battery."""
    study, unit = study_with(delay, controller), unit_with(delay, controller)
    if core == "m4":
        study = on_a_battery(study)
        unit = unit_of(study)
    found = processor_in_the_loop(unit, study, core=core)
    assert found.differing == 0
    assert found.first_difference is None
    assert found.document()["largest_difference_of_rated"] == dict.fromkeys(found.worst, 0.0)
    assert np.ptp(found.target.figures[:, 0]) > 0.3  # the events came
    assert len(found.instructions) == round(study.simulation.duration / study.converter.T_s)
    assert 1000 < found.instructions.min() <= found.instructions.max() < 100_000
    assert not (found.instructions % PER_TICK).any()
    assert "equal to those of this machine, to the bit" in processor_sentences(found.document())[0]


@pytest.mark.usefixtures("installed")
def test_with_two_libraries_the_figures_are_close_and_a_bit_may_differ() -> None:
    study, unit = study_with(1), unit_with(1)
    found = processor_in_the_loop(unit, study, math="library", duration=0.06)
    assert max(found.worst.values()) <= 1e-5
    first, said = found.first_difference, processor_sentences(found.document())[0]
    assert (first is None) == (found.differing == 0)
    assert first is None or first[1] in said


@pytest.mark.usefixtures("installed")
def test_a_machine_that_qemu_has_not_is_said_with_its_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(processor.CORES, "m4", ("mps2-an0", "cortex-m4"))
    with pytest.raises(ArtifactError, match=r"QEMU gave no answer: .*unsupported machine type"):
        processor_in_the_loop(unit_with(1), study_with(1), duration=0.001)


def test_what_is_missing_is_said_with_its_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ArtifactError, match=r"not installed: arm-none-eabi-gcc, qemu-system-arm, make, gcc\..*apt-get"):
        processor_in_the_loop(unit_with(1), study_with(1))
    with pytest.raises(ArtifactError, match="not installed"):
        vd.pil(study_with(1))


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"core": "m33"}, r'core = "m33": unknown\. Known: m4, m7'),
        ({"math": "own"}, r'math = "own": unknown\. Known: printed, library'),
        ({"duration": 1e-6}, r"duration = 1e-06 s: must be at least one sampling period, 5e-05 s"),
        ({"duration": float("nan")}, r"duration = nan s"),
    ],
)
def test_what_cannot_be_run_is_refused(asked: dict, said: str) -> None:
    assert MATH[0] == "printed"
    with pytest.raises(ArtifactError, match=said):
        processor_in_the_loop(unit_with(1), study_with(1), **asked)
