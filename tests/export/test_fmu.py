"""The FMU in FMPy, a client of another project: valid, compiled anew, in closed loop, saved, restored and refused."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compilers import require_compiler
from tests.export.conftest import built
from tests.export.unit_loop import FIXED, control_of, plain_c, run_loop, simulated, study_with, unit_with
from vsgdesign.export import Exported, export_fmu
from vsgdesign.export.c_code import export_unit_c
from vsgdesign.export.fmu import HEADERS, references, stubs, token_of
from vsgdesign.export.wrapping import Builder, Wrapped, wrapped

fmpy = pytest.importorskip("fmpy")

SCHEDULED = 'kind = "scheduled"'


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    require_compiler("gcc")
    with Builder("-O0") as one:
        yield one


@pytest.fixture(scope="module")
def exported(builder: Builder, tmp_path_factory: pytest.TempPathFactory) -> Any:
    kept: dict[tuple[Any, ...], tuple[Exported, Path]] = {}

    def make(
        delay: int, version: str = "3", variant: str = "controller", controller: str = FIXED
    ) -> tuple[Exported, Path]:
        key = delay, version, variant, controller
        if key not in kept:
            place = tmp_path_factory.mktemp("fmu")
            unit = unit_with(delay, controller)
            made = export_fmu(unit, place / "out", variant=variant, version=version, builder=builder)
            unzipped = place / "unzipped"
            with zipfile.ZipFile(made.folder / f"{made.manifest['name']}.fmu") as archive:
                archive.extractall(unzipped)
            kept[key] = made, unzipped
        return kept[key]

    return make


def slave(unzipped: Path, delay: int, controller: str = FIXED, variant: str = "controller", **parameters: float) -> Any:
    """A unit in FMPy, initialised."""
    return slave_of(wrapped(unit_with(delay, controller), variant), unzipped, **parameters)


def slave_of(one: Wrapped, unzipped: Path, **parameters: float) -> Any:
    """Any controller in FMPy, initialised."""
    from fmpy.fmi3 import FMU3Slave

    made = FMU3Slave(guid=token_of(one), unzipDirectory=str(unzipped), modelIdentifier=one.name, instanceName="one")
    made.instantiate()
    number = {ref.port.name: ref.number for ref in references(one)}
    made.enterInitializationMode(startTime=0.0)
    for name, value in parameters.items():
        made.setFloat64([number[name]], [value])
    made.exitInitializationMode()
    made.inputs = [ref.number for ref in references(one) if ref.port.kind == "input"]
    made.outputs = [ref.number for ref in references(one) if ref.port.kind == "output"]
    made.number, made.k, made.T_s = number, 0, one.unit.T_s
    return made


def step_of(made: Any) -> Any:
    """What it does in a sample, as a co-simulation calls it."""

    def step(given: np.ndarray) -> np.ndarray:
        made.setFloat64(made.inputs, given.tolist())
        made.doStep(made.k * made.T_s, made.T_s)
        made.k += 1
        return np.array(made.getFloat64(made.outputs))

    return step


@pytest.mark.parametrize("delay", [0, 1])
def test_in_closed_loop_it_is_the_exported_code_and_the_simulation(delay: int, exported: Any, tmp_path: Path) -> None:
    """With a delay that is wrong by one sample the same test is off by ten orders of magnitude."""
    study, unit = study_with(delay), unit_with(delay)
    _, unzipped = exported(delay)
    made = slave(unzipped, delay)
    run = run_loop(study, unit, step_of(made))
    made.freeInstance()
    control = control_of(built(export_unit_c(unit, tmp_path / "c").folder, True), unit)
    assert np.array_equal(run.figures, run_loop(study, unit, plain_c(control, unit)).figures)
    emt = simulated(study, unit)
    assert np.max(np.abs(run.figures - emt)) <= 1e-11  # 1e-13 at worst
    wrong = slave(unzipped, delay)
    late = run_loop(study, unit, step_of(wrong), late=1, samples=1000)
    wrong.freeInstance()
    assert np.max(np.abs(late.figures - emt[:1000])) > 1e-3


def test_fmi_2_is_fmi_3_to_the_bit(exported: Any) -> None:
    """Both binaries in FMPy in the same loop, with a schedule, through a step, a jump of the grid and into a sag."""
    from fmpy.fmi2 import FMU2Slave

    study, unit = study_with(1, SCHEDULED), unit_with(1, SCHEDULED)
    one = wrapped(unit, "controller")
    number = {ref.port.name: ref.number for ref in references(one)}
    new = slave(exported(1, "3", "controller", SCHEDULED)[1], 1, SCHEDULED)
    newer = run_loop(study, unit, step_of(new), samples=1900)
    new.freeInstance()
    place = str(exported(1, "2", "controller", SCHEDULED)[1])
    old = FMU2Slave(guid=token_of(one), unzipDirectory=place, modelIdentifier=one.name, instanceName="one")
    old.instantiate()
    old.setupExperiment(startTime=0.0)
    old.enterInitializationMode()
    old.exitInitializationMode()
    inputs, outputs = ([number[port.name] for port in ports] for ports in (one.ports.inputs, one.ports.outputs))
    k = 0

    def step(given: np.ndarray) -> np.ndarray:
        nonlocal k
        old.setReal(inputs, given.tolist())
        old.doStep(k * unit.T_s, unit.T_s)
        k += 1
        return np.array(old.getReal(outputs))

    older = run_loop(study, unit, step, samples=1900)
    old.freeInstance()
    assert np.array_equal(older.outputs, newer.outputs)
    assert np.ptp(newer.figures[:, 0]) > 0.2


@pytest.mark.parametrize(
    ("version", "variant"), [("3", "controller"), ("2", "controller"), ("3", "reference"), ("2", "reference")]
)
def test_it_is_valid(version: str, variant: str, exported: Any) -> None:
    from fmpy.validation import validate_fmu

    made, unzipped = exported(1, version, variant, SCHEDULED)
    assert validate_fmu(str(made.folder / f"{made.manifest['name']}.fmu")) == []
    for name in ("documentation/index.html", "documentation/licenses/fmi-headers.txt"):
        assert (unzipped / name).is_file()


@pytest.mark.parametrize("version", ["3", "2"])
def test_its_sources_compile_without_a_warning(version: str, exported: Any, tmp_path: Path) -> None:
    """FMPy's own build of the sources, with all warnings as errors, by its CMake; it then runs the new binary."""
    from fmpy.build import build_platform_binary

    _, unzipped = exported(1, version)
    copy = tmp_path / "copy"
    shutil.copytree(unzipped, copy)
    shutil.rmtree(copy / "binaries")
    if version == "2":  # FMPy's build reads the build description of FMI 3
        sources = sorted(str(path) for path in (copy / "sources").glob("*.c"))
        flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O0", "-shared", "-fPIC"]
        command = ["gcc", *flags, f"-I{copy / 'sources'}", *sources, "-o", str(tmp_path / "f.so"), "-lm"]
        subprocess.run(command, check=True)
        return
    (tmp_path / "build").mkdir()
    options = {"CMAKE_COMPILE_WARNING_AS_ERROR:BOOL": "ON"}
    build_platform_binary(copy, tmp_path / "build", all_warnings=True, cmake_options=options, configuration="Debug")
    assert list((copy / "binaries").glob("*/*.so"))
    made = slave(copy, 1)
    assert np.isfinite(step_of(made)(np.array(made.getFloat64(made.inputs)))).all()
    made.freeInstance()


@pytest.mark.parametrize("steps", [1, 2, 10])
def test_a_longer_step_is_so_many_samples(steps: int, exported: Any) -> None:
    """Inputs held over the step: the bits of single steps. A step that is off by rounding counts as whole."""
    _, unzipped = exported(0, controller=SCHEDULED)
    alone, together = (slave(unzipped, 0, SCHEDULED) for _ in range(2))
    given, T_s = np.array(alone.getFloat64(alone.inputs)), alone.T_s
    for k in range(600 // steps):
        given[0:9] = given[0:9] * 0.999
        for made in (alone, together):
            made.setFloat64(made.inputs, given.tolist())
        for j in range(steps):
            alone.doStep((k * steps + j) * T_s, T_s)
        together.doStep(k * steps * T_s, steps * T_s * (1.0 + 1e-9))
        assert alone.getFloat64(alone.outputs) == together.getFloat64(together.outputs)
    with pytest.raises(Exception, match="fmi3DoStep"):
        together.doStep(600 * T_s, 1.4 * T_s)
    for made in (alone, together):
        made.freeInstance()


RESTORED = """
import sys
from pathlib import Path
import numpy as np
from fmpy.fmi3 import FMU3Slave
unzipped, name, token, state, given, told, k, T_s = sys.argv[1:]
made = FMU3Slave(guid=token, unzipDirectory=unzipped, modelIdentifier=name, instanceName="other")
made.instantiate()
made.enterInitializationMode(startTime=0.0)
made.exitInitializationMode()
made.setFMUState(made.deserializeFMUState(Path(state).read_bytes()))
rows, T_s, k = np.load(given), float(T_s), int(k)
inputs = list(range(1, 1 + rows.shape[1]))
outputs = [ref for ref in map(int, Path(told).with_suffix(".txt").read_text().split())]
answers = []
for j, row in enumerate(rows):
    made.setFloat64(inputs, row.tolist())
    made.doStep((k + j) * T_s, T_s)
    answers.append(made.getFloat64(outputs))
np.save(told, np.array(answers))
"""


def test_a_state_saved_in_a_fault_goes_on_in_another_process(exported: Any, tmp_path: Path) -> None:
    study, unit = study_with(0, SCHEDULED), unit_with(0, SCHEDULED)
    made_of, unzipped = exported(0, controller=SCHEDULED)
    made = slave(unzipped, 0, SCHEDULED)
    step, seen, at = step_of(made), [], 1600  # in the sag

    def stepped(given: np.ndarray) -> np.ndarray:
        if made.k == at:
            (tmp_path / "state").write_bytes(made.serializeFMUState(made.getFMUState()))
        out = step(given)
        if made.k > at:
            seen.append((given.copy(), out))
        return out

    run_loop(study, unit, stepped, samples=1900)
    np.save(tmp_path / "given.npy", np.array([given for given, _ in seen]))
    (tmp_path / "told.txt").write_text(" ".join(map(str, made.outputs)))
    one = wrapped(unit, "controller")
    arguments = [
        unzipped,
        one.name,
        token_of(one),
        tmp_path / "state",
        tmp_path / "given.npy",
        tmp_path / "told.npy",
        at,
    ]
    subprocess.run([sys.executable, "-c", RESTORED, *map(str, arguments), repr(unit.T_s)], check=True)
    assert np.array_equal(np.load(tmp_path / "told.npy"), np.array([out for _, out in seen]))
    assert made_of.manifest["delay_samples"] == 0
    made.freeInstance()


def test_what_is_wrong_is_refused(exported: Any) -> None:
    """A wrong token gives no instance; an output cannot be set, and a start value not after the start; a NaN at an
    input leaves the sample out."""
    from fmpy.fmi3 import FMU3Slave

    _, unzipped = exported(1)
    one = wrapped(unit_with(1), "controller")
    other = FMU3Slave(guid="{0}", unzipDirectory=str(unzipped), modelIdentifier=one.name, instanceName="x")
    with pytest.raises(Exception, match="nstantiat"):
        other.instantiate()
    made = slave(unzipped, 1, theta_start=0.3)
    assert made.getFloat64([made.number["theta_start"], made.number["theta"], 0]) == [0.3, 0.3, 0.0]
    for name in ("theta", "theta_start"):
        with pytest.raises(Exception, match="fmi3SetFloat64"):
            made.setFloat64([made.number[name]], [0.0])
    with pytest.raises(Exception, match="fmi3GetFloat64"):
        made.getFloat64([10**6])
    given = np.array(made.getFloat64(made.inputs))
    given[4] = np.nan
    out = dict(zip(made.outputs, step_of(made)(given), strict=True))
    assert out[made.number["used"]] == 0.0
    assert np.isfinite(list(out.values())).all()
    made.freeInstance()


def test_its_reference_is_what_fmpy_simulates(exported: Any) -> None:
    made, unzipped = exported(1)
    place = unzipped / "extra" / "org.fmi-standard.fmi-ls-ref"
    name = made.manifest["name"]
    given = np.genfromtxt(place / f"{name}_in.csv", delimiter=",", names=True)
    told = np.genfromtxt(place / f"{name}_out.csv", delimiter=",", names=True)
    one = slave(unzipped, 1)
    step, names = step_of(one), [port.name for port in wrapped(unit_with(1), "controller").ports.outputs]
    at_v = [names.index(f"v_b_{phase}") for phase in "abc"]
    rows = np.array(given.tolist())[:, 1:]
    answers = np.array([step(row) for row in rows])
    assert np.array_equal(answers[:, at_v], np.array(told.tolist())[1:, 1:][:, at_v])
    one.freeInstance()


def test_every_function_of_the_standard_is_there() -> None:
    from fmpy import __file__ as place

    for version, names in HEADERS.items():
        for name in names:
            official = (Path(place).parent / "c-code" / name).read_text(encoding="utf-8")
            from vsgdesign.export.fmu import header

            assert header(name).split() == official.split(), name
        assert all(one["answer"] in (f"fmi{version}Error", "", "NULL") for one in stubs(version))
    assert len(stubs("3")) == 75 - 17
