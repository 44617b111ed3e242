"""How a probe is sent: a small voltage beside the one that the power loops ask for."""

from __future__ import annotations

from typing import Any

import numpy as np


def probe_offset(u_d: Any, u_q: Any, V_rms: Any, V_rated_rms: Any) -> tuple[Any, Any]:
    """What a probe adds to V (rms V) and to θ (rad) (:eq:`probe`): V' e^{jθ'} = (V + V_n u) e^{jθ}.

    u_d and u_q are relative to the rated voltage, in the converter's frame. After the controller's sample the same is
    taken off θ and V again, so that the power loops go on as if nothing had been added. Returns (added_V, added_theta).
    """
    whole_d = V_rms + V_rated_rms * u_d
    whole_q = V_rated_rms * u_q
    return np.sqrt(whole_d * whole_d + whole_q * whole_q) - V_rms, np.arctan2(whole_q, whole_d)
