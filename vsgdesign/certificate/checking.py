"""The certificate of a gain table against the table itself: its inequality, the cell that it names and its certified
steps, all computed again at points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import CertificateRecord, StaticLimits, StepRow, StepStatement
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.guarded_file import is_number
from vsgdesign.certificate.lyapunov import Motion, move_factor, residual
from vsgdesign.certificate.region import Region, System, nodes, point_of, random_points, region_faults
from vsgdesign.certificate.results import GAP_FREE, GRIDDED
from vsgdesign.certificate.step_terms import STEPS, ActingLimits, LevelShape, rest_current_pu, step_sizes
from vsgdesign.equations.power_flow import POWER_MARGIN, Lags
from vsgdesign.errors import counted
from vsgdesign.linear.operating_point.equilibrium import limits_of_converter
from vsgdesign.runtime.table import table_schedule
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.grid import GridSource

Array = NDArray[np.float64]

_NODES = 15
"""Nodes per axis at which a certificate was verified when it was made (:func:`vsgdesign.certificate.certify`)."""
_PLACE_NODES = 5
"""The same of a place of the grid with a function of its own."""
_RANDOM = 2000
_STEP_NODES = 5
_ROUNDING = 1e-6
"""Relative difference of two computations of the same number, on other processors too."""


class CertificateCheck(NamedTuple):
    """The faults of a certificate, one sentence each, and what of it no check at points can show."""

    faults: tuple[str, ...]
    carried: tuple[str, ...]


@dataclass(frozen=True)
class _Ground:
    """What a table keeps of the study of its design, as far as power loops and static limits need it."""

    converter: Converter
    filter: Filter
    grid_source: GridSource
    scr_basis: str
    power_lags: Lags


def check_certificate(table: GainTable) -> CertificateCheck:
    """Check the certificate of a table at the points at which it was verified, at the table's nodes and, where it is
    said to be gap-free, at random points (:eq:`certificate`, :eq:`step-conditions`).

    The points are cells within the static limits that the certificate names. Nothing is shown about what lies between
    them.
    """
    record = table.certificate
    if record is None:
        return CertificateCheck((), ())
    ground, region = _ground(table), _region(record)
    if ground is None:
        return CertificateCheck((), ("certificate (design_inputs has what is no number)",))
    faults = [*_word_faults(record), *_limit_faults(table, record, ground)]
    if region is not None:
        faults += [f"certificate.region: {fault}" for fault in region_faults(region)]
    if faults:  # what follows is about a region that is there
        return CertificateCheck(tuple(faults), ("certificate",))
    if region is None:
        return CertificateCheck((), ("certificate (it does not state its region)",))
    limits = record.region.limits or StaticLimits(
        V_low=table.validity.V_rms[0] / table.base.V_rated_rms,
        V_high=table.validity.V_rms[1] / table.base.V_rated_rms,
        power_transfer=POWER_MARGIN,
    )
    if ground.filter.L_1 == 0.0 and (limits.current is not None or limits.bridge_voltage is not None):
        return CertificateCheck((), ("certificate (the table does not keep the filter)",))
    system = System(ground, table_schedule(table), region, limits)
    if record.certified:
        found = _proof_check(table, record, system)
        if record.differential is None or not record.differential.certified:
            return found
        apart = _proof_check(table, record.differential, replace(system, apart=True), "certificate.differential")
        return CertificateCheck(found.faults + apart.faults, found.carried + apart.carried)
    return CertificateCheck(tuple(_cell_faults(system, record)), ("certificate.reason",) * (record.cell is None))


def _proof_check(
    table: GainTable, record: CertificateRecord, system: System, path: str = "certificate"
) -> CertificateCheck:
    """The inequality of a certificate, and its steps."""
    region, document = system.region, record.document
    if region is None or record.decay is None or not {"P", "places"} & set(document):
        return CertificateCheck((), (f"{path} (it does not state its function)",))
    points, A = system.matrices(_points(table, region, record.proof == GAP_FREE), partial=True)
    if not len(points):
        return CertificateCheck(("certificate.region has no cell within certificate.static_limits",), ())
    made = {"scale": system.scale.tolist(), "states": list(system.states)}
    faults = [
        f"{path}.{name} is {document[name]}, the function is over {value}"
        for name, value in made.items()
        if document.get(name) not in (None, value)
    ]
    motion = Motion(region, bool(np.isfinite(region.rate)))
    if record.places is None:
        faults += _decay_faults(document, motion, points, A, path)
    else:
        faults += _place_faults(table, record, replace(system, region=region), motion, path)
    carried = [f"{path} between {counted(len(points), 'point')}"]
    if record.steps is not None and record.steps.rows:
        if system.study.filter.C > 0.0:
            system = replace(system, region=replace(region, rate=np.inf), transient=False)
            points, A = system.matrices(points, partial=True)
            faults += _step_faults(table, system, record.steps, points, A)
        else:
            carried.append("certificate.steps (the table does not keep the filter)")
    return CertificateCheck(tuple(faults), tuple(carried))


def _region(record: CertificateRecord) -> Region | None:
    at = record.region
    if at.scr is None or at.x_over_r is None or at.P is None or at.Q is None or at.error is None:
        return None
    return Region(at.scr, at.x_over_r, at.P, at.Q, at.error, at.rate, at.error_Z)


def _ground(table: GainTable) -> _Ground | None:
    """None where the inputs of the design are not those of a converter."""
    base, kept = table.base, table.design_inputs
    c, f, source = (_section(kept, name) for name in ("converter", "filter", "grid"))
    numbers = [*(c.get(name, 1.0) for name in _OF_CONVERTER), *(f.get(name, 0.0) for name in _OF_FILTER)]
    if not all(is_number(value) and value >= 0.0 for value in (*numbers, source.get("omega_g", 1.0))):
        return None
    converter = Converter(
        S_rated=base.S_rated,
        V_rated_rms=base.V_rated_rms,
        omega_n=base.omega_n,
        V_dc=c.get("V_dc", 0.0),
        f_sw=c.get("f_sw", 1.0),
        zero_sequence=c.get("zero_sequence", False),
        current_limit_pu=c.get("current_limit_pu"),
        V_min_pu=table.validity.V_rms[0] / base.V_rated_rms,
        V_max_pu=table.validity.V_rms[1] / base.V_rated_rms,
    )
    parts = {name: f.get(name, 0.0) for name in _OF_FILTER}
    at = GridSource(base.V_g_rms, source.get("omega_g", base.omega_n))
    return _Ground(converter, Filter(**parts, L_2=base.L_2, R_2=base.R_2), at, base.scr_basis, base.lags)


_OF_CONVERTER, _OF_FILTER = ("V_dc", "f_sw", "current_limit_pu"), ("L_1", "R_1", "C", "R_c")


def _section(kept: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = kept.get(name)
    return found if isinstance(found, Mapping) else {}


def _points(table: GainTable, region: Region, anywhere: bool, count: int = _NODES) -> Array:
    low, high = region.limits
    axes = [table.scr, table.x_over_r, *(np.linspace(low[k], high[k], 3) for k in range(2, 6))]
    mesh = np.meshgrid(*(np.unique(axis) for axis in axes), indexing="ij")
    own = np.stack([axis.ravel() for axis in mesh], axis=1)
    inside = np.ones(len(own), dtype=bool)
    for k, (least, most) in enumerate((region.scr, region.x_over_r)):
        inside &= (own[:, k] >= least) & (own[:, k] <= most)
    fresh = random_points(region, _RANDOM if anywhere else 0, np.random.default_rng(0))
    return np.concatenate([point_of(own[inside], region), nodes(region, count), fresh])


def _word_faults(record: CertificateRecord) -> Iterator[str]:
    """What the words of a certificate say about its numbers."""
    if not record.certified:
        return
    if record.decay is not None and not record.decay > 0.0:
        yield f"certificate.decay is {record.decay:g} 1/s, but certificate.certified is true"
    if record.proof not in (None, GAP_FREE, GRIDDED):
        yield f'certificate.proof is "{record.proof}", must be {GAP_FREE} or {GRIDDED}'
    share = record.gap_share
    if share is not None and not (share == 0.0 if record.proof == GAP_FREE else 0.0 <= share <= 1.0):
        yield f"certificate.gap.share is {share:g}, but certificate.proof is {record.proof}"


def _limit_faults(table: GainTable, record: CertificateRecord, ground: _Ground) -> Iterator[str]:
    """A certificate covers the box of its table, within the static limits of the converter, and no more."""
    v, region = table.validity, record.region
    for name in ("scr", "x_over_r", "P", "Q"):
        its, box = getattr(region, name), getattr(v, name)
        if record.certified and its is not None and (its[0] < box[0] or its[1] > box[1]):
            whole = f"{box[0]:g} to {box[1]:g}"
            yield f"certificate.region.{name} is {its[0]:g} to {its[1]:g}, beyond validity.{name}, {whole}"
    for name in ("error", "error_Z"):
        its, box = getattr(region, name), getattr(v, name)
        if record.certified and its is not None and its > box:
            yield f"certificate.region.{name} is {its:g}, beyond validity.{name}, {box:g}"
    if region.limits is not None:
        yield from _static_faults(record, region.limits, ground, bool(_section(table.design_inputs, "converter")))


def _static_faults(record: CertificateRecord, limits: StaticLimits, ground: _Ground, kept: bool) -> Iterator[str]:
    """``kept``: whether the table keeps the converter of its design."""
    c = ground.converter
    most = c.current_limit_pu
    of = limits_of_converter(c, np.inf if most is None else most * c.I_rated_pk)
    for name in ("V_low", "V_high", "power_transfer", *(("bridge_voltage",) if kept else ())):
        its, made = getattr(limits, name), getattr(of, name)
        if its is None or abs(its - made) > _ROUNDING * made:
            yield f"certificate.static_limits.{name} is {_shown(its)}, the converter of the table has {made:.6g}"
    if not kept:
        return
    if limits.current is None or of.current is None or most is None:
        if limits.current is not of.current:
            stated, made = _shown(limits.current), _shown(of.current)
            yield f"certificate.static_limits.current is {stated}, the converter has {made}"
        return
    if limits.current > of.current * (1.0 + _ROUNDING):
        yield f"certificate.static_limits.current is {limits.current:.6g}, the converter has {of.current:.6g}"
    acting, share = None if record.steps is None else record.steps.current_pu, of.current / most
    if acting is not None and abs(limits.current - share * acting) > _ROUNDING * limits.current:
        yield (
            f"certificate.steps.current_pu is {acting:.6g}, certificate.static_limits.current of "
            f"{limits.current:.6g} belongs to {limits.current / share:.6g}"
        )


def _shown(value: float | None) -> str:
    return "null" if value is None else f"{value:.6g}"


def _decay_faults(document: Mapping[str, Any], motion: Motion, points: Array, A: Array, path: str) -> Iterator[str]:
    P, wanted = _matrix(document.get("P")), (3 if motion.moving else 1, *A.shape[1:])
    if P is None or P.shape != wanted:
        yield f"{path}.P has the shape {None if P is None else P.shape}, must have {wanted}"
        return
    family = motion.family(points)
    least = min(float(np.linalg.eigvalsh(np.tensordot(corner, P, 1))[0]) for corner in family.corners)
    if not least > 0.0 or not np.allclose(P, np.swapaxes(P, 1, 2), rtol=1e-9, atol=0.0):
        yield f"{path}.P is not symmetric and positive definite (its least eigenvalue is {least:.3g})"
        return
    found = residual(A, family, P, 0.0)
    stated = {name: document.get(name) for name in ("decay", "sampled", "largest")}
    for name, value in stated.items():
        if value is not None and not is_number(value):
            yield f"{path}.{name} is {value!r}, must be a number"
            return
    for name in ("decay", "sampled"):
        yield from _too_fast(f"{path}.{name}", stated[name], found, points)
    largest, worst = stated["largest"], float(found.max()) + 2.0 * (stated["decay"] or 0.0)
    if largest is not None and not worst <= largest + _ROUNDING * abs(largest) + 1e-9:
        yield f"{path}.largest is {largest:.6g} 1/s, at these points it is {worst:.6g} 1/s"


def _place_faults(
    table: GainTable, record: CertificateRecord, system: System, motion: Motion, path: str
) -> Iterator[str]:
    """The functions of places: that their places cover the region, each holds in its own, and what a move costs."""
    region, found, covered = motion.region, [], 0.0
    for k, place in enumerate(record.document["places"]):
        name = f"{path}.places[{k}]"
        limits = _limits_of(place)
        if limits is None or not all(
            whole[0] * (1.0 - 1e-9) <= own[0] < own[1] <= whole[1] * (1.0 + 1e-9)
            for own, whole in zip(limits, (region.scr, region.x_over_r), strict=True)
        ):
            yield f"{name} is no place of certificate.region"
            return
        covered += float(np.prod([np.log(high / low) for low, high in limits]))
        part = replace(region, scr=limits[0], x_over_r=limits[1])
        points, A = system.matrices(_points(table, part, record.proof == GAP_FREE, _PLACE_NODES), partial=True)
        stated = {one: place.get(one) for one in ("P", "decay", "sampled")}
        stated["decay"] = max(record.decay or 0.0, stated["decay"] or 0.0)
        faults = list(_decay_faults(stated, replace(motion, region=part), points, A, name))
        yield from faults
        if faults:
            return
        found.append(np.asarray(place["P"], dtype=float)[0])
    whole = float(np.prod([np.log(high / low) for low, high in (region.scr, region.x_over_r)]))
    if covered < whole * (1.0 - 1e-9):
        yield f"{path}.places cover {100.0 * covered / whole:.4g} % of certificate.region"
    if record.move is not None and (most := move_factor(found)) > record.move[0] * (1.0 + _ROUNDING):
        yield f"{path}.move.factor is {record.move[0]:.6g}, its functions have {most:.6g}"


def _limits_of(place: Any) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """SCR and X/R of a place; None where they are no limits."""
    found = []
    for name in ("scr", "x_over_r"):
        pair = place.get(name) if isinstance(place, Mapping) else None
        if not (isinstance(pair, list) and len(pair) == 2 and all(map(is_number, pair)) and 0.0 < pair[0] < pair[1]):
            return None
        found.append((float(pair[0]), float(pair[1])))
    return found[0], found[1]


def _matrix(value: Any) -> Array | None:
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return None


def _too_fast(name: str, stated: float | None, found: Array, points: Array) -> Iterator[str]:
    """``found``: the residual without a decay, minus twice the decay that holds."""
    k = int(np.argmax(found))
    if stated is not None and not found[k] + 2.0 * stated <= _ROUNDING * abs(stated):
        yield f"{name} is {stated:.4g} 1/s, its function allows {-0.5 * found[k]:.4g} 1/s at {_place(points[k])}"


def _place(point: Array) -> str:
    weakness, angle, P, Q, e_R, e_L = point
    return (
        f"SCR {1.0 / weakness:.4g}, X/R {np.tan(angle):.4g}, P {P / 1e3:.4g} kW, Q {Q / 1e3:.4g} kvar, errors "
        f"{100.0 * e_R:.3g} % and {100.0 * e_L:.3g} %"
    )


def _cell_faults(system: System, record: CertificateRecord) -> Iterator[str]:
    """The cell that a failed proof names has the eigenvalue or the decay that it says."""
    cell = record.cell
    if cell is None:
        return
    at = np.array([[1.0 / cell.scr, np.arctan(cell.x_over_r), cell.P, cell.Q, cell.error_R, cell.error_L]])
    _, A = system.matrices(at, partial=True)
    made = float(np.linalg.eigvals(A[0]).real.max()) if len(A) else np.nan
    if cell.eigenvalue is not None:
        name, stated = "eigenvalue.real", cell.eigenvalue.real
    else:
        name, stated, made = "slowest.decay", cell.decay or 0.0, -made
    if not abs(stated - made) <= 1e-4 * max(abs(made), 1e-3):
        yield f"certificate.{name} is {stated:.4g} 1/s, at {_place(at[0])} it is {made:.4g} 1/s"


def _step_faults(table: GainTable, system: System, found: StepStatement, points: Array, A: Array) -> Iterator[str]:
    P = _matrix(found.P)
    if P is None or P.shape != (3, 3) or not np.allclose(P, P.T, rtol=1e-9) or np.linalg.eigvalsh(P)[0] <= 0.0:
        yield "certificate.steps.P is not a symmetric and positive definite matrix of 3 × 3"
        return
    region = system.region
    if region is None:
        return
    value = residual(A, Motion(region, False).family(points), P[None], 0.0)
    yield from _too_fast("certificate.steps.decay", found.decay, value, points)
    c = system.study.converter
    shape = LevelShape.of(P, c.V_min_pu, c.V_max_pu)
    limits = ActingLimits(found.current_pu, found.V_low_pu, found.V_high_pu, found.limiter, found.soft, found.clips_V)
    for k, row in enumerate(found.rows):
        yield from _row_faults(table, system, shape, limits, row, f"certificate.steps.rows[{k}]")


def _row_faults(
    table: GainTable, system: System, shape: LevelShape, limits: ActingLimits, row: StepRow, name: str
) -> Iterator[str]:
    region: Any = system.region
    for key in ("scr", "P", "Q"):
        its, whole = getattr(row, key), getattr(region, key)
        low, high = whole[0] - _ROUNDING * abs(whole[0]), whole[1] + _ROUNDING * abs(whole[1])
        if not low <= its[0] <= its[1] <= high:
            yield f"{name}.{key} is {its[0]:g} to {its[1]:g}, beyond the region's {whole[0]:g} to {whole[1]:g}"
            return
    part = replace(region, scr=row.scr, P=row.P, Q=row.Q)
    cells = system.cells(nodes(part, _STEP_NODES), partial=True)
    if not len(cells.points):
        return
    rest = float(rest_current_pu(system, cells).max())
    if row.rest_current_pu is None or row.rest_current_pu < rest * (1.0 - _ROUNDING):
        yield f"{name}.rest_current_pu is {_shown(row.rest_current_pu)}, at the nodes it is {rest:.6g}"
    if not row.possible:
        return
    units = table.base.S_rated, table.base.S_rated, 1.0, table.base.V_g_rms, 1.0
    most = step_sizes(system, cells, shape, limits).min(axis=1)
    for key, unit, size in zip(STEPS, units, most, strict=True):
        stated = getattr(row, key)
        if stated is None or stated > unit * size * (1.0 + _ROUNDING):
            yield f"{name}.{key} is {_shown(stated)}, at the nodes of the row at most {unit * size:.6g} is certain"
