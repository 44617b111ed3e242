"""Where the dc link rests while the converter does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import SPACE_VECTOR_POWER
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


def bridge_power(study: Study, v: Any, i_s: Any) -> Any:
    """The power that the bridge takes at rest, W: that of the capacitor node and of the losses before it.

    ``v``, ``i_s``: voltage at the capacitor node and converter current, complex, peak; numbers or arrays. With a
    voltage that is held over a sampling period it is the mean over one, up to (ωT_s)²/24 of what oscillates."""
    return SPACE_VECTOR_POWER * ((v * np.conj(i_s)).real + study.filter.R_1 * np.abs(i_s) ** 2)


def power_of_plant(study: Study, plant: Array) -> Any:
    """The same from the circuit's states at rest: i_s, v_c and i_g as (α, β), peak; (6,) or (6, N)."""
    i_s, v_c, i_g = (plant[k] + 1j * plant[k + 1] for k in (0, 2, 4))
    return bridge_power(study, v_c + study.filter.R_c * (i_s - i_g), i_s)


def links_at_rest(study: Study, links: Sequence[DcLink], p: Array) -> Array:
    """(N,): voltages of N dc links while their bridges take these powers (W), V; NaN where the source cannot give them,
    and where the power is NaN."""
    found = np.full(len(p), np.nan)
    for k in np.flatnonzero(np.isfinite(p)).tolist():
        try:
            found[k] = links[k].at_rest(float(p[k]), study.converter, study.filter).v
        except InfeasibleStudyError:
            continue
    return found
