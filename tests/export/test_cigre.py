"""The library with the IEEE/CIGRE interface, in the call orders of its importers."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compilers import require_compiler
from tests.export.cigre_host import Dll, Hosted, Info, InstanceData, Parameter, Signal
from tests.export.unit_loop import FIXED, Library, phases, run_loop, simulated, study_with, unit_with
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.export import export_dll
from vsgdesign.export.c_code import export_unit_c
from vsgdesign.export.wrapping import WINDOWS, WINDOWS_32, Builder

SCHEDULED = 'kind = "scheduled"'


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    require_compiler("gcc")
    with Builder("-O0") as one:
        yield one


@pytest.fixture(scope="module")
def exported(builder: Builder, tmp_path_factory: pytest.TempPathFactory) -> Any:
    kept: dict[tuple[Any, ...], Path] = {}

    def make(delay: int, controller: str = FIXED, variant: str = "controller") -> Path:
        key = delay, controller, variant
        if key not in kept:
            out = tmp_path_factory.mktemp("dll") / "out"
            kept[key] = export_dll(unit_with(delay, controller), out, variant=variant, builder=builder).folder
        return kept[key]

    return make


def dll(folder: Path) -> Dll:
    return Dll(next(folder.glob("*.so")))


def test_the_structures_have_the_layout_of_the_interface() -> None:
    assert [ctypes.sizeof(one) for one in (Signal, Parameter, Info, InstanceData)] == [32, 64, 160, 80]
    assert (Info.NumInputPorts.offset, Info.NumDoubleStates.offset, InstanceData.DoubleStates.offset) == (100, 152, 72)


def test_it_says_what_it_is(exported: Any) -> None:
    made, unit = dll(exported(1, SCHEDULED)), unit_with(1, SCHEDULED)
    assert tuple(made.info.Version) == (1, 1, 0, 0)
    assert made.info.FixedStepBaseSampleTime == unit.T_s
    assert made.info.EMT_RMS_Mode == 1
    assert (made.info.NumIntStates, made.info.NumFloatStates) == (0, 0)
    assert {(one.DataType, one.Width) for one in (*made.inputs, *made.outputs)} == {(9, 1)}
    names = [one.Name.decode() for one in (*made.inputs, *made.outputs, *made.parameters)]
    assert max(map(len, names)) <= 31
    assert len(made.info.text_0) <= 50
    symbols = subprocess.run(
        ["nm", "-D", "--defined-only", next(exported(1, SCHEDULED).glob("*.so"))], capture_output=True, check=True
    )
    assert sorted(line.split()[-1] for line in symbols.stdout.decode().splitlines()) == [
        *("Model_CheckParameters", "Model_FirstCall", "Model_GetInfo", "Model_Initialize", "Model_Iterate"),
        *("Model_Outputs", "Model_PrintInfo", "Model_Terminate"),
    ]


@pytest.mark.parametrize("delay", [0, 1])
def test_in_closed_loop_it_is_the_simulation(delay: int, exported: Any, tmp_path: Path) -> None:
    """At rest from the start; the output acts at once, so that the sample of delay is in it."""
    study, unit = study_with(delay), unit_with(delay)
    one, T_s = Hosted(dll(exported(delay)), start=0.0), unit.T_s
    run = run_loop(study, unit, lambda given: one.sample(given, one.k * T_s), acts_now=True)
    assert np.max(np.abs(run.figures - simulated(study, unit))) <= 1e-11
    library = Library(export_unit_c(unit, tmp_path / "c").folder, tmp_path, unit)
    assert np.array_equal(run.figures, run_loop(study, unit, library.instance().step).figures)


def test_two_instances_and_a_snapshot_in_a_sag(exported: Any) -> None:
    """Interleaved with another one; from a snapshot of DoubleStates a third one continues with the same bits."""
    study, unit = study_with(1, SCHEDULED), unit_with(1, SCHEDULED)
    made, T_s = dll(exported(1, SCHEDULED)), unit.T_s
    one, other, alone = (Hosted(made, start=0.0) for _ in range(3))
    restored = Hosted(made, start=0.0)

    def step(given: np.ndarray) -> np.ndarray:
        other.sample(given[::-1], other.k * T_s)
        out = one.sample(given, one.k * T_s)
        assert np.array_equal(alone.sample(given, alone.k * T_s), out)
        if one.k == 1600:
            restored.states[:] = one.states
            assert np.all((restored.states == 0.0) | (np.abs(restored.states) > 1e-300))  # nothing is denormal
        elif one.k > 1600:
            assert np.array_equal(restored.sample(given, (one.k - 1) * T_s), out)  # its first call, at a time above 0
        return out

    run_loop(study, unit, step, samples=1900, acts_now=True)
    assert np.array_equal(one.states, restored.states)


def test_initialised_at_every_step_until_its_release(exported: Any) -> None:
    """Until then the outputs are those of the tool; the angle is that of the live bus at once, without a jump."""
    study, unit = study_with(1, quiet=True), unit_with(1)
    one, T_s, release = Hosted(dll(exported(1)), release_s=0.05), unit.T_s, 0.05
    names = [port.Name.decode() for port in one.dll.outputs]
    amplitude, omega = rms_to_peak(study.converter.V_rated_rms), study.converter.omega_n
    given = np.array([port.start for port in Library.ports_of(unit).inputs])
    held = np.arange(len(names), dtype=float)
    told = []
    for k in range(1400):
        v = amplitude * np.exp(1j * (omega * k * T_s + 1.0))
        given[0:3] = phases(v)
        given[3:9] = 0.0
        given[9:12] = given[0:3]
        told.append(one.sample(given, k * T_s, held))
        if k * T_s <= release:
            assert np.array_equal(told[-1], held)
    theta = np.array([row[names.index("theta")] for row in told[round(release / T_s) + 1 :]])
    first = math.remainder(theta[0] - (omega * (release + T_s) + 1.0), 2.0 * math.pi)
    assert abs(first) < 1e-9
    assert np.max(np.abs(np.diff(np.unwrap(theta)) / (omega * T_s) - 1.0)) < 0.05


def test_what_is_wrong_is_said(exported: Any) -> None:
    made = dll(exported(1))
    bad = Hosted(made, V_start=1e9)
    assert bad.call("CheckParameters") == 2
    assert b"V_start: outside" in bad.data.LastErrorMessage
    late = Hosted(made, start=0.0)
    given = np.array([port.start for port in Library.ports_of(unit_with(1)).inputs])
    late.sample(given, 0.0)
    late.inputs[:], late.data.Time = given, 10.0 * unit_with(1).T_s
    assert late.call("Outputs") == 2
    assert b"has to be called every" in late.data.LastErrorMessage
    given[0] = math.nan
    names = [port.Name.decode() for port in made.outputs]
    other = Hosted(made, start=0.0)
    out = other.sample(given, 0.0)
    assert out[names.index("used")] == 0.0
    assert np.isfinite(out).all()


def test_the_power_loops_keep_the_rest_of_a_long_step(exported: Any) -> None:
    """A phasor tool with steps of 1.03 ms: the same samples as one with steps of T_s."""
    unit = unit_with(0, SCHEDULED)
    made = dll(exported(0, SCHEDULED, "reference"))
    assert (made.info.FixedStepBaseSampleTime, made.info.EMT_RMS_Mode) == (-1.0, 2)
    long, short = Hosted(made, start=0.0), Hosted(made, start=0.0)
    given = np.array([port.start for port in Library.ports_of(unit, "reference").inputs])
    given[0] *= 1.1
    out = same = np.zeros(0)
    for k in range(60):
        out = long.sample(given, k * 1.03e-3)
    last = math.floor(59 * 1.03e-3 / unit.T_s + 1e-3)
    for k in range(last + 1):
        same = short.sample(given, k * unit.T_s)
    assert np.array_equal(out, same)


def test_the_windows_libraries_need_two_others_and_export_eight_names(exported: Any) -> None:
    """That of 64 bits, and that of 32 bits where its compiler is installed: the names are the same in both."""
    require_compiler(WINDOWS)
    libraries = list(exported(1).glob("*.dll"))
    assert len(libraries) == 1 + (shutil.which(WINDOWS_32) is not None)
    for library in libraries:
        command = ["x86_64-w64-mingw32-objdump", "-p", str(library)]
        said = subprocess.run(command, capture_output=True, check=True).stdout.decode()
        needed = [line.split()[-1] for line in said.splitlines() if "DLL Name" in line]
        assert sorted(needed) == ["KERNEL32.dll", "msvcrt.dll"]
        assert sum(line.split()[-1].startswith("Model_") for line in said.splitlines() if "Model_" in line) == 8
