"""Where the dc link rests while the converter does, and how fast it moves with the circuit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.dc_source_interface import Decay
from vsgdesign.equations.frames import SPACE_VECTOR_POWER, clarke
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.plant import state_matrices
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

MOST_RADIANS = 4.5
"""By how much filter and link may move in a sampling period: their series then has 26 terms."""

ROOM = 1.5
"""By how much faster than on the study's own grid they may be on another one."""

LEAST_TERM = 1e-10
"""The first term of the series that is left out, over what it moves. The voltage of the link moves by some thousandths
in a period, so that 1e-12 of it is left."""


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


def series_of(study: Study, least: float = 0.0) -> tuple[int, float]:
    """The order of the series for a study with a dc link, and by how much filter and grid current may move in a
    sampling period for it, rad, which is no less than ``least``. Raises InfeasibleStudyError where the link follows its
    source too fast."""
    c, f, link = study.converter, study.filter, study.dc
    if link is None:
        raise ValueError("the dc link is ideal.")
    settings = link.settings(c, f)
    rate = max(settings.bleed * settings.over_C, *_decay_rates(settings.source), 0.0)
    largest = math.hypot(*clarke(0.5, -0.5, -0.5))  # of a switching vector
    rates = np.zeros((4, 4))
    rates[:3, :3], into_filter, _ = state_matrices(study.circuit())
    rates[:3, 3], rates[3, 0], rates[3, 3] = largest * into_filter, -SPACE_VECTOR_POWER * largest / link.C, -rate
    turns = ROOM * float(np.abs(np.linalg.eigvals(rates)).max()) * c.T_s
    if turns > MOST_RADIANS:
        raise InfeasibleStudyError(
            f"dc: filter and link move by {turns / ROOM:.3g} rad in a sampling period of {c.T_s:.4g} s (the link "
            f"follows its source at {rate:.4g} 1/s), and at most {MOST_RADIANS / ROOM:.3g} rad can be computed with a "
            'switched bridge or with compensation = "none". Give a larger C or R_i, or sample faster.'
        )
    turns = max(turns, least)
    return next(n for n in range(4, 60) if turns ** (n + 1) / math.factorial(n + 1) < LEAST_TERM), turns


def _decay_rates(record: Any) -> Iterator[float]:
    """The rates of all decays among a source's constants, 1/s."""
    if isinstance(record, Decay):
        yield float(record.rate)
    elif isinstance(record, tuple):
        for one in record:
            yield from _decay_rates(one)
