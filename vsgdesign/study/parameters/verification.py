"""The [verification] section: the random cases with which the promises of a controller are tested in EMT."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from vsgdesign.equations.grid import MOST_ERROR_Z
from vsgdesign.study.parameters.case_families import family_fields
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import (
    F_N,
    S_RATED,
    SEEDS,
    V_RATED,
    Field,
    Scope,
    at,
    drawn,
    fields_of,
    number,
    section,
    values,
    whole,
)
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS, GridSource, basis_field
from vsgdesign.study.parameters.ranges import Range
from vsgdesign.study.parameters.reader import TableReader
from vsgdesign.study.parameters.specification import Specification

DEFAULT_SCR, DEFAULT_X_OVER_R = (1.2, 20.0), (0.3, 20.0)
"""Grids where neither a specification nor the axes of the margin maps say which."""

DEFAULT_P, DEFAULT_Q = 0.9, 0.3
"""The same for the powers: ± these shares of S_rated."""

_IN_PLANTS = ("units_apart", "more_reactance")
"""Fields that a study of one converter has no use for."""

_SAME = 1e-9
"""Two limits that differ by this share are the same."""


@dataclass(frozen=True)
class CaseFamily:
    """One kind of disturbance: how often it is drawn, and the ranges out of which its quantities are drawn."""

    weight: float | None
    """Its share of the runs is this over the sum of all weights. None: as the current limiter has it
    (:meth:`VerificationSpec.weights`)."""
    ranges: Mapping[str, Range | None] = field(default_factory=dict, hash=False)
    """By the name of the quantity, SI. None: as the current limiter has it (:meth:`VerificationSpec.ranges`)."""


_MOST = 2.0 * S_RATED
_OF_SPECIFICATION = "the specification's"


class _Basis:
    """Fields of this section."""

    scr_basis: str = basis_field(shown="of the specification, else of `[grid]`")
    """Basis of `scr` here."""


class _Place:
    """Fields of this section."""

    scr: Range = drawn(
        "1", *SCR_LIMITS, shown=f"{_OF_SPECIFICATION}; else that of `[stability]`; else 1.2 to 20", logarithmic=True
    )
    """Grids."""
    x_over_r: Range = drawn("1", *X_OVER_R_LIMITS, shown="the same; else 0.3 to 20", logarithmic=True)
    """Grids."""
    P: Range = drawn("W", -1.0 * _MOST, _MOST, shown="the same; else ±0.9 S_rated")
    """Powers before the disturbance."""
    Q: Range = drawn("var", -1.0 * _MOST, _MOST, shown="the same; else ±0.3 S_rated")
    """Powers before the disturbance."""
    V_g_rms: Range = drawn(
        "1", 0.5, 1.5, shown=f"{_OF_SPECIFICATION}, else that of `[grid]`", name="V_g_pu", scale=V_RATED
    )
    """Source voltage, pu of rated."""
    omega_g: Range = drawn("Hz", 0.8 * F_N, 1.2 * F_N, shown="the same", name="f_g", scale=2.0 * math.pi)
    """Source frequency."""


class _Errors:
    """Fields of this section."""

    error_R: float = number("1", 0.0, 0.9, default=0.0, shown=f"{_OF_SPECIFICATION}, else none")
    """Error of R̂_g."""
    error_X: float = number("1", 0.0, 0.9, default=0.0, shown="the same")
    """Error of L̂_g."""
    error_Z: float = number("1", 0.0, MOST_ERROR_Z, default=0.0, shown="the same")
    """Error in any direction, relative to the grid impedance."""


class _Silent:
    """Fields of this section."""

    silent_s: Range = drawn("s", 0.0, 100.0, default=(0.02, 1.0), name="silent", logarithmic=True)
    """Time without an answer after each change."""


class _OfPlant:
    """Fields of this section."""

    units_apart: float = number("1", 0.0, 1.0, default=0.1)
    """In a plant: by how much P and Q of a unit differ from the mean of all at most, as a share of S_rated."""
    more_reactance: Range = drawn("1", 0.0, 1.0, default=(0.0, 0.0))
    """In a plant: by how much the x_t of a unit is larger than that of `[plant]`, pu of one unit."""


@dataclass(frozen=True, kw_only=True)
class CaseBox:
    """Where a case may begin: lower and upper end of everything that is drawn, SI."""

    scr_basis: str
    """``impedance`` or ``reactance``."""
    scr: Range
    x_over_r: Range
    P: Range
    """W, at the control point."""
    Q: Range
    V_g_rms: Range
    """Phase rms, V."""
    omega_g: Range
    """rad/s."""
    errors: tuple[float, float, float]
    """error_R, error_X and error_Z of the estimate (:eq:`error-set`)."""


@section
class VerificationSpec:
    """What is drawn, how often, and how sure the answer has to be."""

    runs: int = whole(1, 1_000_000_000, default=100_000)
    """Number of cases."""
    confidence: float = number("1", 0.5, 0.999999, default=0.99)
    """Probability with which the bound on the share of broken promises holds."""
    seed: int = whole(0, SEEDS, default=1)
    """Of the draw."""
    with_run: int = whole(0, 1_000_000_000, default=0)
    """Number of cases with which `vsgdesign run` verifies each gain table of the study; 0: it does not."""
    box: CaseBox
    silent_s: Range
    """For how long a schedule is told nothing after each change of the grid or its source, s."""
    families: Mapping[str, CaseFamily] = field(hash=False)
    """By name, in the order of :data:`FAMILIES`."""
    units_apart: float = 0.1
    """In a plant: by how much P and Q of a unit differ from the mean of all at most, as a share of S_rated."""
    more_reactance: Range = (0.0, 0.0)
    """In a plant: by how much the x_t of a unit is larger than that of the plant, pu of one unit."""
    given: frozenset[str] = frozenset()
    """Names of the ranges of the box that the study itself gives; the others follow from its other sections."""

    @property
    def scr(self) -> Range:
        """That of the box, on its basis."""
        return self.box.scr

    @property
    def x_over_r(self) -> Range:
        """That of the box."""
        return self.box.x_over_r

    @property
    def scr_basis(self) -> str:
        """That of the box."""
        return self.box.scr_basis

    def weights(self, rests_at_limit: bool) -> dict[str, float]:
        """The weight of every family. ``rests_at_limit``: whether the controller has a current limit and a limiter
        that can rest at it. Without one, nothing promises that a phase jump or a sag is survived, and they are not
        drawn unless the study gives them a weight."""
        found = {}
        for name, family in self.families.items():
            default = 1.0 if name in _ALWAYS or (rests_at_limit and name in _WITH_LIMITER) else 0.0
            found[name] = default if family.weight is None else family.weight
        return found

    def ranges(self, name: str, rests_at_limit: bool) -> dict[str, Range]:
        """The ranges of a family, SI. The phase jumps with the grid only where the current is limited as above."""
        default = _PHASE_WITH_GRID if rests_at_limit else (0.0, 0.0)
        return {key: default if ends is None else ends for key, ends in self.families[name].ranges.items()}


_ALWAYS, _WITH_LIMITER = ("step", "grid"), ("phase", "sag")

_PHASE_WITH_GRID = (0.0, math.radians(30.0))


def verification_fields() -> tuple[Field, ...]:
    """The fields of [verification]."""
    return (
        *fields_of(VerificationSpec),
        *fields_of(_Basis),
        *fields_of(_Place),
        *fields_of(_Errors),
        *fields_of(_Silent),
        *fields_of(_OfPlant),
        *family_fields(),
    )


def read_verification(
    table: TableReader | None,
    scope: Scope,
    converter: Converter,
    source: GridSource,
    specification: Specification | None,
    maps: Mapping[str, tuple[float, ...]],
    scr_basis: str,
) -> VerificationSpec:
    """The section, or its defaults. ``maps``: the axes ``scr``, ``x_over_r``, ``P`` and ``Q`` that [stability] gives
    (those that it does not give are absent)."""
    table = table or TableReader({}, "verification", [])
    defaults = (
        _of_study(converter, source, maps) if specification is None else _of_specification(specification, converter)
    )
    asked = {name: (ends[0], ends[-1]) for name, ends in defaults.items()}
    spec = VerificationSpec(
        **values(VerificationSpec, table),
        box=_read_box(table, scope, asked, specification, scr_basis),
        **values(_Silent, table),
        **values(_OfPlant, table),
        families=_read_families(table, scope),
        given=frozenset(
            name
            for name in ("scr", "x_over_r", "P", "Q", "error_R", "error_X", "error_Z", *_IN_PLANTS)
            if table.has(name)
        ),
    )
    table.finish()
    return spec


def _read_families(table: TableReader, scope: Scope) -> dict[str, CaseFamily]:
    found = {}
    for family in family_fields():
        name = family.name
        own = table.child(name) or TableReader({}, table.name(name), table.faults)
        ranges = values(family.of, own, scope)
        weight = ranges.pop("weight")
        found[name] = CaseFamily(weight, ranges)
        if weight == 0.0 and len(own.table) > 1:
            own.fault("weight", 0, "the family is never drawn, and its other fields have no effect", "Leave them out.")
        own.finish()
    by_default = any(found[name].weight is None for name in (*_ALWAYS, *_WITH_LIMITER))
    if not by_default and not any(family.weight for family in found.values()):
        table.fault("", None, "no family has a weight above zero", "Give one, as in [verification.step] weight = 1.")
    return found


def _read_box(
    table: TableReader,
    scope: Scope,
    asked: Mapping[str, Range],
    specification: Specification | None,
    scr_basis: str,
) -> CaseBox:
    """``asked``: the range of each quantity that holds where the section gives none."""
    place = values(_Place, table, scope, asked)
    basis = values(
        _Basis, table, defaults={"scr_basis": scr_basis if specification is None else specification.scr_basis}
    )
    of_specification = (0.0, 0.0, 0.0) if specification is None else specification.box.errors
    errors = values(
        _Errors, table, defaults=dict(zip(("error_R", "error_X", "error_Z"), of_specification, strict=True))
    )
    if specification is not None:
        if basis["scr_basis"] != specification.scr_basis:
            table.fault(
                "scr_basis",
                basis["scr_basis"],
                f"the [specification] has {specification.scr_basis}",
                "Leave it out, or give both the same.",
            )
        for one in fields_of(_Place):
            given = place[one.attribute]
            scale = at(one.scale, scope)
            _check_inside(table, one.name, (given[0] / scale, given[1] / scale), asked[one.name])
        for (name, error), most in zip(errors.items(), of_specification, strict=True):
            _check_inside(table, name, (0.0, error), (0.0, most))
    lowest = place["x_over_r"][0]
    if errors["error_Z"] >= (share := math.sin(math.atan(lowest))):
        problem = f"leaves no inductance in an estimate at X/R {lowest:g}: must be less than {share:.3g}"
        table.fault("error_Z", errors["error_Z"], problem, "Begin x_over_r higher, or ask for less.")
    return CaseBox(**basis, **place, errors=(errors["error_R"], errors["error_X"], errors["error_Z"]))


def _of_specification(specification: Specification, converter: Converter) -> dict[str, tuple[float, ...]]:
    box = specification.box
    return {
        "scr": specification.scr,
        "x_over_r": specification.x_over_r,
        "P": box.P,
        "Q": box.Q,
        "V_g_pu": tuple(V / converter.V_rated_rms for V in box.V_g_rms),
        "f_g": tuple(omega / (2.0 * math.pi) for omega in box.omega_g),
    }


def _of_study(
    converter: Converter, source: GridSource, maps: Mapping[str, tuple[float, ...]]
) -> dict[str, tuple[float, ...]]:
    P, Q = DEFAULT_P * converter.S_rated, DEFAULT_Q * converter.S_rated
    return {
        "scr": DEFAULT_SCR,
        "x_over_r": DEFAULT_X_OVER_R,
        "P": (-P, P),
        "Q": (-Q, Q),
        "V_g_pu": (source.V_g_rms / converter.V_rated_rms,),
        "f_g": (source.omega_g / (2.0 * math.pi),),
        **maps,
    }


def _check_inside(table: TableReader, name: str, given: Range, asked: Range) -> None:
    """A fault where a range goes beyond what the specification asks for: nothing is promised there."""
    slack = _SAME * max(abs(asked[0]), abs(asked[1]))
    if given[0] < asked[0] - slack or given[1] > asked[1] + slack:
        limits = f"{asked[0]:.6g} to {asked[1]:.6g}"
        table.fault(
            name,
            table.table.get(name),
            f"goes beyond {name} of the [specification], {limits}, where nothing is promised",
            "Take a part of that range, or widen the specification.",
        )
