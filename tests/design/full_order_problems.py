"""Studies whose full-order loop the tests prove, each with its problem, built once a process."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import GainTable, ValidityBox, base_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.certificate import region_of
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.search import Problem
from vsgdesign.certificate.region import Region
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.pipeline.one_unit import as_unit

ALPHA = 0.5


def problem_of(
    name: str,
    controller: str,
    region: Region,
    alpha: float = ALPHA,
    basis: str = "impedance",
    tables: Mapping[str, GainTable] = MappingProxyType({}),
    apart: bool = False,
) -> Any:
    """A study with the limit of a controller, and its problem over a region."""
    study, ready = replace(load_study(f"studies/{name}/study.toml"), scr_basis=basis), Ready(tables=tables)
    study = as_unit(study, "a test")
    spec, _ = region_of(study, controller, None, None, ready=ready)
    system, _ = prepared(study, spec, region, ready, None, None)
    study, system = study.with_limit_of(spec), replace(system, apart=apart)
    return study, Problem.of(study, system, region, alpha)


@functools.cache
def laboratory() -> Any:
    """One sample of delay, the published structure at its design point, an LCL filter."""
    return problem_of("laboratory", "scheduled", Region((2.0, 12.0), (2.0, 4.0), (4e3, 8e3), (0.0, 2e3), 0.2))


@functools.cache
def closed_form() -> Any:
    """Transient impedance, power filters, the angle-damped structure at the measured powers, an LC filter."""
    return problem_of("table", "closed_form", Region((2.0, 20.0), (0.3, 20.0), (-4500.0, 4500.0), (-2e3, 2e3), 0.2))


@functools.cache
def a_table() -> GainTable:
    """Columns that are not flat."""
    scr, ratio = np.array([1.5, 2.0, 4.2, 9.0]), np.array([0.3, 1.1, 2.6, 10.0])
    slope = 1.0 + 0.1 * np.log(scr[:, None] / 3.0) - 0.05 * np.log(ratio[None, :])
    columns = {"k_1": 15.8 * slope, "d_1": 6.6 / slope, "k_2": 4.0 * slope, "share_Q": 0.9 * slope}
    return table("angle_damped", "poles", scr, ratio, columns, D_q=9.09)


@functools.cache
def with_table(error_Z: float = 0.0) -> Any:
    """A gain table, and estimates beyond its axes."""
    tables = {"table": a_table()}
    region = Region((2.0, 9.0), (0.3, 10.0), (-4500.0, 4500.0), (-2e3, 2e3), 0.2, error_Z=error_Z)
    return problem_of("table", "table", region, tables=tables)


@functools.cache
def units_apart() -> Any:
    """Equal units against each other: the rest is that on the grid, and the circuit ends at their node."""
    region = Region((2.0, 20.0), (1.0, 20.0), (-11.25e3, 11.25e3), (-3.75e3, 3.75e3), 0.2)
    return problem_of("plant", "table", region, tables={"table": units_table()}, apart=True)


@functools.cache
def units_table() -> GainTable:
    """Gains of the closed form for units that are behind 3 %, in the frame of a table."""
    unit = as_unit(load_study("studies/plant/study.toml"), "a test")
    axes = np.array([1.5, 5.0, 20.0]), np.array([0.5, 2.0, 20.0])
    columns = {"k_1": 15.8, "d_1": 6.6, "k_2": 4.0, "share_Q": 0.9}
    limits = (1.5, 20.0), (0.5, 20.0), (-11.25e3, 11.25e3), (-3.75e3, 3.75e3), unit.converter.V_limits_rms, 0.2
    return table(
        "angle_damped",
        "poles",
        *axes,
        columns,
        D_p=795.8,
        D_q=1083.0,
        base=base_of(unit),
        validity=ValidityBox(*limits),
    )
