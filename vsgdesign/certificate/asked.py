"""The region that a proof is asked for: limits that are given, and for those that are not the box of the controller's
table or the axes of the study."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.certificate.region import Region, region_faults
from vsgdesign.errors import Fault, StudyError
from vsgdesign.runtime.guards import settings_of
from vsgdesign.study.parameters.study import ControllerSpec, Study


def region_of(
    study: Study,
    controller: str | None,
    scr: tuple[float, float] | None,
    x_over_r: tuple[float, float] | None,
    P_pu: tuple[float, float] | None = None,
    Q_pu: tuple[float, float] | None = None,
    error: float | None = None,
    rate: float = np.inf,
    ready: Ready = NOTHING,
    error_Z: float | None = None,
) -> tuple[ControllerSpec, Region]:
    """A controller by name (None: the last scheduled one) and a region, from limits in per unit of rating.

    What is None is a table's own box, which its certificate covers. For a closed form it is the limits of the study's
    stability axes, P ±0.9 pu, Q ±0.4 pu and ±20 % of R_g and L_g. Raises StudyError with every fault.
    """
    scheduled = [spec for spec in study.controllers if spec.kind == "scheduled"]
    chosen = [spec for spec in scheduled if controller in (None, spec.name)]
    S = study.converter.S_rated
    whole = _whole_region(study, chosen[-1] if chosen else None, ready)
    region = Region(
        whole.scr if scr is None else scr,
        whole.x_over_r if x_over_r is None else x_over_r,
        whole.P if P_pu is None else (P_pu[0] * S, P_pu[1] * S),
        whole.Q if Q_pu is None else (Q_pu[0] * S, Q_pu[1] * S),
        whole.error if error is None else error,
        rate,
        whole.error_Z if error_Z is None else error_Z,
    )
    faults = region_faults(region)
    if not chosen:
        names = ", ".join(spec.name for spec in scheduled) or "none"
        value = "" if controller is None else f'"{controller}"'
        faults.insert(0, Fault("controller", value, "no such scheduled controller", f"The study has: {names}."))
    if faults:
        raise StudyError(study.name, faults)
    return chosen[-1], region


def on_basis_of_table(study: Study, controller: str | None, ready: Ready = NOTHING) -> Study:
    """The study with the SCR on the basis of the controller's gain table, built or to be built.

    A region is then that of the table's own certificate. A study whose controller has no table is returned as it is.
    """
    chosen = [s for s in study.controllers if s.kind == "scheduled" and controller in (None, s.name)]
    if not chosen or chosen[-1].schedule != "table":
        return study
    table, asked = ready.tables.get(chosen[-1].name), study.specification
    basis = table.base.scr_basis if table is not None else study.scr_basis if asked is None else asked.scr_basis
    return replace(study, scr_basis=basis)


_SINGLE = 2.0**-22
"""How much less of a limit a scheduler may keep, which holds its numbers in single precision, rounded inwards."""


def within_scheduler(study: Study, region: Region, table: GainTable | None) -> tuple[Study, Region]:
    """The study and the region with the limits of V, P and Q that a table's scheduler keeps.

    It keeps them in single precision, rounded inwards. A proof makes gains of V, P and Q as they are, so that it must
    not reach beyond. Limits that differ by more than this rounding stay as they are.
    """
    if table is None:
        return study, region
    box, c = settings_of(table), study.converter
    V_low, V_high = _inwards(c.V_limits_rms, box.V_rms)
    rated = c.V_rated_rms
    converter = replace(c, V_min_pu=V_low / rated, V_max_pu=V_high / rated)
    kept = study if (V_low, V_high) == c.V_limits_rms else replace(study, converter=converter)
    return kept, replace(region, P=_inwards(region.P, box.P), Q=_inwards(region.Q, box.Q))


def _inwards(asked: tuple[float, float], kept: tuple[float, float]) -> tuple[float, float]:
    low, high = asked
    if low < kept[0] <= low + _SINGLE * abs(low):
        low = kept[0] + 1e-12 * abs(kept[0])  # stays inside when it is divided and multiplied again
    if high > kept[1] >= high - _SINGLE * abs(high):
        high = kept[1] - 1e-12 * abs(kept[1])
    return low, high


def beyond_table(region: Region, table: GainTable | None) -> Iterator[str]:
    """Where a region goes beyond the box of a table, one sentence each: a proof there is about gains that were not
    designed for it."""
    if table is None:
        return
    for name, words, unit, scale in (("scr", "SCR", "", 1.0), ("x_over_r", "X/R", "", 1.0), *_POWERS):
        asked, box = ([value / scale for value in getattr(of, name)] for of in (region, table.validity))
        if asked[0] < box[0] * (1.0 - np.sign(box[0]) * 1e-9) or asked[1] > box[1] * (1.0 + np.sign(box[1]) * 1e-9):
            yield (
                f"Beyond the table: {words} {asked[0]:.4g} to {asked[1]:.4g}{unit} is asked for, and the table was "
                f"designed for {box[0]:.4g} to {box[1]:.4g}{unit}."
            )
    for name, words in (("error", "of R_g and L_g"), ("error_Z", "of |Z|")):
        asked, box = getattr(region, name), getattr(table.validity, name)
        if asked > box * (1.0 + 1e-9):
            yield (
                f"Beyond the table: an error of {100.0 * asked:.4g} % {words} is asked for, and the table was designed "
                f"for {100.0 * box:.4g} %."
            )


_POWERS = ("P", "P", " kW", 1e3), ("Q", "Q", " kvar", 1e3)


def _whole_region(study: Study, spec: ControllerSpec | None, ready: Ready) -> Region:
    """The box of a controller's table, built or to be built; else the study's stability axes with common limits."""
    asked = study.specification
    if spec is not None and spec.schedule == "table":
        table = ready.tables.get(spec.name)
        if table is not None and table.base.scr_basis == study.scr_basis:
            box = table.validity
            return Region(box.scr, box.x_over_r, box.P, box.Q, box.error, error_Z=box.error_Z)
        if table is None and asked is not None and asked.scr_basis == study.scr_basis:
            box, error = asked.box, max(asked.box.error_R, asked.box.error_X)
            P, Q = ((min(powers), max(powers)) for powers in (box.P, box.Q))
            axes = (asked.scr[0], asked.scr[-1]), (asked.x_over_r[0], asked.x_over_r[-1])
            return Region(*axes, P, Q, error, error_Z=box.error_Z)
    axes, S = study.stability, study.converter.S_rated
    scr, x_over_r = (axes.scr[0], axes.scr[-1]), (axes.x_over_r[0], axes.x_over_r[-1])
    return Region(scr, x_over_r, (-0.9 * S, 0.9 * S), (-0.4 * S, 0.4 * S), 0.2)


def check_known(study: Study, spec: ControllerSpec, region: Region, ready: Ready) -> None:
    """Raises StudyError where the proof does not know what the loop does."""
    faults = []
    if np.isfinite(region.rate):
        faults.append(Fault("rate", f"{region.rate:g}", "the proof of the full-order model is one of grids that rest"))
    table = ready.tables.get(spec.name)
    for sentence in beyond_table(region, table):
        faults.append(Fault("region", "", f"goes beyond the table, whose scheduler would draw it in. {sentence}"))
    if table is not None:
        faults += _drawn_in(study, region, table)
    if faults:
        raise StudyError(study.name, faults)


def _drawn_in(study: Study, region: Region, table: GainTable) -> list[Fault]:
    """Where a table's scheduler limits P, Q or V of the region: the proof makes gains of them as they are."""
    box, faults = settings_of(table), []
    for name, own, asked in (
        ("P", box.P, region.P),
        ("Q", box.Q, region.Q),
        ("V_rms", box.V_rms, study.converter.V_limits_rms),
    ):
        if asked[0] < own[0] or asked[1] > own[1]:
            limit = f"must hold {asked[0]:g} to {asked[1]:g}: gains are made of the values as they are"
            faults.append(Fault(f"table's box of {name}", f"{own[0]:g} to {own[1]:g}", limit))
    return faults
