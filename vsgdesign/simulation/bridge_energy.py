"""The energy that a lossless bridge takes from its dc link in a sample, from the states of its filter at both ends."""

from __future__ import annotations

from typing import Any, NamedTuple

from vsgdesign.equations.frames import SPACE_VECTOR_POWER
from vsgdesign.simulation.circuit_sample import PlantState
from vsgdesign.study.parameters.study import Study


class BridgeFilter(NamedTuple):
    """What the energy of the dc link depends on, in SI, and the sampling period, s."""

    R_1: Any
    L_1: Any
    R_c: Any
    C: Any
    T_s: Any


def bridge_filter_of(study: Study) -> BridgeFilter:
    """That of a study."""
    f = study.filter
    return BridgeFilter(f.R_1, f.L_1, f.R_c, f.C, study.converter.T_s)


class EnergyOfAxis(NamedTuple):
    """What one axis says of the energy of a sample: by how much the current of L_1 changes and its mean (A), and the
    integrals of the voltage behind L_1 (Vs) and of the current (As)."""

    step_i: Any
    middle: Any
    flux: Any
    charge: Any


def averaged_energy(before: PlantState, x: PlantState, of: BridgeFilter) -> Any:
    """The energy in J that an averaged bridge takes in a sample from the state ``before`` it to ``x``
    (:eq:`dc-energy`)."""
    alpha = _of_axis(before.i_s_alpha, before.v_c_alpha, before.i_g_alpha, x.i_s_alpha, x.v_c_alpha, x.i_g_alpha, of)
    beta = _of_axis(before.i_s_beta, before.v_c_beta, before.i_g_beta, x.i_s_beta, x.v_c_beta, x.i_g_beta, of)
    return energy_of(alpha, beta, of)


def _of_axis(i_s: Any, v_c: Any, i_g: Any, i_s_after: Any, v_c_after: Any, i_g_after: Any, of: BridgeFilter) -> Any:
    step_i, step_v, step_c = i_s_after - i_s, v_c_after - v_c, (i_s_after - i_g_after) - (i_s - i_g)
    # v_b − R_1 i_s − v says the slope of the current, in whose difference between both ends v_b is not contained.
    curved = (of.R_1 * step_i + (step_c * of.R_c + step_v)) * (of.T_s * of.T_s / 12.0) * (1.0 / of.L_1)
    charge = (i_s_after + i_s) * (0.5 * of.T_s) + curved
    flux = flux_of(v_c, v_c_after, step_v, step_c, of) + of.R_1 * charge
    return EnergyOfAxis(step_i, charge * (1.0 / of.T_s), flux, charge)


def flux_of(v_c: Any, v_c_after: Any, step_v: Any, step_c: Any, of: BridgeFilter) -> Any:
    """Integral of the node's voltage over a sample, Vs. What flows into the capacitor says the slope of its voltage."""
    curved = of.T_s * of.T_s / 12.0 * step_c * (1.0 / of.C)
    return (v_c_after + v_c) * (0.5 * of.T_s) - curved + of.R_c * of.C * step_v


def energy_of(alpha: EnergyOfAxis, beta: EnergyOfAxis, of: BridgeFilter) -> Any:
    """The energy in J of a sample from what both axes say of it: what L_1 takes, and the rest."""
    inductor = SPACE_VECTOR_POWER * (alpha.step_i * alpha.middle + beta.step_i * beta.middle) * of.L_1
    i_alpha, i_beta = alpha.charge * (1.0 / of.T_s), beta.charge * (1.0 / of.T_s)
    return inductor + SPACE_VECTOR_POWER * (alpha.flux * i_alpha + beta.flux * i_beta)
