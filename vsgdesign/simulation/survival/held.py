"""The judgement of a rest at which the current limiter holds a converter and for which there is no other rest."""

from __future__ import annotations

import math

import numpy as np

from vsgdesign.metrics.survival import ExpectedRest
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.run import Simulation

LEAST_SHARE = 0.8
"""A converter at its limit must still carry this share of the power that is asked for, or of what the grid carries with
this current where that is less. It is this project's choice; a converter that has latched up carries about half."""

_LAST_S = 0.1
"""Means at the end of a run are over this time, s."""


def held_fault(study: Study, simulation: Simulation, asked: ExpectedRest) -> str | None:
    """Why a converter at rest at its current limit has latched up; None: it does what its current allows.

    ``asked`` is the rest without a limit. A power loop that still integrates while the limiter holds the current leaves
    the limits of the voltage, or the converter carries far less than it could. In a grid whose voltage is below its
    limits the current may be reactive, so that the power is not looked at. The largest power is V_g·I − R·I² at the
    limit if the converter takes it, and about V_g·I if it sends it, at unity power factor.
    """
    c, timeline, end_s = study.converter, simulation.timeline, study.simulation.duration
    limit_pu = c.current_limit_pu
    if limit_pu is None:
        return None
    rows = max(round(_LAST_S / study.simulation.log_interval), 1)
    V_pu, P_pu = (
        float(np.mean(simulation.column(name)[-rows:])) / base
        for name, base in (("V_rms", c.V_rated_rms), ("P", c.S_rated))
    )
    if not c.V_min_pu <= V_pu <= c.V_max_pu:
        return (
            f"held by its limiter with a voltage reference of {V_pu:.3g} pu, outside of {c.V_min_pu:g} to "
            f"{c.V_max_pu:g} pu"
        )
    source, network = timeline.source_at(end_s), timeline.network_at(end_s)
    V_g = source.V_g_rms / c.V_rated_rms
    if network.load is not None or not network.connected or V_g < c.V_min_pu:
        return None
    asked_pu = asked.P / c.S_rated
    if asked.obstacle is not None:  # then the droops ask for what was set, if the frequency is nominal
        if not math.isclose(source.omega, c.omega_n, rel_tol=1e-9):
            return None
        asked_pu = timeline.references_at(end_s).P_ref / c.S_rated
    most = V_g * limit_pu
    if asked_pu < 0.0:
        R = study.path_to_grid(timeline.grid_at(end_s), c.omega_n)[0] / c.Z_base
        i = min(limit_pu, V_g / (2.0 * R)) if R > 0.0 else limit_pu
        most = V_g * i - R * i * i
    needed = LEAST_SHARE * min(abs(asked_pu), most)
    if P_pu * math.copysign(1.0, asked_pu) >= needed:
        return None
    return (
        f"held by its limiter at P = {P_pu:.3g} pu: {asked_pu:.3g} pu is asked for, and the grid carries {most:.3g} pu "
        f"with this current; at least {LEAST_SHARE:g} of the smaller one is asked of a converter at its limit"
    )
