"""Reads the [verification] section: the random cases with which the promises of a controller are tested in EMT."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from vsgdesign.equations.grid import MOST_ERROR_Z, SCR_BASES
from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.ranges import Drawn, Range, read_range
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.source import GridSource
from vsgdesign.parameters.specification import Specification

DEFAULT_SCR, DEFAULT_X_OVER_R = (1.2, 20.0), (0.3, 20.0)
"""Grids where neither a specification nor the axes of the margin maps say which."""

DEFAULT_P, DEFAULT_Q = 0.9, 0.3
"""The same for the powers: ± these shares of S_rated."""

FAMILIES = ("step", "grid", "phase", "sag", "ramp", "reference")
"""The kinds of disturbance, in the order of their numbers."""

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


@dataclass(frozen=True, kw_only=True)
class VerificationSpec:
    """What is drawn, how often, and how sure the answer has to be."""

    runs: int
    confidence: float
    """Probability with which the stated bound on the share of broken promises holds."""
    seed: int
    with_run: int
    """With how many cases `vsgdesign run` verifies each gain table; 0: it does not."""
    box: CaseBox
    silent_s: Range
    """For how long a schedule is told nothing after each change of the grid or its source, s."""
    families: Mapping[str, CaseFamily] = field(hash=False)
    """By name, in the order of :data:`FAMILIES`."""
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

_SILENT = Drawn("silent", "s", 0.0, 100.0, logarithmic=True)
_SILENT_DEFAULT = (0.02, 1.0)


def _quantities(f_n: float) -> dict[str, tuple[tuple[Drawn, Range | None], ...]]:
    """What is drawn for each family besides the box, and its default range."""
    angle, sixty = (0.0, math.pi), (0.0, math.radians(60.0))
    return {
        "step": ((Drawn("size", "1", 1e-4, 1.0), (0.05, 0.05)),),
        "grid": ((Drawn("phase", "rad", *angle), None),),
        "phase": ((Drawn("jump", "rad", *angle), sixty),),
        "sag": (
            (Drawn("depth", "1", 0.0, 1.0), (0.2, 1.0)),
            (Drawn("duration", "s", 0.01, 10.0, logarithmic=True), (0.05, 1.0)),
            (Drawn("phase", "rad", *angle), sixty),
        ),
        "ramp": (
            (Drawn("size", "Hz", 1e-3, 0.1 * f_n), (0.1, 1.0)),
            (Drawn("rate", "Hz/s", 1e-2, 100.0, logarithmic=True), (0.5, 4.0)),
            (Drawn("hold", "s", 0.0, 10.0), (0.0, 1.0)),
        ),
        "reference": (),
    }


def read_verification(
    table: TableReader | None,
    converter: Converter,
    source: GridSource,
    specification: Specification | None,
    maps: Mapping[str, tuple[float, ...]],
    scr_basis: str,
) -> VerificationSpec:
    """The section, or its defaults. ``maps``: the axes ``scr``, ``x_over_r``, ``P`` and ``Q`` that [stability] gives
    (those that it does not give are absent)."""
    table = table or TableReader({}, "verification", [])
    spec = VerificationSpec(
        runs=table.integer("runs", 1, 1_000_000_000, default=100_000),
        confidence=table.quantity("confidence", "1", 0.5, 0.999999, default=0.99),
        seed=table.integer("seed", 0, 2**31 - 1, default=1),
        with_run=table.integer("with_run", 0, 1_000_000_000, default=0),
        box=_read_box(table, converter, source, specification, maps, scr_basis),
        silent_s=read_range(table, _SILENT, _SILENT_DEFAULT),
        families=_read_families(table, converter.omega_n / (2.0 * math.pi)),
        given=frozenset(
            name for name in ("scr", "x_over_r", "P", "Q", "error_R", "error_X", "error_Z") if table.has(name)
        ),
    )
    table.finish()
    return spec


def _read_families(table: TableReader, f_n: float) -> dict[str, CaseFamily]:
    found = {}
    quantities = _quantities(f_n)
    for name in FAMILIES:
        own = table.child(name) or TableReader({}, table.name(name), table.faults)
        weight = own.quantity("weight", "1", 0.0, 1e6, default=None)
        found[name] = CaseFamily(weight, {one.name: _range_or(own, one, default) for one, default in quantities[name]})
        if weight == 0.0 and len(own.table) > 1:
            own.fault("weight", 0, "the family is never drawn, and its other fields have no effect", "Leave them out.")
        own.finish()
    by_default = any(found[name].weight is None for name in (*_ALWAYS, *_WITH_LIMITER))
    if not by_default and not any(family.weight for family in found.values()):
        table.fault("", None, "no family has a weight above zero", "Give one, as in [verification.step] weight = 1.")
    return found


def _range_or(table: TableReader, quantity: Drawn, default: Range | None) -> Range | None:
    """The range that is given, else the default. Names are read in any case, so that they are known."""
    found = read_range(table, quantity, (math.nan, math.nan) if default is None else default)
    return default if not table.has(quantity.name) else found


def _read_box(
    table: TableReader,
    converter: Converter,
    source: GridSource,
    specification: Specification | None,
    maps: Mapping[str, tuple[float, ...]],
    scr_basis: str,
) -> CaseBox:
    c, limit, f_n = converter, 2.0 * converter.S_rated, converter.omega_n / (2.0 * math.pi)
    defaults = _of_study(converter, source, maps) if specification is None else _of_specification(specification, c)
    basis = scr_basis if specification is None else specification.scr_basis
    asked = {name: (values[0], values[-1]) for name, values in defaults.items()}
    drawn = {
        "scr": Drawn("scr", "1", 0.05, 1e4, logarithmic=True),
        "x_over_r": Drawn("x_over_r", "1", 1e-3, 1e4, logarithmic=True),
        "P": Drawn("P", "W", -limit, limit),
        "Q": Drawn("Q", "var", -limit, limit),
        "V_g_pu": Drawn("V_g_pu", "1", 0.5, 1.5),
        "f_g": Drawn("f_g", "Hz", 0.8 * f_n, 1.2 * f_n),
    }
    read = {name: read_range(table, one, asked[name]) for name, one in drawn.items()}
    basis = table.choice("scr_basis", tuple(SCR_BASES), default=basis)
    if specification is not None:
        if basis != specification.scr_basis:
            table.fault(
                "scr_basis",
                basis,
                f"the [specification] has {specification.scr_basis}",
                "Leave it out, or give both the same.",
            )
        for name in drawn:
            _check_inside(table, name, read[name], asked[name], f"{name} of the [specification]")
    of_specification = (0.0, 0.0, 0.0) if specification is None else specification.box.errors
    errors = []
    for name, most, default in zip(
        ("error_R", "error_X", "error_Z"), (0.9, 0.9, MOST_ERROR_Z), of_specification, strict=True
    ):
        errors.append(table.quantity(name, "1", 0.0, most, default=default))
        if specification is not None:
            _check_inside(table, name, (0.0, errors[-1]), (0.0, default), f"{name} of the [specification]")
    share = math.sin(math.atan(read["x_over_r"][0]))
    if errors[2] >= share:
        problem = f"leaves no inductance in an estimate at X/R {read['x_over_r'][0]:g}: must be less than {share:.3g}"
        table.fault("error_Z", errors[2], problem, "Begin x_over_r higher, or ask for less.")
    return CaseBox(
        scr_basis=basis,
        scr=read["scr"],
        x_over_r=read["x_over_r"],
        P=read["P"],
        Q=read["Q"],
        V_g_rms=_scaled(read["V_g_pu"], c.V_rated_rms),
        omega_g=_scaled(read["f_g"], 2.0 * math.pi),
        errors=(errors[0], errors[1], errors[2]),
    )


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


def _check_inside(table: TableReader, name: str, given: Range, asked: Range, where: str) -> None:
    """A fault where a range goes beyond what the specification asks for: nothing is promised there."""
    slack = _SAME * max(abs(asked[0]), abs(asked[1]))
    if given[0] < asked[0] - slack or given[1] > asked[1] + slack:
        limits = f"{asked[0]:.6g} to {asked[1]:.6g}"
        table.fault(
            name,
            table.table.get(name),
            f"goes beyond {where}, {limits}, where nothing is promised",
            "Take a part of that range, or widen the specification.",
        )


def _scaled(ends: Range, factor: float) -> Range:
    return factor * ends[0], factor * ends[1]


__all__ = ["FAMILIES", "CaseBox", "CaseFamily", "VerificationSpec", "read_verification"]
