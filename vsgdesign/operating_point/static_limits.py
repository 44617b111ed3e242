"""Static limits of a converter and its grid: how much of each limit an operating point uses."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import POWER_MARGIN
from vsgdesign.frames import rated_current_rms, rms_to_peak
from vsgdesign.parameters.study import Study

Array = NDArray[np.float64]

_SAMPLED_SHARE = 0.995
"""Of the bridge's voltage limit and of the current: the rest is for the sampled bridge, which makes its fundamental in
steps."""


def static_limit_uses(study: Study, R: Any, X: Any, omega_g: Any, P: Any, Q: Any, V_rms: Any) -> dict[str, Array]:
    """The share of each static limit that operating points use, (N,) each; 1 is on the limit (:eq:`static-limits`).

    R and X in Ω lead from the control point to the source at omega_g (rad/s). P (W), Q (var) and V (phase rms, V) are
    those at the control point. A share is NaN where one of them is.
    """
    c = study.converter
    low, high = c.V_limits_rms
    apparent = np.hypot(P, Q)
    V_pu = V_rms / c.V_rated_rms
    carried = c.S_rated * V_pu * V_pu * c.Z_base / np.hypot(R, X)
    with np.errstate(invalid="ignore"):
        current = converter_current_rms(study, omega_g, P, Q, V_rms)
        bridge = V_rms + (study.filter.R_1 + 1j * omega_g * study.filter.L_1) * current
        return {
            "power transfer": POWER_MARGIN * apparent / carried,
            "least voltage": low / V_rms,
            "largest voltage": V_rms / high,
            "current": rms_to_peak(np.abs(current)) / (_SAMPLED_SHARE * acting_current_pk(study)),
            "bridge voltage": rms_to_peak(np.abs(bridge)) / (_SAMPLED_SHARE * c.v_max_pk),
        }


def acting_current_pk(study: Study) -> float:
    """The converter current from which on the study's limiter acts, A peak: its soft limit, where it has one.

    No steady state may lie above it. Infinite without a current limit.
    """
    if study.converter.current_limit_pu is None:
        return np.inf
    settings = study.controller_settings()
    return float(min(settings.i_max_pk, getattr(settings.limiter, "i_soft_pk", np.inf)))


def converter_current_rms(study: Study, omega_g: Any, P: Any, Q: Any, V_rms: Any) -> Any:
    """The current through L_1 as a phasor against the voltage at the control point, A rms: that into the grid and
    that of the capacitor."""
    f = study.filter
    shunt = 1j * omega_g * f.C / (1.0 + 1j * omega_g * f.C * f.R_c)
    return rated_current_rms(P - 1j * Q, V_rms) + shunt * V_rms
