"""Energies of a run with a battery on its dc link, from an integration of every sample of its own.

Each sample begins with the states that the run has there; the pieces between the edges of the bridge are moved by the
tableau of DOP853, all samples at once, together with the energies that flow. Nothing of ``vsgdesign.equations`` is
used, and nothing is summed up that the run has summed up.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from vsgdesign.simulation import Simulation
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.study.parameters import Study

Complex = NDArray[np.complex128]
Array = NDArray[np.float64]

_AT_ONCE = 50_000


class Energies(NamedTuple):
    """J, from the first row of the log to the last one."""

    source: float
    """What the source has given by this integration …"""
    given: float
    """… and what the run says of it."""
    grid: float
    lost: float
    """In all resistances."""
    stored: float
    """By how much the energy of capacitors and inductors has grown."""


def energies(study: Study, run: Simulation, states: Array, *, pwm: bool) -> Energies:
    """``states``: the voltage that the controller asked for one sample before, (n, 2), in every row of the log."""
    c, f, grid, dc = study.converter, study.filter, study.grid, study.dc
    assert dc is not None
    assert run.dc_log is not None
    names, T = dc_columns(study), c.T_s
    x, v_g = run.log[:, 0:6:2] + 1j * run.log[:, 1:6:2], run.log[:, 6] + 1j * run.log[:, 7]
    v, charge, given = (run.dc_log[:, names.index(name)] for name in ("v", "memory.charge", "given"))
    asked, measured = states[:, 0] + 1j * states[:, 1], dc.compensation == "measured"
    L, R = f.L_2 + grid.L_g, f.R_2 + grid.R_g
    points, R_i, As = np.array(dc.values["open_circuit"]), dc.values["R_i"], 3600.0 * dc.values["capacity_Ah"]
    bleed = 0.0 if dc.R_bleed is None else 1.0 / dc.R_bleed

    def slopes(t: Array | float, y: Complex, s: Complex, held: Complex | None, at_begin: Complex) -> Complex:
        i, v_c, i_g, link, q = y[0], y[1], y[2], y[3].real, y[4].real
        v_b = s * link if held is None else held
        node, source = v_c + f.R_c * (i - i_g), at_begin * np.exp(1j * c.omega_n * t)
        k = np.clip((5.0 * q).astype(int), 0, 4)
        current = (points[k] + (points[k + 1] - points[k]) * (5.0 * q - k) - link) / R_i
        taken = 1.5 * (v_b * i.conj()).real
        lost = 1.5 * (f.R_1 * np.abs(i) ** 2 + f.R_c * np.abs(i - i_g) ** 2 + R * np.abs(i_g) ** 2) + bleed * link**2
        rates = [(v_b - f.R_1 * i - node) / f.L_1, (i - i_g) / f.C, (node - R * i_g - source) / L]
        rates += [(current - bleed * link - taken / link) / dc.C, -current / As]
        return np.array([*rates, link * current, 1.5 * (source * i_g.conj()).real, lost], dtype=complex)

    def moved(y: Complex, begin: Array | float, h: Array | float, *of: Complex | None) -> Complex:
        stages: list[Complex] = []
        for k in range(12):
            ahead = sum((DOP853.A[k, j] * stages[j] for j in range(k)), start=0.0 * y)
            stages.append(slopes(begin + DOP853.C[k] * h, y + h * ahead, *of))  # type: ignore[arg-type]
        return y + h * sum(weight * stage for weight, stage in zip(DOP853.B, stages, strict=True))

    def stored(k: int) -> float:
        coils = f.L_1 * abs(x[k, 0]) ** 2 + f.C * abs(x[k, 1]) ** 2 + L * abs(x[k, 2]) ** 2
        return float(0.75 * coils + 0.5 * dc.C * v[k] ** 2)

    total = np.zeros(3)
    for begin in range(0, len(x) - 1, _AT_ONCE):
        part = slice(begin, min(begin + _AT_ONCE, len(x) - 1))
        y = np.zeros((8, part.stop - begin), complex)
        y[:3], y[3], y[4] = x[part].T, v[part], charge[part]
        divides_by = v[part] if measured else c.V_dc
        if not pwm:
            held = asked[part] if measured else None
            y = moved(y, 0.0, T, asked[part] / divides_by, held, v_g[part])
        for start, h, s in _pieces(asked[part] / divides_by, np.arange(begin, part.stop)) if pwm else ():
            y = moved(y, start * T, h * T, s, None, v_g[part])
        total += np.real(y[5:]).sum(axis=1)
    return Energies(total[0], float(given[-1] - given[0]), total[1], total[2], stored(-1) - stored(0))


def _pieces(duty: Complex, sample: NDArray[np.int64]) -> Iterator[tuple[Array, Array, Complex]]:
    """Beginning, length (of a sample, 0 to 1) and switching vector of the four pieces of each sample, of a bridge with
    min-max modulation and two samples in a period of the carrier."""
    turns = np.exp(2j * np.pi * np.arange(3) / 3.0)
    phases = (duty[:, None] * turns.conj()).real
    m = 2.0 * (phases - 0.5 * (phases.max(axis=1) + phases.min(axis=1))[:, None])
    rising = (sample % 2 == 0)[:, None]
    places, first = np.where(rising, 0.5 * (m + 1.0), 0.5 * (1.0 - m)), np.where(rising, 0.5, -0.5)
    order = np.argsort(places, axis=1)
    ends = np.column_stack([np.take_along_axis(places, order, axis=1), np.ones(len(duty))])
    s = (2.0 / 3.0) * (first * turns).sum(axis=1)
    begin = np.zeros(len(duty))
    for k in range(4):
        yield begin, ends[:, k] - begin, s
        if k < 3:
            s = s - (4.0 / 3.0) * first[:, 0] * turns[order[:, k]]
        begin = ends[:, k]
