"""Exported C, compiled and called from Python for software in the loop: the scheduler, the controller, and the field
estimator with the converter as a whole. It needs a C compiler and the package cffi.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import ControllerOutput, ControllerSettings, Measurement
from vsgdesign.equations.field import FieldAnswer, FieldSettings
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import NO_NOTCH, NotchConstants, PowerLoopGains, References
from vsgdesign.equations.scheduler_data import TOLD_CHANGED, TOLD_LIMITED, TOLD_SURPRISED, SchedulerState
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime.updating import Answer, Covariance

SOURCES = ("vsg.c", "vsg_data.c", "vsg_power.c", "vsg_control.c", "vsg_math.c", "vsg_selftest.c")
FIELD_SOURCES = ("vsg_field.c", "vsg_converter.c")
"""The C files of every folder, and those of a folder with the field estimator."""
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror")


def compile_c(
    folder: str | Path, *, double: bool = False, compiler: str = "cc", flags: Sequence[str] = ("-O2",)
) -> CompiledC:
    """An exported folder as a library of this process, built in a temporary folder.

    Raises ArtifactError where there is no compiler, no cffi, or the C does not compile.
    """
    folder = Path(folder)
    if shutil.which(compiler) is None:
        raise ArtifactError(f'compiler "{compiler}": it is not installed. Install one (gcc, clang), or name another.')
    try:
        import cffi
    except ImportError as error:
        raise ArtifactError('the package cffi is not installed. Install vsgdesign with the extra "dev".') from error
    precision = ["-DVSG_DOUBLE"] if double else []
    ffi = cffi.FFI()
    ffi.cdef(_declarations(folder, compiler, precision))
    with tempfile.TemporaryDirectory(prefix="vsg") as build:
        library = Path(build) / "libvsg.so"
        sources = [str(path) for path in sources_of(folder)]
        run_compiler([compiler, *STRICT, *flags, *precision, "-shared", "-fPIC", *sources, "-o", str(library), "-lm"])
        loaded = ffi.dlopen(str(library))  # stays mapped when the file goes
    return CompiledC(ffi, loaded, double)


def sources_of(folder: Path) -> list[Path]:
    """The C files of an exported folder."""
    more = [name for name in FIELD_SOURCES if (folder / name).is_file()]
    return [folder / name for name in (*SOURCES, *more)]


def run_compiler(command: Sequence[str], text: str | None = None) -> str:
    """Runs a compiler and returns its output. Raises ArtifactError with its error message."""
    done = subprocess.run(command, input=text, capture_output=True, encoding="utf-8", errors="replace", check=False)
    if done.returncode != 0:
        raise ArtifactError(f"{command[0]} failed with {done.returncode}:\n{done.stderr.strip()[:2000]}")
    return done.stdout


def _declarations(folder: Path, compiler: str, precision: Sequence[str]) -> str:
    """The public header in the form that cffi takes. cffi knows the integer types, so there are no includes."""
    try:
        lines = (folder / "vsg.h").read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ArtifactError(f'cannot read "{folder / "vsg.h"}": {error.strerror}. Give an exported folder.') from error
    text = "\n".join(line for line in lines if not line.startswith("#include"))
    expanded = run_compiler([compiler, "-E", "-P", *precision, "-x", "c", "-"], text)
    # cffi knows no arithmetic in the length of an array.
    return _evaluated(expanded)


def _evaluated(text: str) -> str:
    import re

    def product(match: re.Match[str]) -> str:
        factors = map(int, re.findall(r"\d+", match[1]))
        return f"[{math.prod(factors)}]"

    return re.sub(r"\[([\d\sU*()]+)\]", product, text)


class CompiledC:
    """One scheduler of the compiled C, with the methods of :class:`vsgdesign.runtime.Scheduler`."""

    def __init__(self, ffi: Any, library: Any, double: bool) -> None:
        self.ffi, self.library, self.double = ffi, library, double
        self.real = "double" if double else "float"
        self._scheduler = ffi.new("vsg_scheduler_t *")
        self._answer = ffi.new("vsg_answer_t *")
        library.vsg_init(self._scheduler)

    @property
    def gains(self) -> PowerLoopGains:
        """The present gains."""
        return _read(PowerLoopGains, self._scheduler.gains)

    @property
    def grid(self) -> tuple[float, float]:
        """R_g (Ω) and L_g (H) of the place for which the present gains are made."""
        answer, grid = self.ffi.new("vsg_answer_t *"), self.ffi.new("vsg_grid_estimate_t *")
        answer.scr, answer.r_over_x = self._scheduler.scr, self._scheduler.r_over_x
        self.library.vsg_grid_of(answer, grid)
        return float(grid.R_g), float(grid.L_g)

    def selftest(self) -> int:
        """0, or the number of the first known answer that is wrong."""
        return int(self.library.vsg_selftest())

    def tell(self, *, limited: bool = False, surprised: bool = False, changed: bool = False) -> None:
        """What happened since the last update."""
        told = TOLD_LIMITED * bool(limited) | TOLD_SURPRISED * bool(surprised) | TOLD_CHANGED * bool(changed)
        self.library.vsg_tell(self._scheduler, told)

    def update_estimate(
        self,
        R_g: float,
        L_g: float,
        P: float,
        Q: float,
        V_rms: float,
        ticks: int,
        covariance: Covariance | None = None,
        changed: bool = False,
    ) -> Answer:
        """Gains from an estimate, with its covariance if it is known."""
        if covariance is None and not changed:
            self.library.vsg_update_estimate(self._scheduler, R_g, L_g, P, Q, V_rms, ticks & 0xFFFFFFFF, self._answer)
            return _answer_of(self._answer)
        known = self.ffi.NULL if covariance is None else self.ffi.new("vsg_covariance_t *", list(covariance))
        self.library.vsg_update_estimate_with(
            self._scheduler, R_g, L_g, known, int(changed), P, Q, V_rms, ticks & 0xFFFFFFFF, self._answer
        )
        return _answer_of(self._answer)

    def hold(self, P: float, Q: float, V_rms: float, ticks: int) -> Answer:
        """An update without an estimate."""
        self.library.vsg_hold(self._scheduler, P, Q, V_rms, ticks & 0xFFFFFFFF, self._answer)
        return _answer_of(self._answer)

    def update(self, v: Any, i: Any, P: float, Q: float, V_rms: float, ticks: int) -> Answer:
        """Gains from a window."""
        samples = [self._array(values) for values in (v, i)]
        self.library.vsg_update(self._scheduler, *samples, P, Q, V_rms, ticks & 0xFFFFFFFF, self._answer)
        return _answer_of(self._answer)

    def estimate(self, v: Any, i: Any) -> tuple[float, float, int]:
        """R_g, L_g and the reason of a window."""
        R_g, L_g = self.ffi.new("vsg_real_t *"), self.ffi.new("vsg_real_t *")
        reason = self.library.vsg_estimate(self._array(v), self._array(i), R_g, L_g)
        return float(R_g[0]), float(L_g[0]), int(reason)

    def start(self, R_g: float, L_g: float) -> bool:
        """Begin on a known grid; whether it is in the box."""
        return bool(self.library.vsg_start(self._scheduler, R_g, L_g))

    def load_state(self, state: SchedulerState) -> None:
        """Go on from a state of the Python scheduler, as this precision holds it."""
        for name, value in state._asdict().items():
            if name == "gains":
                for gain, number in value._asdict().items():
                    setattr(self._scheduler.gains, gain, number)
            else:
                setattr(self._scheduler, name, value)

    def power(
        self,
        gains: PowerLoopGains,
        refs: References,
        T_s: float,
        smoothing_P: float = 1.0,
        smoothing_Q: float = 1.0,
        before: NotchConstants = NO_NOTCH,
    ) -> CompiledPower:
        """Power loops of the compiled C, with a notch ``before`` their low-pass."""
        return CompiledPower(self, gains, refs, T_s, (smoothing_P, smoothing_Q), before)

    def control(
        self,
        gains: PowerLoopGains,
        inner_gains: InnerLoopGains,
        grid: GridEstimate,
        refs: References,
        settings: ControllerSettings,
    ) -> CompiledControl:
        """The whole controller of the compiled C, at rest at the set points."""
        return CompiledControl(self, gains, inner_gains, grid, refs, settings)

    def field(self, settings: FieldSettings, omega: float) -> CompiledField:
        """The field estimator of the compiled C, of a folder that has it; it knows nothing yet."""
        return CompiledField(self, settings, omega)

    def converter(self) -> CompiledConverter:
        """Controller, estimator and scheduler of the compiled C, of a folder that has the field estimator."""
        return CompiledConverter(self)

    def _array(self, values: Any) -> Any:
        array = np.ascontiguousarray(values, dtype=np.float64 if self.double else np.float32).ravel()
        return self.ffi.from_buffer("vsg_real_t[]", array)


class CompiledPower:
    """The power loops of the compiled C, with the methods of :class:`vsgdesign.runtime.PowerController`."""

    def __init__(
        self,
        made: CompiledC,
        gains: PowerLoopGains,
        refs: References,
        T_s: float,
        smoothing: tuple[float, float],
        before: NotchConstants,
    ) -> None:
        self._ffi, self._library = made.ffi, made.library
        self._power, self._voltage = made.ffi.new("vsg_power_t *"), made.ffi.new("vsg_voltage_t *")
        self._library.vsg_power_init(
            self._power, self._of(gains), made.ffi.new("vsg_references_t *", list(refs)), T_s, *smoothing
        )
        if before != NO_NOTCH:
            self._library.vsg_power_notch(self._power, *before)

    def step(self, P: float, Q: float) -> tuple[float, float, float]:
        """ω (rad/s), V (rms) and θ (rad) of this sample."""
        self._library.vsg_power_step(self._power, P, Q, self._voltage)
        return float(self._voltage.omega), float(self._voltage.V_rms), float(self._voltage.theta)

    def retune(self, gains: PowerLoopGains) -> None:
        """Other gains from the next sample on."""
        self._library.vsg_power_retune(self._power, self._of(gains))

    def _of(self, gains: PowerLoopGains) -> Any:
        return self._ffi.new("vsg_gains_t *", [float(value) for value in gains])


class CompiledControl:
    """The whole controller of the compiled C. ``data`` is its struct, which may be read and written."""

    def __init__(
        self,
        made: CompiledC,
        gains: PowerLoopGains,
        inner_gains: InnerLoopGains,
        grid: GridEstimate,
        refs: References,
        settings: ControllerSettings,
    ) -> None:
        self._ffi, self._library, self.used = made.ffi, made.library, True
        self.data, self._output = made.ffi.new("vsg_control_t *"), made.ffi.new("vsg_controller_output_t *")
        given = (("gains", gains), ("inner_gains", inner_gains), ("grid_estimate", grid), ("references", refs))
        records = [self._of(name, record) for name, record in given]
        self._library.vsg_control_init(self.data, *records, self._of("controller_settings", settings))

    def step(self, measured: Measurement) -> ControllerOutput:
        """One sample. ``used`` says whether the measurement was taken, or left out as implausible."""
        self.used = bool(self._library.vsg_control_step(self.data, self._of("measurement", measured), self._output))
        return _read(ControllerOutput, self._output)

    def grid_watch(self) -> Any:
        """What follows the grid's voltage behind an open breaker: ``vsg_grid_watch_t``."""
        watch = self._ffi.new("vsg_grid_watch_t *")
        self._library.vsg_grid_watch_init(watch, self._ffi.addressof(self.data.refs))
        return watch

    def synchronise(self, watch: Any, v_alpha: float, v_beta: float, measured: Measurement) -> bool:
        """The grid's voltage behind the open breaker (V peak) into angle, voltage and frequency; whether the breaker
        may close."""
        given = self._of("measurement", measured)
        return bool(self._library.vsg_control_synchronise(self.data, watch, v_alpha, v_beta, given))

    def retune(self, gains: PowerLoopGains, grid: GridEstimate) -> None:
        """Other gains of the power loops, and the grid that they are made for, from the next sample on. ``used`` says
        whether they were taken, or refused as no numbers."""
        records = self._of("gains", gains), self._of("grid_estimate", grid)
        self.used = bool(self._library.vsg_control_retune(self.data, *records))

    def _of(self, name: str, record: Any) -> Any:
        return self._ffi.new(f"vsg_{name}_t *", _numbers(record))


def _numbers(record: Any) -> list[Any]:
    """A NamedTuple as lists, without records that have no number."""
    nested = [_numbers(value) if isinstance(value, tuple) else float(value) for value in record]
    return [value for value in nested if value != []]


def _read(record: Any, data: Any) -> Any:
    """A NamedTuple of numbers out of the struct of the same name."""
    return record(*(float(getattr(data, name)) for name in record._fields))


def _answer_of(a: Any) -> Answer:
    """The answer of a scheduler."""
    return Answer(_read(PowerLoopGains, a.gains), int(a.status), int(a.reason), float(a.scr), float(a.r_over_x))


TRIPPED, OPEN, PROBE_OFF = 1, 2, 4
"""What a sample is told: the bridge does not switch, the breaker is open, no probe is to be sent."""

VALID, DOUBT, LIMITED, SPOILT, WAITS, NO_PROBE = 1, 2, 4, 8, 16, 32
"""Bits of :attr:`CompiledConverter.status`."""


class SentProbe(NamedTuple):
    """What is added to V (rms V) and θ (rad), and the probe as it is sent, u e^{jθ'} over the rated voltage."""

    V: float
    theta: float
    alpha: float
    beta: float


class CompiledField:
    """The field estimator of the compiled C. ``data`` is its struct, which may be read and written."""

    def __init__(self, made: CompiledC, settings: FieldSettings, omega: float) -> None:
        self._ffi, self._library = made.ffi, made.library
        self.data, self._settings = (
            made.ffi.new("vsg_field_t *"),
            made.ffi.new("vsg_field_settings_t *", list(settings)),
        )
        self._sent, self._answer = made.ffi.new("vsg_field_sent_t *"), made.ffi.new("vsg_field_answer_t *")
        self._measured = made.ffi.new("vsg_measurement_t *")
        self._library.vsg_field_init(self.data, self._settings, omega)

    @property
    def bytes(self) -> int:
        """Size of its state."""
        return int(self._ffi.sizeof("vsg_field_t"))

    def probe(self, V_rms: float, theta: float, V_n: float, inputs: int = 0) -> SentProbe:
        """The probe of the coming sample at the voltage V_rms (rms V) and the angle θ of the power loops."""
        self._library.vsg_field_probe(self.data, inputs, V_rms, theta, V_n, self._sent)
        return SentProbe(*(float(getattr(self._sent, name)) for name in SentProbe._fields))

    def listen(
        self,
        v: complex,
        i: complex,
        sent: complex,
        omega: float,
        *,
        used: bool = True,
        limited: bool = False,
        inputs: int = 0,
    ) -> bool:
        """One sample of the capacitor's voltage and the grid current (α + jβ, V and A peak), and what was sent (over
        the rated voltage). Whether a cycle waits to be concluded."""
        m, s = self._measured, self._sent
        m.v_alpha, m.v_beta, m.i_g_alpha, m.i_g_beta = v.real, v.imag, i.real, i.imag
        s.alpha, s.beta = sent.real, sent.imag
        return bool(self._library.vsg_field_listen(self.data, m, used, s, limited, inputs, omega))

    def conclude(self) -> FieldAnswer | None:
        """The answer of a closed cycle; None if no cycle waits."""
        if not self._library.vsg_field_conclude(self.data, self._answer):
            return None
        return _read(FieldAnswer, self._answer)


class CompiledConverter:
    """Controller, field estimator and scheduler of the compiled C in order. ``data`` is their struct."""

    def __init__(self, made: CompiledC) -> None:
        self._ffi, self._library = made.ffi, made.library
        self.data = made.ffi.new("vsg_converter_t *")
        self._measured, self._output = made.ffi.new("vsg_measurement_t *"), made.ffi.new("vsg_controller_output_t *")
        self._answer, self._watch = made.ffi.new("vsg_answer_t *"), made.ffi.new("vsg_grid_watch_t *")
        self._library.vsg_converter_init(self.data)
        self._library.vsg_grid_watch_init(self._watch, made.ffi.addressof(self.data.control.refs))

    @property
    def estimate(self) -> FieldAnswer:
        """The answer of the last cycle."""
        return _read(FieldAnswer, self.data.estimate)

    def status(self, inputs: int = 0) -> int:
        """Bits of VALID, DOUBT and so on."""
        return int(self._library.vsg_converter_status(self.data, inputs))

    def synchronise(self, v_alpha: float, v_beta: float, measured: Measurement) -> bool:
        """The grid's voltage behind the open breaker (V peak); whether the breaker may close."""
        given = self._given(measured)
        control = self._ffi.addressof(self.data.control)
        return bool(self._library.vsg_control_synchronise(control, self._watch, v_alpha, v_beta, given))

    def sample(self, measured: Measurement, inputs: int = 0) -> tuple[ControllerOutput, bool]:
        """One sample. Its output, and whether a cycle waits for :meth:`cycle`."""
        due = self._library.vsg_converter_sample(self.data, self._given(measured), inputs, self._output)
        return _read(ControllerOutput, self._output), bool(due)

    def cycle(self, ticks: int) -> Answer | None:
        """The scheduler's answer to a cycle; None if no cycle waits."""
        if not self._library.vsg_converter_cycle(self.data, ticks & 0xFFFFFFFF, self._answer):
            return None
        return _answer_of(self._answer)

    def _given(self, measured: Measurement) -> Any:
        for name, value in zip(Measurement._fields, measured, strict=True):
            setattr(self._measured, name, value)
        return self._measured
