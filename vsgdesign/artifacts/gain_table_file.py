"""A gain table as a JSON file that guards itself: what it keeps, and what makes a table unusable."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import certificate_record
from vsgdesign.artifacts.gain_table import (
    COLUMNS,
    KIND,
    SCHEMA,
    GainTable,
    TableBase,
    ValidityBox,
    table_document,
)
from vsgdesign.artifacts.guarded_file import GuardedFile, is_number, rows_on_a_line
from vsgdesign.equations.frames import base_impedance
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.power_loops import MOST_FED_BACK, PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains

STATUSES = ("met", "relaxed", "outside")
_TINY = 5e-324


def write_table_file(table: GainTable, path: str | Path) -> None:
    """The table as JSON: equal tables give equal bytes. The file appears whole or not at all.

    Raises ArtifactError with every fault where it is no table.
    """
    TABLE_FILE.write(table, path)


def read_table_file(path: str | Path) -> GainTable:
    """A table from its file.

    Raises ArtifactError with what to do where the file is missing, cut short, not JSON, of another kind or a
    newer schema, changed since it was written, or holds what is no table.
    """
    return TABLE_FILE.read(path)


def table_faults(table: GainTable) -> list[str]:
    """What makes a table unusable, one sentence each; empty where nothing does."""
    n, m = table.shape if table.scr.ndim == table.x_over_r.ndim == 1 else (0, 0)
    faults = [f"{name}: {problem}" for name, problem in _scalar_faults(table)]
    for name in ("scr", "x_over_r"):
        axis = getattr(table, name)
        if axis.ndim != 1 or len(axis) == 0 or not np.all(np.isfinite(axis)) or np.any(axis <= 0.0):
            faults.append(f"{name}: must be a list of positive numbers")
        elif np.any(np.diff(axis) <= 0.0):
            faults.append(f"{name}: must increase strictly")
    if faults:
        return faults
    wanted = COLUMNS[table.law]
    if set(table.columns) != set(wanted):
        faults.append(f"columns: has {', '.join(table.columns)}; law {table.law} has {', '.join(wanted)}")
    outside = ~table.valid if table.status.shape == (n, m) else np.zeros((n, m), dtype=bool)
    # A design for other powers may exist where the design point has no operating point: then all eight are missing.
    shaped = all(values.shape == (n, m) for values in table.gains)
    without = outside | np.all([np.isnan(values) for values in table.gains], axis=0) if shaped else outside
    per_cell: list[tuple[str, NDArray[Any], Any]] = [("status", table.status, None), ("active", table.active, None)]
    per_cell += [(f"columns.{name}", values, False) for name, values in table.columns.items()]
    per_cell += [(f"gains.{name}", values, without) for name, values in table.gains._asdict().items()]
    per_cell += [(f"margins.{name}", values, True) for name, values in table.margins.items()]
    per_cell.append(("price", table.price, outside))
    for name, values, may_be_missing in per_cell:
        if values.shape != (n, m):
            faults.append(f"{name}: has shape {values.shape}, the axes have {(n, m)}")
        elif may_be_missing is not None:
            bad = np.isinf(values) | (np.isnan(values) & ~np.asarray(may_be_missing))
            if bad.any():
                i, j = np.argwhere(bad)[0]
                at = f"SCR {table.scr[i]:g}, X/R {table.x_over_r[j]:g}"
                faults.append(f"{name}: not a number in a cell that must have one (first at {at})")
    if unknown := sorted(set(table.status.ravel().tolist()) - set(STATUSES)):
        faults.append(f"status: {', '.join(unknown)}; must be one of {', '.join(STATUSES)}")
    elif not table.valid.any():
        faults.append("status: every cell is outside")
    for name in set(wanted) & {"k_1", "d_1", "k_2", "H", "zeta"} & set(table.columns):
        if np.any(table.columns[name] <= 0.0):
            faults.append(f"columns.{name}: must be positive")
    if not faults and (fault := fed_back_fault(table)) is not None:
        faults.append(fault)
    return faults


def _scalar_faults(table: GainTable) -> Iterator[tuple[str, str]]:
    for name, choices in (("structure", tuple(STRUCTURES)), ("law", tuple(COLUMNS))):
        if getattr(table, name) not in choices:
            yield name, f"{getattr(table, name)!r} is unknown; must be one of {', '.join(choices)}"
    if table.base.scr_basis not in tuple(SCR_BASES):
        yield "base.scr_basis", f"{table.base.scr_basis!r} is unknown; must be one of {', '.join(SCR_BASES)}"
    least: dict[str, float] = dict.fromkeys(
        ("base.S_rated", "base.V_rated_rms", "base.omega_n", "base.V_g_rms", "time_scale"), _TINY
    )
    least |= dict.fromkeys(("base.R_2", "base.L_2", "base.tau_P", "base.tau_Q", "D_p", "D_q"), 0.0)
    least |= {"base.R_t": 0.0, "base.X_t": -math.inf, "base.omega_t": 0.0}
    least |= dict.fromkeys(("validity.error", "validity.error_Z"), 0.0)
    for name in (*least, "P_design", "Q_design"):
        value = attrgetter(name)(table)
        if not is_number(value):
            yield name, "must be a number"
        elif value < least.get(name, -math.inf):
            yield name, f"{value:g} must be {'positive' if least[name] > 0.0 else 'at least 0'}"
    for name in ("scr", "x_over_r", "P", "Q", "V_rms"):
        pair = getattr(table.validity, name)
        if not (isinstance(pair, tuple) and len(pair) == 2 and all(map(is_number, pair)) and pair[0] <= pair[1]):
            yield f"validity.{name}", "must be two numbers, the smaller first"
    for name in ("name", "study", "study_hash"):
        if not isinstance(getattr(table, name), str):
            yield name, "must be text"
    for name in ("specification", "provenance", "inputs", "design_inputs"):
        if not isinstance(getattr(table, name), dict):
            yield name, "must be a table of names and values"
    if not isinstance(table.between, dict | None):
        yield "between", "must be a table of names and values, or null"
    if isinstance(table.between, dict):
        if not all(type(table.between.get(name)) is int for name in ("points", "outside", "promised")):
            yield "between", "must have points, outside and promised as whole numbers"
        yield from _list_faults("between.broken", table.between.get("broken"), _BROKEN)
        yield from _between_counts(table.between)
        if "link" in table.between and not _is_link(table.between["link"]):
            yield "between.link", "must have charges, and v_dc with two voltages or none, as lists of numbers"
    if table.safe_place is not None:
        yield from _faults_of_safe_place(table)
    if table.verification is not None:
        yield from (("verification", fault) for fault in verification_faults(table.verification))
    if table.full_order is not None:
        yield from _full_order_faults(table.full_order)
    yield from _list_faults("causes", table.causes, _CAUSE)


def _is_link(link: Any) -> bool:
    """Whether it is what a build says of a battery on the dc link."""
    lists = [link.get(name) for name in ("charges", "v_dc")] if isinstance(link, dict) else [None]
    numbers = all(isinstance(one, list) and all(isinstance(x, int | float) for x in one) for one in lists)
    return numbers and len(link["charges"]) > 0 and len(link["v_dc"]) in (0, 2)


def _between_counts(look: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Counts of a look between the nodes that cannot be, of the whole numbers and the list that there are."""
    counts = {name: look[name] for name in ("points", "outside", "promised") if type(look.get(name)) is int}
    if isinstance(look.get("broken"), list):
        counts["broken"] = len(look["broken"])
    for name, value in counts.items():
        if value < 0:
            yield f"between.{name}", f"{value} must be at least 0"
    judged = counts.get("points", 0) - counts.get("outside", 0)
    if "promised" in counts and counts["promised"] > judged:
        yield "between.promised", f"{counts['promised']} of {judged} judged grids (points less outside) are promised"
    if counts.get("broken", 0) > counts.get("promised", counts.get("broken", 0)):
        yield "between.broken", f"{counts['broken']} are broken, but {counts['promised']} are promised"


def _faults_of_safe_place(table: GainTable) -> Iterator[tuple[str, str]]:
    place, axes = table.safe_place, (table.validity.scr, table.validity.x_over_r)
    if not (isinstance(place, tuple) and len(place) == 2 and all(map(is_number, place))):
        yield "safe_place", "must be two numbers, SCR and X/R"
        return
    for name, value, limits in zip(("SCR", "X/R"), place, axes, strict=True):
        if all(map(is_number, limits)) and not limits[0] <= value <= limits[1]:
            yield "safe_place", f"{name} {value:g} is outside of the validity, {limits[0]:g} to {limits[1]:g}"


_Kind = tuple[str, Callable[[object], bool]]
_NUMBER: _Kind = "a number", is_number
_TEXT: _Kind = "text", lambda value: isinstance(value, str)
_NAMED: _Kind = "a table of names and values", lambda value: isinstance(value, dict)
_BROKEN = {"scr": _NUMBER, "x_over_r": _NUMBER, "reached": _NAMED}
_CAUSE = {
    "scr": _NUMBER,
    "x_over_r": _NUMBER,
    "cause": _TEXT,
    "missed": _NAMED,
    "keeps": ("a table of names and values, or null", lambda value: value is None or isinstance(value, dict)),
    "limit": _TEXT,
    "limit_use": ("a number, or null", lambda value: value is None or is_number(value)),
}
"""What each entry of a list must have, in words and as a test."""


_FULL_ORDER: dict[str, _Kind] = {
    "certified": ("true or false", lambda value: isinstance(value, bool)),
    "proved": ("a share from 0 to 1", lambda value: is_number(value) and 0.0 <= value <= 1.0),
}
_OF_PROOF: dict[str, _Kind] = {
    "decay": ("a number of at least 0", lambda value: is_number(value) and value >= 0.0),
    "states": ("a whole number", lambda value: type(value) is int),
    "inner_gains": _NAMED,
    "inner_hash": _TEXT,
    "region": _NAMED,
}


def _full_order_faults(found: object) -> Iterator[tuple[str, str]]:
    """What a statement on the full-order loop must have; with a reason there is nothing but that."""
    if not isinstance(found, dict):
        yield "full_order", "must be a table of names and values, or null"
        return
    asked = _FULL_ORDER | ({"reason": _TEXT} if "reason" in found else _OF_PROOF)
    yield from _list_faults("full_order", [found], asked)
    if found.get("certified") is True and found.get("proved") != 1.0:
        yield "full_order.proved", "must be 1 where all is certified"


def _list_faults(name: str, entries: object, wanted: dict[str, _Kind]) -> Iterator[tuple[str, str]]:
    """What is wrong with a list of tables."""
    if not isinstance(entries, list):
        yield name, "must be a list of tables of names and values"
        return
    for k, entry in enumerate(entries):
        if not isinstance(entry, dict):
            yield f"{name}[{k}]", "must be a table of names and values"
            continue
        for key, (what, is_one) in wanted.items():
            if key not in entry:
                yield f"{name}[{k}].{key}", f"missing; must be {what}"
            elif not is_one(entry[key]):
                yield f"{name}[{k}].{key}", f"must be {what}"


def _from_schema_1(document: dict[str, Any]) -> dict[str, Any]:
    """A table of schema 1 did not keep what it was designed from, nor what was found between its nodes."""
    return document | {"design_inputs": {}, "between": None, "causes": []}


_NOT_OVER_CHANGES = (
    "the certificate of a table file before schema 3 follows ω_i, which is not continuous when the gains change; prove "
    "the table again (vsgdesign certify, or vsgdesign table build)."
)


def _from_schema_2(document: dict[str, Any]) -> dict[str, Any]:
    """A proof of before says nothing about changes of gains, so that it is no certificate any more. A counterexample
    stays one: its cell is unstable with any state."""
    certificate = document.get("certificate")
    if not isinstance(certificate, dict) or certificate.get("certified") is False:
        return document
    kept = {name: certificate[name] for name in ("region", "rate") if name in certificate}
    return document | {"certificate": {"certified": False, "reason": _NOT_OVER_CHANGES} | kept}


def _from_document(document: dict[str, Any]) -> GainTable:
    unknown = document.keys() - {f.name for f in fields(GainTable)} - {"kind", "schema"}
    if unknown:
        raise ValueError(f"unknown: {', '.join(sorted(unknown))}")
    document = {"verification": None, "safe_place": None, "full_order": None} | document
    values = {f.name: document[f.name] for f in fields(GainTable)}
    if isinstance(values["safe_place"], list):
        values["safe_place"] = tuple(values["safe_place"])
    values["base"] = TableBase(**values["base"])
    box: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values["validity"].items()}
    values["validity"] = ValidityBox(**box)
    values["gains"] = PowerLoopGains(**values["gains"])
    if values["certificate"] is not None:
        values["certificate"] = certificate_record(values["certificate"])
    return GainTable(**values)


TABLE_FILE = GuardedFile(
    kind=KIND,
    schema=SCHEMA,
    what="a gain table",
    origin='written by "vsgdesign table build"',
    again="build the table again",
    document=table_document,
    build=_from_document,
    faults=table_faults,
    layout=rows_on_a_line,
    upgrades=(_from_schema_1, _from_schema_2),
)


Array = NDArray[np.float64]


def largest_fed_back(table: GainTable) -> tuple[float, dict[str, float]]:
    """The largest k_P D_p (:eq:`droop-fed-back`) at the nodes, halfway between them, and at the limits and the middle
    of P, Q and V of the table's validity. Returns it with its place: ``scr``, ``x_over_r``, ``P``, ``Q`` and ``V_rms``.

    The value is −inf and the place empty if no node is a design.
    """
    base, box = table.base, table.validity
    r_over_x = 1.0 / table.x_over_r
    known = np.where(table.valid, 1.0, np.nan)
    columns = [_halved(_halved(values * known).T).T for values in table.parameters.values()]
    axes = [_halved(table.scr), _halved(r_over_x), *(_three(pair) for pair in (box.P, box.Q, box.V_rms))]
    scr, ratio, P, Q, V_rms = np.meshgrid(*axes, indexing="ij")
    Z_base = base_impedance(base.S_rated, base.V_rated_rms)
    R_g, L_g = SCR_BASES[base.scr_basis].grid(scr, 1.0 / ratio, Z_base, base.omega_n)
    with np.errstate(all="ignore"):  # a voltage of zero has no gains
        found = _fed_back(table, (P, Q, V_rms), (R_g, L_g), columns)
    if not np.isfinite(found).any():
        return -np.inf, {}
    at = np.unravel_index(np.nanargmax(found), found.shape)
    place = {"scr": scr[at], "x_over_r": 1.0 / ratio[at], "P": P[at], "Q": Q[at], "V_rms": V_rms[at]}
    return float(found[at]), {name: float(value) for name, value in place.items()}


def _fed_back(table: GainTable, at: tuple[Array, ...], grid: tuple[Array, Array], columns: list[Array]) -> Array:
    """k_P D_p over SCR, R/X, P, Q and V."""
    base, (P, Q, V_rms), (R_g, L_g) = table.base, at, grid
    J = scheduled_jacobian(P, Q, V_rms, R_g + base.R_2, base.omega_n * (L_g + base.L_2))
    normalised = NormalisedGains(*(values[:, :, None, None, None] for values in columns))
    ratings = table.D_p, table.D_q, base.S_rated, base.omega_n, table.law == "inertia"
    gains = STRUCTURES[table.structure].gains(*J, normalised, *ratings)
    return np.broadcast_to(np.asarray(gains.k_P * gains.D_p + 0.0 * columns[0][:, :, None, None, None]), P.shape)


def fed_back_fault(table: GainTable) -> str | None:
    """Why the gains of a table may not be changed from one to another, in a sentence; None where they may."""
    found, at = largest_fed_back(table)
    if found <= MOST_FED_BACK:
        return None
    return (
        f"k_P·D_p reaches {found:.3g} at SCR {at['scr']:.3g}, X/R {at['x_over_r']:.3g}, P {at['P']:g} W, "
        f"Q {at['Q']:g} var, V {at['V_rms']:.4g} V, and may be at most {MOST_FED_BACK:g}: a change of gains divides by "
        "1 − k_P·D_p. Give less damping there (d_1, zeta) or a softer P–f droop (a larger P_droop)"
    )


def _halved(values: Array) -> Array:
    """Rows with the mean of every two neighbours between them."""
    made = np.repeat(values, 2, axis=0)[:-1]
    made[1::2] = 0.5 * (values[:-1] + values[1:])
    return made


def _three(pair: tuple[float, float]) -> Array:
    return np.linspace(*pair, 3)


_KEPT = ("study", "controller", "seed", "confidence", "runs", "judged", "instruction_set", "strict")
_OF_FAMILY = ("title", "noun", "drawn", "judged", "left_out", "lost", "beyond_hardware")
_OF_PROMISE = (
    "figure",
    "survival",
    "limit",
    "noise",
    "unit",
    "at_least",
    "broken",
    "judged",
    "share",
    "bound",
    "one_in",
    "worst",
)


def verification_record(document: Mapping[str, Any]) -> dict[str, Any]:
    """The part of results.json of ``vsgdesign verify`` that a table keeps (``GainTable.verification``)."""
    return {name: document[name] for name in _KEPT if name in document} | {
        "families": {
            key: {name: family[name] for name in _OF_FAMILY if name in family}
            | {
                "promises": {
                    promised: {name: promise[name] for name in _OF_PROMISE if name in promise}
                    for promised, promise in family["promises"].items()
                }
            }
            for key, family in document["families"].items()
        }
    }


def verification_faults(record: Any) -> list[str]:
    """What makes a record unreadable, a sentence each; empty where nothing does."""
    if not isinstance(record, Mapping):
        return ["must be a table of names and values, or null"]
    faults = [f"{name} must be a whole number" for name in ("runs", "judged") if type(record.get(name)) is not int]
    if not is_number(record.get("confidence")) or not 0.0 < record["confidence"] < 1.0:
        faults.append("confidence must be between 0 and 1")
    families = record.get("families")
    if not isinstance(families, Mapping) or not all(_is_family(family) for family in families.values()):
        faults.append("families must have promises, each with limit, broken, judged, share, bound, one_in and worst")
    return faults or list(_count_faults(record))


def _count_faults(record: Mapping[str, Any]) -> Iterator[str]:
    """Counts of a readable record that cannot be, or do not add up."""
    families = record["families"]
    for name, total in (("drawn", "runs"), ("judged", "judged")):
        parts = [family.get(name) for family in families.values()]
        if parts and all(type(part) is int for part in parts) and sum(parts) != record[total]:
            yield f"{total} is {record[total]}, {name} of the families are {sum(parts)} together"
    for key, family in families.items():
        most = family.get("judged", record["judged"])
        for promised, promise in family["promises"].items():
            name = f"families.{key}.promises.{promised}"
            if not 0 <= promise["judged"] <= most:
                yield f"{name}.judged is {promise['judged']}, of {most} judged cases"
            elif not 0 <= promise["broken"] <= promise["judged"]:
                yield f"{name}.broken is {promise['broken']}, of {promise['judged']} judged cases"


def _is_family(family: Any) -> bool:
    promises = family.get("promises") if isinstance(family, Mapping) else None
    if not isinstance(promises, Mapping) or not all(_is_promise(promise) for promise in promises.values()):
        return False
    return all(type(family.get(name, 0)) is int for name in ("drawn", "judged"))


def _is_promise(promise: Any) -> bool:
    if not isinstance(promise, Mapping):
        return False
    counts = all(type(promise.get(name)) is int for name in ("broken", "judged"))
    known = ("share", "bound", "one_in", "worst")
    figures = all(name in promise and (promise[name] is None or is_number(promise[name])) for name in known)
    return counts and figures and is_number(promise.get("limit"))
