"""The exported field estimator and the exported converter as a whole, called from Python."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from vsgdesign.equations.controller import ControllerOutput, Measurement
from vsgdesign.equations.field import FieldAnswer, FieldSettings
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.scheduler import Answer

if TYPE_CHECKING:
    from vsgdesign.export.compiled import CompiledC

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
        return _answer(self._answer)


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
        return _answer(self.data.estimate)

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
        output = ControllerOutput(*(float(getattr(self._output, name)) for name in ControllerOutput._fields))
        return output, bool(due)

    def cycle(self, ticks: int) -> Answer | None:
        """The scheduler's answer to a cycle; None if no cycle waits."""
        if not self._library.vsg_converter_cycle(self.data, ticks & 0xFFFFFFFF, self._answer):
            return None
        a = self._answer
        gains = PowerLoopGains(*(float(getattr(a.gains, name)) for name in PowerLoopGains._fields))
        return Answer(gains, int(a.status), int(a.reason), float(a.scr), float(a.r_over_x))

    def _given(self, measured: Measurement) -> Any:
        for name, value in zip(Measurement._fields, measured, strict=True):
            setattr(self._measured, name, value)
        return self._measured


def _answer(data: Any) -> FieldAnswer:
    return FieldAnswer(*(float(getattr(data, name)) for name in FieldAnswer._fields))
