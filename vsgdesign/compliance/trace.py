"""What a test keeps of its run, per unit of the converter: the input of every measure, figure and file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Signals of one run, equally spaced arrays (n,). Time zero is the beginning of the test."""

    t_s: Array
    P_pu: Array
    """At the capacitor, as the controller measures it, over the rating; unfiltered."""
    Q_pu: Array
    f_hz: Array
    """Frequency of the converter's frame, Hz."""
    V_pu: Array
    """The converter's voltage reference, phase rms over the nominal one."""
    delta_rad: Array
    """Angle of the converter's frame against the grid source, rad, unwrapped."""
    i_s_pu: Array
    """Length of the converter current's vector over the rated peak."""
    i_phase_pu: Array
    """Largest magnitude of the three phases of i_s over the rated peak."""
    v_alpha_pu: Array
    v_beta_pu: Array
    """Capacitor node, over the rated phase peak."""
    i_g_alpha_pu: Array
    i_g_beta_pu: Array
    """Current into the PCC, over the rated peak."""
    P_dc_pu: Array
    """Power that the dc link gives to the bridge, over the rating, mean over each row's interval."""
    limited: Array
    """Share of the samples since the row before in which the limiter acted."""
