"""Which converter a result is about: its base values, bridge, filter and limits, in JSON's types."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.frames import phase_to_ll
from vsgdesign.parameters.event import BASIS
from vsgdesign.parameters.study import Study


def identity_of(study: Study) -> dict[str, Any]:
    """Numbers in SI, with their units in the names. ``limits``: current limit and limiter of every controller.

    ``scr_basis`` is that of the tests, which a study need not share: its own is ``scr_basis_of_study``.
    """
    c, f = study.converter, study.filter
    limited = {spec.name: study.with_limit_of(spec) for spec in study.controllers}
    return {
        "S_rated_va": c.S_rated,
        "V_rated_ll_rms_v": phase_to_ll(c.V_rated_rms),
        "f_n_hz": c.omega_n / (2.0 * math.pi),
        "Z_base_ohm": c.Z_base,
        "I_rated_pk_a": c.I_rated_pk,
        "V_dc_v": c.V_dc,
        "f_sw_hz": c.f_sw,
        "T_s_s": c.T_s,
        "delay_samples": c.delay_samples,
        "bridge": study.simulation.bridge,
        "filter": {"L_1_h": f.L_1, "R_1_ohm": f.R_1, "C_f": f.C, "R_c_ohm": f.R_c, "L_2_h": f.L_2, "R_2_ohm": f.R_2},
        "scr_basis": BASIS,
        "scr_basis_of_study": study.scr_basis,
        "limits": [
            {"controller": name, "current_limit_pu": own.converter.current_limit_pu, "limiter": own.current_limiter}
            for name, own in limited.items()
        ],
    }
