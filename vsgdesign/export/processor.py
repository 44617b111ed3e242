"""An exported controller in closed loop with the circuit of its study, and the processor in the loop: the controller in
QEMU, and its circuit here.

The same controller is compiled for this machine, too, in the same precision, and run with the same circuit. What is
compared is every bit of its outputs. QEMU counts instructions, and says nothing of cycles.
"""

from __future__ import annotations

import contextlib
import ctypes
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import clarke, clarke_inverse, rated_current_rms, rms_to_peak
from vsgdesign.errors import ArtifactError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.export.compiled import run_compiler
from vsgdesign.export.firmware import export_firmware
from vsgdesign.export.unit import Unit
from vsgdesign.export.unit_content import lists_of, unit_hash
from vsgdesign.export.wrapping import LINUX, Builder
from vsgdesign.simulation.plant_alone import PlantAlone
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

Step = Callable[[Array], Any]
"""What a controller does in a sample: its outputs from its inputs, in the order of its ports."""

FIGURES = ("P", "Q", "omega", "i_s_alpha", "i_s_beta")


@dataclass(frozen=True)
class LoopRun:
    """What a controller and its circuit did, a row for every sample."""

    figures: Array
    """(n, 5): P and Q over the rated power, ω over the nominal one, and the bridge's current, α and β, over the rated
    one (FIGURES)."""
    outputs: Array
    """(n, outputs): the controller's outputs in the order of its ports, SI."""


def run_loop(
    unit: Unit, plant: PlantAlone, step: Step, samples: int, *, late: int = 0, acts_now: bool = False
) -> LoopRun:
    """A controller with its circuit for so many samples.

    ``late``: so many samples more until a voltage acts. ``acts_now``: the controller gives the voltage that acts in
    this sample, and not the one that it has made for the next.
    """
    ports = lists_of(unit)["controller"]
    at_in = {port.name: k for k, port in enumerate(ports.inputs)}
    at_out = {port.name: k for k, port in enumerate(ports.outputs)}
    given = np.array([port.start for port in ports.inputs])
    S, I_pk = unit.S_rated, rms_to_peak(rated_current_rms(unit.S_rated, unit.V_rated_rms))
    waits = [vector(phases(plant.pending))] * ((0 if acts_now else unit.delay_samples) + late)
    figures, outputs = np.empty((samples, len(FIGURES))), np.empty((samples, len(ports.outputs)))
    for k in range(samples):
        v, i_s, i_g = plant.measured
        closed, refs = plant.closed, plant.references
        behind = v if closed else plant.source
        for name, value in (("v", v), ("i_s", i_s), ("i_g", i_g), ("v_grid", behind)):
            given[at_in[f"{name}_a"] : at_in[f"{name}_a"] + 3] = phases(value)
        given[at_in["closed"]] = float(closed)
        if "v_dc" in at_in:
            given[at_in["v_dc"]] = plant.v_dc
        if "P_dc_low" in at_in:
            given[at_in["P_dc_low"]], given[at_in["P_dc_high"]] = plant.source_limits
        for name in ("P_ref", "Q_ref", "omega_0", "V_n"):
            given[at_in[name]] = getattr(refs, name)
        if "R_g" in at_in:
            grid = plant.known_grid
            known = bool(np.isfinite(grid.R_g))
            given[at_in["estimated"]] = float(known)
            if known:
                units = 1 if unit.on_line is None else unit.on_line.most
                given[at_in["R_g"]], given[at_in["L_g"]] = grid.R_g / units, grid.L_g / units
        out = outputs[k] = step(given)
        figures[k] = (
            out[at_out["P"]] / S,
            out[at_out["Q"]] / S,
            out[at_out["omega"]] / unit.omega_n,
            i_s.real / I_pk,
            i_s.imag / I_pk,
        )
        waits.append(vector(out[at_out["v_b_a"] : at_out["v_b_a"] + 3]))
        plant.advance(waits.pop(0))
    return LoopRun(figures, outputs)


def phases(vector_of: complex) -> tuple[float, float, float]:
    """Three phases of α + jβ."""
    a, b, c = clarke_inverse(float(vector_of.real), float(vector_of.imag))
    return a, b, c


def vector(abc: Any) -> complex:
    """α + jβ of three phases."""
    return complex(*clarke(*map(float, abc)))


Singles = NDArray[np.float32]

CORES: dict[str, tuple[str, str]] = {"m4": ("mps2-an386", "cortex-m4"), "m7": ("mps2-an500", "cortex-m7")}
"""Machine and processor of QEMU."""

MATH = ("printed", "library")
"""Whose sine, cosine and angle: those that are printed into the export, or those of each toolchain's C library."""

PER_TICK = 40
"""Instructions of a tick of SysTick, which counts at 25 MHz while an instruction takes a nanosecond."""

PROGRAMS = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
    "make": "make",
    LINUX: "gcc",
}
"""What is needed, and the packages of Debian that have it."""

ANSWERS_WITHIN_S = 60.0
"""So long QEMU may take for one sample before it is given up."""


@dataclass(frozen=True, kw_only=True)
class ProcessorRun:
    """A controller in QEMU and the same one here, each in closed loop with the circuit of the study."""

    study: Study
    unit: Unit
    core: str
    math: str
    target: LoopRun
    """In QEMU."""
    host: LoopRun
    """Here, in single precision."""
    instructions: NDArray[np.int64]
    """Of each sample in QEMU, to within PER_TICK; their mean is exact to PER_TICK over the number of samples."""

    @property
    def differing(self) -> int:
        """Samples in which a bit of an output differs."""
        return int(np.any(self._unequal, axis=1).sum())

    @property
    def first_difference(self) -> tuple[float, str] | None:
        """When the first bit differs, s, and in which output; None: never."""
        rows, columns = np.nonzero(self._unequal)
        if not len(rows):
            return None
        ports = lists_of(self.unit)["controller"].outputs
        return float(rows[0] * self.unit.T_s), ports[int(columns[0])].name

    @property
    def _unequal(self) -> NDArray[np.bool_]:
        ours, theirs = (run.outputs.astype(np.float32).view(np.uint32) for run in (self.host, self.target))
        return np.asarray(ours != theirs)

    @property
    def left_out(self) -> list[str]:
        """What the study has and this run has not, in words."""
        study, found = self.study, []
        if study.simulation.bridge != "averaged":
            found.append("the switching of the bridge, which is averaged")
        for name, there in (
            ("the cold start: it begins at rest", study.simulation.start == "cold"),
            ("the background of the grid", study.background is not None),
            ("the recorded voltage", study.replay is not None),
            ("the errors of the sensors", study.sensors is not None and study.sensors.act),
            ("the protection", study.protection is not None),
            ("harmonics and the negative sequence of the source", study.replay is None and study.has_components),
        ):
            found += [name] if there else []
        return [*found, *(note.rstrip(".") for note in self.unit.notes)]

    @property
    def worst(self) -> dict[str, float]:
        """Largest difference of each figure, of rated."""
        sizes = np.max(np.abs(self.target.figures - self.host.figures), axis=0)
        return dict(zip(FIGURES, map(float, sizes), strict=True))

    def document(self) -> dict[str, Any]:
        """What was found, in JSON's types."""
        first = self.first_difference
        return {
            "study": {"name": self.study.name, "hash": self.study.hash},
            "controller": self.unit.controller,
            "machine": CORES[self.core][0],
            "processor": CORES[self.core][1],
            "math": self.math,
            "T_s": self.unit.T_s,
            "samples": len(self.instructions),
            "differing_samples": self.differing,
            "first_difference": None if first is None else {"t_s": first[0], "output": first[1]},
            "largest_difference_of_rated": self.worst,
            "instructions": {
                "mean": float(self.instructions.mean()),
                "largest": int(self.instructions.max()),
                "resolution": PER_TICK,
            },
            "left_out": self.left_out,
        }


def missing_programs() -> list[str]:
    """What is not installed of all that is needed."""
    return [name for name in PROGRAMS if shutil.which(name) is None]


def processor_in_the_loop(
    unit: Unit,
    study: Study,
    *,
    core: str = "m4",
    math: str = "printed",
    duration: float | None = None,
    progress: Progress | None = None,
) -> ProcessorRun:
    """A controller of a study in QEMU in closed loop with the circuit of the study and its events.

    ``study`` has the current limit of the controller. ``core``: a name in CORES; ``math``: one of MATH; ``duration``
    in s: that of the study, if it is not given. The bridge is averaged, the sensors are ideal, and the source is the
    fundamental that the events say. A controller that is told the grid is told the true one. Raises ArtifactError where
    a program is missing or the C does not compile, and the errors of :class:`PlantAlone`.
    """
    for name, value, known in (("core", core, CORES), ("math", math, MATH)):
        if value not in known:
            raise ArtifactError(f'{name} = "{value}": unknown. Known: {", ".join(known)}.')
    wanted = study.simulation.duration if duration is None else duration
    if not unit.T_s <= wanted < float("inf"):
        raise ArtifactError(f"duration = {wanted:g} s: must be at least one sampling period, {unit.T_s:g} s.")
    samples = round(wanted / unit.T_s)
    if missing := missing_programs():
        packages = " ".join(PROGRAMS[name] for name in missing)
        raise ArtifactError(
            f"not installed: {', '.join(missing)}. The controller is built for a processor and run in QEMU. Install "
            f"{'it' if len(missing) == 1 else 'them'} (Debian: apt-get install {packages})."
        )
    tell = progress or silent
    rests = replace(study, simulation=replace(study.simulation, start="steady_state"))
    with tempfile.TemporaryDirectory(prefix="vsg") as name:
        folder = export_firmware(unit, Path(name) / "firmware").folder
        tell("build", 0.0)
        program = f"pil_{core}.elf"
        run_compiler(["make", "-s", "-C", str(folder), f"MATH={math}", program])
        tell("build", 0.5)
        with _on_this_machine(unit, math) as here:
            tell("build", 1.0)
            host = run_loop(unit, PlantAlone(rests, unit.gains), _told(here, "here", samples, tell), samples)
        with _in_qemu(unit, folder / program, core) as processor:
            there = _told(processor.step, "in QEMU", samples, tell)
            target = run_loop(unit, PlantAlone(rests, unit.gains), there, samples)
    instructions = np.array(processor.ticks, dtype=np.int64) * PER_TICK
    return ProcessorRun(
        study=study, unit=unit, core=core, math=math, target=target, host=host, instructions=instructions
    )


def _told(step: Step, where: str, samples: int, tell: Progress) -> Step:
    """The same, which says now and then how far it is."""
    done = 0

    def stepped(given: Any) -> Any:
        nonlocal done
        if done % 500 == 0:
            tell(f"run {where}", done / samples)
        done += 1
        return step(given)

    return stepped


@contextlib.contextmanager
def _on_this_machine(unit: Unit, math: str) -> Iterator[Step]:
    """The controller of this machine in single precision."""
    defined = ("-DVSG_PRINTED_MATH",) if math == "printed" else ()
    with Builder(defined=defined) as builder:
        library = builder.library(unit, {}, LINUX, "vsg_*")
        if library is None:
            raise ArtifactError(f"not installed: {LINUX}.")
        with tempfile.NamedTemporaryFile(suffix=".so", delete=False) as place:
            place.write(library)
    try:
        loaded = ctypes.CDLL(place.name)  # stays mapped when the file goes
    finally:
        Path(place.name).unlink()
    ports = lists_of(unit)["controller"]
    state, outputs = ctypes.create_string_buffer(1 << 16), np.zeros(len(ports.outputs), dtype=np.float32)
    parameters = np.array([port.start for port in ports.parameters], dtype=np.float32)
    loaded.vsg_unit_begin(state, _pointer(parameters))

    def step(given: Any) -> Singles:
        inputs = np.asarray(given, dtype=np.float32)
        loaded.vsg_unit_step(state, _pointer(inputs), _pointer(parameters), _pointer(outputs))
        return outputs

    yield step


def _pointer(array: Singles) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_float))


@contextlib.contextmanager
def _in_qemu(unit: Unit, program: Path, core: str) -> Iterator[_Processor]:
    """The controller in QEMU."""
    machine, cpu = CORES[core]
    command = ["qemu-system-arm", "-M", machine, "-cpu", cpu, "-display", "none", "-serial", "none", "-monitor", "none"]
    command += ["-semihosting-config", "enable=on,target=native", "-icount", "shift=0", "-kernel", str(program)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe) as process:
        try:
            if process.stdin is None or process.stdout is None or process.stderr is None:
                raise ArtifactError("QEMU has no pipes.")
            yield _Processor(unit, process, process.stdin, process.stdout, process.stderr)
        finally:
            process.kill()


class _Processor:
    """A controller in a running QEMU."""

    def __init__(
        self, unit: Unit, process: subprocess.Popen[bytes], to: IO[bytes], back: IO[bytes], complaints: IO[bytes]
    ) -> None:
        lists = lists_of(unit)
        ports = lists["controller"]
        self._process, self._to, self._back, self._complaints = process, to, back, complaints
        self._outputs, self.ticks = len(ports.outputs), list[int]()
        found, expected = self._read(64), unit_hash(unit, lists).encode()
        counts = tuple(np.frombuffer(self._read(12), dtype="<u4").tolist())
        if found != expected or counts != (len(ports.inputs), len(ports.parameters), self._outputs):
            raise ArtifactError("the program in QEMU is of another controller. Build it again.")
        self._write(np.array([port.start for port in ports.parameters], dtype="<f4"))

    def step(self, given: Any) -> Singles:
        """One sample."""
        self._write(np.asarray(given, dtype="<f4"))
        told = self._read(4 * self._outputs + 4)
        self.ticks.append(int.from_bytes(told[-4:], "little"))
        return np.frombuffer(told[:-4], dtype="<f4")

    def _write(self, values: Any) -> None:
        with contextlib.suppress(BrokenPipeError):  # the reader says why
            self._to.write(values.tobytes())
            self._to.flush()

    def _read(self, count: int) -> bytes:
        watch = threading.Timer(ANSWERS_WITHIN_S, self._process.kill)
        watch.start()
        try:
            found = self._back.read(count)
        finally:
            watch.cancel()
        if len(found) < count:
            why = self._complaints.read().decode(errors="replace").strip() or "it ended, or gave no answer for a minute"
            raise ArtifactError(f"QEMU gave no answer: {why}.")
        return found
