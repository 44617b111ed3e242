"""An exported controller in closed loop with the circuit of its study, in whatever form it comes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import clarke, clarke_inverse, rated_current_rms, rms_to_peak
from vsgdesign.export.unit import Unit
from vsgdesign.export.unit_content import lists_of
from vsgdesign.simulation.plant_alone import PlantAlone

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
