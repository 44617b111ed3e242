"""Energy and power that the dc link gives to the bridge, from the log of a run with a row for every sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.between_rows import EnergyOfAxis, averaged_energy, bridge_filter_of, energy_of, flux_of
from vsgdesign.simulation.circuit_sample import PlantState
from vsgdesign.simulation.run import Simulation
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


def dc_energy(simulation: Simulation, study: Study, *, bridge: str | None = None) -> Array:
    """Energy in J that a lossless bridge has taken from the dc link up to each row of the log, (n,). It begins at zero.

    The energy follows from the filter alone, so that it is valid on every grid, with a load and with a fault
    (:eq:`dc-energy`). With an averaged bridge the relative error of a part that oscillates with ω is (ωT_s)⁴/720.
    ``bridge`` replaces that of the study. With a switched bridge the losses of the ripple in R_1 and R_c are left out.
    Raises InfeasibleStudyError if the log does not have every sample.
    """
    return np.concatenate([[0.0], np.cumsum(dc_energy_steps(simulation.log.T, study, bridge=bridge))])


def dc_energy_steps(log: Array, study: Study, *, bridge: str | None = None) -> Array:
    """The energy in J that is taken in each sample, (n − 1,), from the columns of a log, (6 or more, n), in the order
    of LOG_COLUMNS. As :func:`dc_energy`."""
    T_s, f = study.converter.T_s, study.filter
    if round(study.simulation.log_interval / T_s) != 1:
        raise InfeasibleStudyError(
            f"log_interval = {study.simulation.log_interval:.6g} s: the energy of the dc link needs every sample. "
            f"Use log_interval = {T_s:.9g}."
        )
    i_s, v_c, i_g = (np.ascontiguousarray(log[at : at + 2]) for at in (0, 2, 4))  # α and β
    of = bridge_filter_of(study)
    if (study.simulation.bridge if bridge is None else bridge) != "pwm":
        before, after = (PlantState(*(one[part] for one in log[:6])) for part in (slice(-1), slice(1, None)))
        energy: Array = averaged_energy(before, after, of)
        return energy
    # The current swings between its samples, and what the capacitor and the grid get of it does not.
    step_i, step_v = np.diff(i_s), np.diff(v_c)
    charge = f.C * step_v + T_s * _means(i_g)
    flux = flux_of(v_c[:, :-1], v_c[:, 1:], step_v, np.diff(i_s - i_g), of) + f.R_1 * charge
    middle = 0.5 * (i_s[:, 1:] + i_s[:, :-1])
    alpha, beta = (EnergyOfAxis(step_i[k], middle[k], flux[k], charge[k]) for k in (0, 1))
    return energy_of(alpha, beta, of)


def dc_power(simulation: Simulation, study: Study, *, bridge: str | None = None) -> Array:
    """Power in W that the dc link gives to the bridge, (n,): the mean over the sample that ends at each row of the log.
    The first row, at which none ends, repeats the second. As :func:`dc_energy`."""
    energy = dc_energy(simulation, study, bridge=bridge)
    power = np.diff(energy, prepend=0.0) / study.converter.T_s
    power[:1] = power[1:2]
    return power


def _means(x: Array) -> Array:
    """Mean between every two samples, of the cubic through these and their neighbours."""
    if x.shape[1] < 4:
        return 0.5 * (x[:, 1:] + x[:, :-1])
    before, after = 3.0 * (x[:, :1] - x[:, 1:2]) + x[:, 2:3], 3.0 * (x[:, -1:] - x[:, -2:-1]) + x[:, -3:-2]
    more = np.concatenate([before, x, after], axis=1)
    return (13.0 * (more[:, 1:-2] + more[:, 2:-1]) - more[:, :-3] - more[:, 3:]) * (1.0 / 24.0)
