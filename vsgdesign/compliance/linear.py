"""What the linear model of a converter says of a test: its network frequency perturbation at the test's grid."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.parameters.source import GridSource
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.stability.loops import network_frequency_perturbation

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]


def nfp_of(study: Study, gains: PowerLoopGains | None) -> Callable[[Array], Complex | str]:
    """ΔP over Δω_g per unit (:eq:`nfp`) as a function of angular frequencies (F,), rad/s, at the first grid and
    references of a test's own study. The function gives a text where there is none: it says why.

    The model is linearised when the function is first called, and then kept.
    """

    @cache
    def model() -> FullOrderModel | str:
        if gains is None:
            return "the gains before the first event are not known"
        if not study.network.plain:
            return "a load at the PCC is not in the linear model"
        start = build_timeline(study)
        source = start.source_at(0.0)
        cell = Cell.with_references(
            start.grid_at(0.0), gains, start.references_at(0.0), GridSource(source.V_g_rms, source.omega)
        )
        found = linearise_full_order(study.undisturbed, [cell])
        return found if found.faults[0] is None else f"no steady state before the test: {found.faults[0]}"

    def nfp(omega: Array) -> Complex | str:
        found = model()
        if isinstance(found, str):
            return found
        return network_frequency_perturbation(found, 0, omega, study.converter.S_rated, study.converter.omega_n)

    return nfp
