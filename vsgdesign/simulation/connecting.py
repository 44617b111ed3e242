"""A converter that sets itself to the grid behind its open breaker, as the exported controller does."""

from __future__ import annotations

import cmath
import math
from typing import Any

from vsgdesign.equations.controller_data import ControllerState, Measurement
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.synchronising import GridWatch, in_step, synchronised, watch_grid
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.study import Study

IN_STEP_S = 0.2
"""Time for which the converter must be in step before the breaker closes, s, as with the exported code."""

LONGEST_S = 5.0
"""Time after which a converter that is not in step gives up, s."""


class InStep(Exception):
    """Raised in a run that looks for the instant at which the breaker closes. ``t_s`` is None where it never does."""

    def __init__(self, t_s: float | None) -> None:
        super().__init__("the converter is in step" if t_s is not None else "the converter is never in step")
        self.t_s = t_s


class Connecting:
    """Sets the controller's state before each sample of a part of a run, if an event asks for it.

    Where it is not known yet when this part ends, :class:`InStep` is raised at the first sample at which the breaker
    may close. ``probes``: whether something else moves the controller's angle. Raises InfeasibleStudyError where the
    state cannot be set.
    """

    def __init__(self, study: Study, timeline: Timeline, *, probes: bool) -> None:
        c = study.converter
        self._timeline, self._T_s = timeline, c.T_s
        self._first, self._end, self._seeks = 0, -1, False
        event = next((one for one in study.events if one.synchronised_until is not None), None)
        if event is None or event.synchronised_until is None:
            return
        _check(timeline, probes)
        self._V_base_pk, self._circuit = rms_to_peak(c.V_rated_rms), study.circuit()
        self._seeks = math.isinf(event.synchronised_until)
        self._first = math.ceil(event.t_s / c.T_s - 1e-6)
        if self._seeks:
            self._end = self._first + round(LONGEST_S / c.T_s)
        else:
            self._end = math.ceil(event.synchronised_until / c.T_s - 1e-6)
        self._watch = GridWatch(0.0, 0.0, c.omega_n)
        self._ready = 0

    def cuts(self, samples: int) -> set[int]:
        """The samples before which the state is set, and the first one after them."""
        return set(range(self._first, min(self._end + 1, samples)))

    def set_to_grid(self, sample: int, state: ControllerState, gains: PowerLoopGains, x: Any) -> ControllerState:
        """The controller's state before a sample, with the circuit's states x."""
        if sample < self._first or sample > self._end or (sample == self._end and not self._seeks):
            return state
        v_g = self.grid_voltage(sample)
        now = (sample + 1e-6) * self._T_s
        refs = self._timeline.references_at(now)
        self._watch = GridWatch(*map(float, watch_grid(self._watch, v_g.real, v_g.imag, refs, self._T_s)))
        v = [float(capacitor_node_voltage(x[k], x[2 + k], x[4 + k], self._circuit)) for k in (0, 1)]
        measured = Measurement(v[0], v[1], 0.0, 0.0, 0.0, 0.0)
        fault = self._timeline.network_at(now).fault is not None
        self._ready = self._ready + 1 if in_step(measured, self._watch, refs) > 0.5 and not fault else 0
        if self._seeks and self._ready >= round(IN_STEP_S / self._T_s):
            # The last sample before which the state is set is the one before that in which the breaker closes.
            raise InStep((sample + 1) * self._T_s)
        if self._seeks and sample == self._end:
            raise InStep(None)
        return synchronised(state, self._watch, gains)

    def grid_voltage(self, sample: int) -> complex:
        """Space vector of the source at a sample, V peak: no current flows behind the breaker."""
        t_s = sample * self._T_s
        now = (sample + 1e-6) * self._T_s
        source = self._timeline.source_at(now).at(t_s)
        v = cmath.rect(rms_to_peak(source.V_g_rms), source.phase)
        for component in self._timeline.components_at(now):
            size = self._V_base_pk * component.amplitude_pu
            v += cmath.rect(size, component.order * source.phase + component.phase)
        return v


def _check(timeline: Timeline, probes: bool) -> None:
    if probes:
        raise InfeasibleStudyError(
            "synchronise: a converter that sets itself to the grid sends no probe. Give a controller without a field "
            "estimator, or leave synchronise out."
        )
    if timeline.wander is not None or timeline.replay is not None:
        raise InfeasibleStudyError(
            "synchronise: the voltage behind the breaker is not known beforehand with [background] or [replay]. "
            "Leave them out, or leave synchronise out."
        )
