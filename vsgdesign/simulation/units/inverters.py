"""What a run of a plant shows of its inverters: their series, and their powers at each rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import instantaneous_power, peak_to_rms
from vsgdesign.linear.operating_point.rest_of_units import UnitsAtRest
from vsgdesign.simulation.scenario.controllers import AT_PCC, put_vectors
from vsgdesign.simulation.units.run import InverterRun

Array = NDArray[np.float64]


@dataclass(frozen=True)
class InverterRest:
    """An inverter where a plant rests: its powers (W, var) and its voltage (phase rms V) at its terminals, and the
    share of its rated current that it gives."""

    name: str
    P_pcc: float
    Q_pcc: float
    V_rms: float
    I_pu: float


def terminals_at_rest(rest: UnitsAtRest, converter: int) -> tuple[complex, complex]:
    """Voltage and current at the terminals of a converter, behind L_2, peak."""
    model = rest.model
    y, v_g = model.states(rest.z), model.situation.phasors
    per_state, per_source = model.network.terminals
    return complex(per_state[converter] @ y + per_source[converter] @ v_g), complex(y[3 * converter + 2])


def inverters_at_rest(rest: UnitsAtRest) -> tuple[InverterRest, ...]:
    """All inverters that are connected."""
    found = []
    for k, one in enumerate(rest.model.situation.inverters, len(rest.model.situation.units)):
        v, i = terminals_at_rest(rest, k)
        P, Q = instantaneous_power(v.real, v.imag, i.real, i.imag)
        own = one.inverter
        amps = float(peak_to_rms(abs(i))) * 3.0 * own.V_rated_rms / own.S_rated
        found.append(InverterRest(own.name, float(P), float(Q), float(peak_to_rms(abs(v))), amps))
    return tuple(found)


def inverter_series(run: InverterRun, t_s: Array, phase: Array, every: int) -> dict[str, Array]:
    """Phases and powers at its terminals, its frequency, the voltage that it takes for its capacitor's, and its angle
    to the grid's source, of every n-th row."""
    rows = slice(None, None, every)
    v, i = run.terminals[rows], run.log[rows, 4:6]
    series = {"t_s": t_s[rows]} | {name: np.empty(len(v)) for name in AT_PCC}
    put_vectors([series[name] for name in AT_PCC], v.T, i.T)
    delta = np.mod(run.column("theta")[rows] - phase[rows] + math.pi, 2.0 * math.pi) - math.pi
    return series | {"omega": run.column("omega")[rows], "V_rms": run.column("V_rms")[rows], "delta": delta}
