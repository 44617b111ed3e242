"""A converter's filter on a grid with a breaker, stepped from sample to sample: what the exported C is connected to."""

from __future__ import annotations

import numpy as np

from vsgdesign.equations.controller import Measurement
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.linear.operating_point.plant import plant_step
from vsgdesign.study.parameters import Grid, Study

OPEN = 1e6
"""H: the grid behind an open breaker."""


class LiveGrid:
    """A grid of 1.04 pu, half a hertz off, with 2 % of fifth harmonic and 1 % of negative sequence; averaged bridge."""

    def __init__(self, study: Study) -> None:
        c = self.converter = study.converter
        self.study, self.settings = study, study.controller_settings()
        self.I_pk = c.I_rated_pk
        self.omega, V = c.omega_n + 2.0 * np.pi * 0.5, rms_to_peak(c.V_rated_rms)
        self.parts = [(self.omega, 1.04 * V * np.exp(1.0j)), (-self.omega, 0.01 * V), (-5.0 * self.omega, 0.02 * V)]
        self.x, self.pending, self.t_s = np.zeros(3, complex), 0.0j, 0.0
        self.connect(None)

    def connect(self, grid: Grid | None) -> None:
        """To a grid, or with None to an open breaker."""
        circuit = self.study.circuit(grid)
        circuit = FilterGrid(*circuit[:-1], L_g=OPEN) if grid is None else circuit
        self._steps = [plant_step(circuit, self.settings.T_s, omega, edges=False) for omega, _ in self.parts]

    @property
    def v_g(self) -> complex:
        """The grid's voltage now, V peak."""
        return complex(sum(part * np.exp(1j * omega * self.t_s) for omega, part in self.parts))

    @property
    def measured(self) -> Measurement:
        """What the sensors say now."""
        i_s, v_c, i_g = self.x
        v = v_c + self.study.filter.R_c * (i_s - i_g)
        return Measurement(v.real, v.imag, i_s.real, i_s.imag, i_g.real, i_g.imag)

    @property
    def currents(self) -> np.ndarray:
        """|i_s| and |i_g| over rated."""
        return np.abs(self.x[[0, 2]]) / self.I_pk

    def step(self, v_b: complex) -> None:
        """One sample with the bridge voltage that was computed in it."""
        now = self.pending if self.converter.delay_samples else v_b
        self.pending = v_b
        x = self._steps[0].transition @ self.x + self._steps[0].bridge * now
        for step, (omega, part) in zip(self._steps, self.parts, strict=True):
            x = x + step.source[0] * (part * np.exp(1j * omega * self.t_s))
        self.x, self.t_s = x, self.t_s + self.settings.T_s
