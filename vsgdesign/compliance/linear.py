"""What the linear model of a converter says of a test: its network frequency perturbation at the test's grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.compliance.suite import SuiteTest
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.parameters.study import GridSource, Place, Study
from vsgdesign.simulation.steps import references_at
from vsgdesign.stability.impedance import network_frequency_perturbation

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]


def nfp_of(study: Study, test: SuiteTest, gains: PowerLoopGains | None) -> Callable[[Array], Complex | str]:
    """ΔP over Δω_g per unit (:eq:`nfp`) as a function of angular frequencies (F,), rad/s, at a test's first grid and
    operating point. The function gives a text where there is none: it says why.

    The model is linearised when the function is first called, and then kept.
    """

    @cache
    def model() -> FullOrderModel | str:
        if gains is None:
            return "the gains before the first event are not known"
        if test.load is not None:
            return "a load at the PCC is not in the linear model"
        c = study.converter
        grid = Place(test.scr, test.x_over_r, study.scr_basis).grid(c)
        source = GridSource(test.V_g_pu * c.V_rated_rms, c.omega_n + 2.0 * math.pi * test.df_hz)
        own = replace(study.undisturbed, grid=grid, grid_source=source, events=())
        P, Q = test.P_pu * c.S_rated, test.Q_pu * c.S_rated
        found = linearise_full_order(own, [Cell(grid, gains, *references_at(own, grid, gains, P, Q))])
        return found if found.faults[0] is None else f"no steady state before the test: {found.faults[0]}"

    def nfp(omega: Array) -> Complex | str:
        found = model()
        if isinstance(found, str):
            return found
        return network_frequency_perturbation(found, 0, omega, study.converter.S_rated, study.converter.omega_n)

    return nfp
