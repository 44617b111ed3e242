"""The circuit of a study with its events, sample by sample: for a controller that is outside of this process or in C.

The compiled loop of :func:`vsgdesign.simulation.run.simulate` has the controller in it. Here the caller gives the
bridge voltage of every sampling period. The steps are the same exact ones (:eq:`exact-step`, :eq:`source-ramp`).
"""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.dc_link import ActingVoltage, FilterSide, acting_voltage, dc_step
from vsgdesign.equations.dc_source_interface import SourceLimits
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.linear.operating_point.plant import PlantStep, plant_step, two_axes
from vsgdesign.simulation.added_source import on_sample
from vsgdesign.simulation.circuit_program import SAME_INSTANT
from vsgdesign.simulation.circuits import Circuits, Connection, connection_at, start_of
from vsgdesign.simulation.dc_start import dc_at_start
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


class PlantAlone:
    """Filter, grid, load, source and dc link of a study with an averaged bridge, without a controller.

    The source is the fundamental that the events say: background, record and harmonics are left out, and sensors are
    ideal. Breakers and faults change at the instants that the events give.
    """

    def __init__(self, study: Study, gains: PowerLoopGains) -> None:
        """At rest with these gains, or without energy, as the study says. Raises InfeasibleStudyError where the study
        has no rest at t = 0, or a dc link that the modulation does not compensate."""
        quiet = self._study = study.undisturbed
        self.T_s, self.sample, self._R_c = study.converter.T_s, 0, study.filter.R_c
        self.timeline = build_timeline(quiet)
        self._circuits = Circuits(quiet, [self.timeline], switched=False)
        start = start_of(quiet, self.timeline, self._circuits, gains)
        self.x = start.plant
        """States of the circuit, each as (α, β), SI, peak."""
        self._dc = None if study.dc is None else dc_at_start(study, start.plant, self.timeline.source_at(0.0).omega)
        self._law = None if study.dc is None else study.dc.kind.law
        self.pending = complex(*start.pending)
        """Bridge voltage that is on its way at the start, V peak, as α + jβ."""
        changes = self.timeline.plant_changes()
        self._sources = {math.ceil(event.t_s / self.T_s - SAME_INSTANT): event for event in quiet.events if event.of_dc}
        self._inside: dict[int, list[float]] = {}
        for t_s in changes:
            if on_sample(t_s, self.T_s) is None:
                self._inside.setdefault(int(t_s / self.T_s), []).append(t_s)
        self._steps = functools.lru_cache(maxsize=64)(self._step)
        self._change_source()

    @property
    def t_s(self) -> float:
        """The present instant, s."""
        return self.sample * self.T_s

    @property
    def measured(self) -> tuple[complex, complex, complex]:
        """Voltage of the capacitor node, current of the bridge and of the grid now, as α + jβ, V and A peak."""
        i_s, v_c, i_g = (complex(*self.x[k : k + 2]) for k in (0, 2, 4))
        return v_c + self._R_c * (i_s - i_g), i_s, i_g

    @property
    def v_dc(self) -> float:
        """Voltage of the dc link now, V. Raises ValueError where it is ideal."""
        if self._dc is None:
            raise ValueError("the dc link is ideal.")
        return float(self._dc.dc.v)

    @property
    def source_limits(self) -> SourceLimits:
        """What the source of the dc link can give now, W. Raises ValueError where the link is ideal."""
        if self._dc is None or self._law is None:
            raise ValueError("the dc link is ideal.")
        found: SourceLimits = self._law.can_give(self._dc.dc.memory, self._dc.clamp_of.hold, self._dc.link.source)
        return found

    @property
    def source(self) -> complex:
        """Voltage of the source now, V peak, as α + jβ."""
        at = self.timeline.source_at(self._from(self.t_s)).at(self.t_s)
        return complex(rms_to_peak(at.V_g_rms) * np.exp(1j * at.phase))

    @property
    def closed(self) -> bool:
        """Whether the breaker to the grid is closed now."""
        return self.timeline.network_at(self._from(self.t_s)).connected

    @property
    def references(self) -> References:
        """Set points now."""
        return self.timeline.references_at(self._from(self.t_s))

    @property
    def known_grid(self) -> Grid:
        """The grid half a sample ago: a change at this sample is not known yet. NaN where there is none to be known."""
        return self.timeline.true_grid_at(max(self.t_s - 0.5 * self.T_s, 0.0))

    def advance(self, v_b: complex) -> None:
        """One sampling period with a bridge voltage, V peak, as α + jβ. A dc link that has not the voltage for it makes
        what it can."""
        asked, before = ActingVoltage(v_b.real, v_b.imag), self.x
        acts = asked if self._dc is None else acting_voltage(asked, self._dc.dc.v, self._dc.link.limit)
        bridge = np.array(acts)
        instants = [self.t_s, *self._inside.get(self.sample, []), (self.sample + 1) * self.T_s]
        for begin, end in itertools.pairwise(instants):
            h = self.T_s if len(instants) == 2 else end - begin
            source = self.timeline.source_at(self._from(begin)).at(begin)
            step = self._steps(connection_at(self.timeline, self._from(begin)), h, source.omega)
            turn = np.exp(1j * source.phase)
            V, slope = rms_to_peak(source.V_g_rms), rms_to_peak(source.V_slope)
            x = step.transition @ self.x + step.bridge @ bridge
            for response, size in zip(step.source, (V, slope, 0.5j * V * source.omega_slope), strict=True):
                if size:
                    c = size * turn
                    x += response @ np.array([c.real, c.imag])
            self.x = x
        if self._dc is not None and self._law is not None:
            x, after = (FilterSide(*map(float, ends[:6])) for ends in (before, self.x))
            link = self._dc.link
            self._dc = self._dc._replace(dc=dc_step(self._dc.dc, x, after, acts, asked, link, self._law))
        self.sample += 1
        self._change_source()

    def _change_source(self) -> None:
        """What events of this sample leave of the source of the dc link."""
        event = self._sources.get(self.sample)
        link = None if event is None else self.timeline.link_at(event.t_s)
        if event is None or link is None or self._dc is None:
            return
        settings = link.settings(self._study.converter, self._study.filter)
        dc, again = self._dc.dc, link.recharged(settings) if "dc_charge" in event.of_dc else {}
        self._dc = self._dc._replace(link=settings, dc=dc._replace(memory=dc.memory._replace(**again)))

    def _from(self, t_s: float) -> float:
        """An instant behind a change that lies beside it."""
        return t_s + SAME_INSTANT * self.T_s

    def _step(self, connection: Connection, h: float, omega: float) -> PlantStep:
        return plant_step(two_axes(self._circuits.of(connection)), h, omega, edges=False)
