"""What a proof over grids, powers and estimate errors found, and the steps for which no limit acts, as a gain table
keeps them: data read from its document."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from vsgdesign.artifacts.files import plain, sorted_plain
from vsgdesign.artifacts.guarded_file import is_number

Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class StaticLimits:
    """Between which limits an operating point has to rest (:eq:`static-limits`): V, current and bridge voltage in per
    unit of the rated voltage and current, and how many times its apparent power the grid has to carry.

    None: there is no such limit. A certificate of before they were kept knew those of V and of the grid alone.
    """

    V_low: float | None = None
    V_high: float | None = None
    power_transfer: float | None = None
    current: float | None = None
    bridge_voltage: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The limits that there are, as they are called."""
        found = ["V"] if self.V_low is not None or self.V_high is not None else []
        named = {"power transfer": self.power_transfer, "current": self.current, "bridge voltage": self.bridge_voltage}
        return (*found, *(name for name, value in named.items() if value is not None))


OF_BEFORE = ("V", "power transfer")
"""Names of the static limits of a certificate that does not keep them: they were the only ones until version 0.2."""


@dataclass(frozen=True, kw_only=True)
class CertificateRegion:
    """Where the proof was sought, each as (least, largest): SCR on the table's basis, X/R, P (W), Q (var).

    None: the document does not say. ``error``: relative, of R_g and of L_g; ``error_Z``: of each, relative to
    \\|Z_g\\|, where that is more. ``rate``: largest \\|d ln SCR/dt\\| and
    \\|d ln(X/R)/dt\\| in 1/s; infinite: the grid may jump.
    """

    scr: Pair | None = None
    x_over_r: Pair | None = None
    P: Pair | None = None
    Q: Pair | None = None
    error: float | None = None
    error_Z: float = 0.0
    rate: float = math.inf
    limits: StaticLimits | None = None
    """Static limits within which it was sought; None: those that OF_BEFORE names."""

    @property
    def limit_names(self) -> tuple[str, ...]:
        """How the static limits are called within which the proof was sought."""
        return OF_BEFORE if self.limits is None else self.limits.names


@dataclass(frozen=True, kw_only=True)
class CertificateCell:
    """The one point that a failed proof names: a counterexample with its ``eigenvalue`` (1/s), or the slowest cell
    with its ``decay`` (1/s). P in W, Q in var, relative errors of R_g and L_g."""

    scr: float
    x_over_r: float
    P: float
    Q: float
    error_R: float
    error_L: float
    decay: float | None = None
    eigenvalue: complex | None = None

    @property
    def is_unstable(self) -> bool:
        """Whether it is a counterexample."""
        return self.eigenvalue is not None


@dataclass(frozen=True, kw_only=True)
class CertificateRecord:
    """A certificate, a counterexample, or why there is neither. Who needs the result of a proof reads this."""

    certified: bool
    """False: a proof was sought and not found."""
    region: CertificateRegion
    decay: float | None = None
    """1/s at which one Lyapunov function decays over the region; None where nothing is proved, or it is not said."""
    proof: str | None = None
    """``gap-free`` (every point of the region) or ``gridded`` (cells and random points); None where it is not said."""
    gap_share: float | None = None
    """Of the region's volume, what a gridded proof leaves open between its points."""
    points: int | None = None
    """Cells and random points at which eigenvalues verified the inequality."""
    cell: CertificateCell | None = None
    """Of a failed proof."""
    reason: str | None = None
    """Of a failed proof without a counterexample."""
    places: int | None = None
    """How many parts of the grids have a function of their own; None: one function for all."""
    move: tuple[float, float] | None = None
    """By how much a move of the grid between two places multiplies the function at most, and the time in s between two
    moves from which on it falls."""
    differential: CertificateRecord | None = None
    """The same of equal units against each other; None where there are none, or it was not sought."""
    steps: StepStatement | None = None
    """Where no limit acts; None where the document does not say."""
    document: Mapping[str, Any] = field(repr=False)
    """The whole in JSON's types, as the table's file has it: also the matrices, which nobody reads here."""


def certificate_record(document: Any) -> CertificateRecord:
    """The record of a document: of :meth:`vsgdesign.certificate.Certificate.as_document` and its kin, or of a file.

    What the document does not say is None; other keys are carried. Raises ValueError with every fault.
    """
    if not isinstance(document, Mapping):
        raise ValueError("certificate: must be a table of names and values, or null")
    reader = _Reader(sorted_plain(document))
    region = reader.table("region")
    # The rate may also stand beside the region.
    rate = region.number("rate") if "rate" in region.document else reader.number("rate")
    certified, gap = reader.document.get("certified") is not False, reader.table("gap")
    counts = [count for name in ("checked", "fresh") if (count := reader.count(name)) is not None]
    record = CertificateRecord(
        certified=certified,
        region=CertificateRegion(
            scr=region.pair("scr"),
            x_over_r=region.pair("x_over_r"),
            P=region.pair("P"),
            Q=region.pair("Q"),
            error=region.number("error"),
            error_Z=region.number("error_Z") or 0.0,
            rate=math.inf if rate is None else rate,
            limits=_static_limits(reader),
        ),
        decay=reader.number("decay"),
        proof=reader.text("proof"),
        gap_share=gap.number("share"),
        points=sum(counts) if counts else None,
        cell=None if certified else _cell(reader),
        reason=reader.text("reason"),
        places=_places(reader),
        move=_move(reader),
        differential=_part(reader, "differential", certificate_record),
        steps=_part(reader, "steps", step_statement),
        document=reader.document,
    )
    if reader.faults:
        raise ValueError("; ".join(reader.faults))
    return record


def _static_limits(reader: _Reader) -> StaticLimits | None:
    if "static_limits" not in reader.document:
        return None
    limits, known = reader.table("static_limits"), tuple(StaticLimits.__dataclass_fields__)
    for name in limits.document.keys() - set(known):
        limits.fault(name, "is not a static limit")
    return StaticLimits(**{name: limits.number(name) for name in known})


def _places(reader: _Reader) -> int | None:
    value = reader.document.get("places")
    if value is None or (isinstance(value, list) and value):
        return None if value is None else len(value)
    return reader.fault("places", "must be a list")


def _move(reader: _Reader) -> tuple[float, float] | None:
    if reader.document.get("move") is None:
        return None
    factor, dwell_s = _needed(reader.table("move"), ("factor", "dwell_s"))
    return factor, dwell_s


def _part(reader: _Reader, name: str, read: Callable[[dict[str, Any]], Any]) -> Any:
    """A part with a reader of its own; None where there is none."""
    if reader.document.get(name) is None:
        return None
    try:
        return read(reader.document[name])
    except ValueError as error:
        return reader.fault(name, str(error))


class _Reader:
    """Values of a table by name; everything that is not what it should be is kept as a fault."""

    def __init__(self, document: dict[str, Any], path: str = "certificate", faults: list[str] | None = None) -> None:
        self.document, self._path = document, path
        self.faults: list[str] = [] if faults is None else faults

    def table(self, name: str) -> _Reader:
        value = self.document.get(name)
        if value is not None and not isinstance(value, dict):
            self.fault(name, "must be a table of names and values")
        return _Reader(value if isinstance(value, dict) else {}, f"{self._path}.{name}", self.faults)

    def number(self, name: str) -> float | None:
        value = self.document.get(name)
        if value is None or is_number(value):
            return None if value is None else float(value)
        return self.fault(name, "must be a number")

    def count(self, name: str) -> int | None:
        value = self.document.get(name)
        if value is None or (type(value) is int and value >= 0):
            return value
        return self.fault(name, "must be a whole number")

    def text(self, name: str) -> str | None:
        value = self.document.get(name)
        return value if value is None or isinstance(value, str) else self.fault(name, "must be text")

    def pair(self, name: str) -> Pair | None:
        value = self.document.get(name)
        if value is None:
            return None
        if isinstance(value, list) and len(value) == 2 and all(map(is_number, value)) and value[0] <= value[1]:
            return float(value[0]), float(value[1])
        return self.fault(name, "must be two numbers, the smaller first")

    def fault(self, name: str, problem: str) -> None:
        self.faults.append(f"{self._path}.{name}: {problem}")


_POINT = ("scr", "x_over_r", "P", "Q", "error_R", "error_L")


def _cell(reader: _Reader) -> CertificateCell | None:
    """A counterexample is told at the top, the slowest cell in a table of its own."""
    if "eigenvalue" in reader.document:
        eigenvalue, source = reader.table("eigenvalue"), reader
        real, imag = _needed(eigenvalue, ("real", "imag"))
        return CertificateCell(
            **dict(zip(_POINT, _needed(source, _POINT), strict=True)), eigenvalue=complex(real, imag)
        )
    if reader.document.get("slowest") is None:
        return None
    names = (*_POINT, "decay")
    return CertificateCell(**dict(zip(names, _needed(reader.table("slowest"), names), strict=True)))


def _needed(reader: _Reader, names: tuple[str, ...]) -> list[float]:
    """Numbers that have to be there; NaN, and a fault, for those that are not."""
    for name in names:
        if reader.document.get(name) is None:
            reader.fault(name, "is missing")
    values = [reader.number(name) for name in names]
    return [math.nan if value is None else value for value in values]


_LEAST_ROOM = 0.02
"""Share of the current limit that a rest has to leave: with less, no step is worth a claim."""


def no_room(rest_pu: float | None, limit_pu: float | None) -> bool:
    """Whether the current at rest leaves no room for a step. Both are per unit; a limit of None is none."""
    return rest_pu is not None and limit_pu is not None and rest_pu > (1.0 - _LEAST_ROOM) * limit_pu


@dataclass(frozen=True, kw_only=True)
class StepRow:
    """The largest step of each kind, alone, to an operating point within limits of SCR, P (W) and Q (var).

    The steps are None where none is possible.
    """

    scr: Pair
    P: Pair
    Q: Pair
    rest_current_pu: float | None
    """Largest converter current at rest that was seen, pu of the rated one. None: there is no operating point."""
    proof: str
    """``gap-free``: at every point; ``gridded``: at points, with a margin."""
    P_ref: float | None = None
    """W."""
    Q_ref: float | None = None
    """var."""
    phase: float | None = None
    """Jump of the grid's phase, rad."""
    V_g: float | None = None
    """V, phase rms."""
    omega_g: float | None = None
    """rad/s."""

    @property
    def possible(self) -> bool:
        """Whether there is a step for which no limit acts."""
        return self.P_ref is not None


@dataclass(frozen=True, kw_only=True)
class StepStatement:
    """Where no limit acts: the limits, the function whose sublevel sets stay clear of them, and the steps."""

    limiter: str
    """Name of the current limiter."""
    current_pu: float | None
    """Current at which it begins to act; None: there is no limit of the current."""
    soft: bool
    """Whether that is the limiter's soft limit."""
    V_low_pu: float | None
    V_high_pu: float | None
    """Between which V has to stay; None: V is free."""
    clips_V: bool
    """Whether the limiter clips V at the two voltages."""
    decay: float | None = None
    """Decay rate of the function, 1/s; None where there is none."""
    P: tuple[tuple[float, ...], ...] = ()
    """Its matrix over the scaled states of the certificate."""
    proof: str = "gridded"
    """How the decay is proved: ``gap-free`` or ``gridded``."""
    rows: tuple[StepRow, ...] = ()
    reason: str | None = None
    """Why there are no rows."""

    def as_document(self) -> dict[str, Any]:
        """JSON's types."""
        return plain({**vars(self), "rows": [vars(row) for row in self.rows]})


_TEXTS = ("limiter", "proof", "reason")
_TRUTHS = ("soft", "clips_V")
_PAIRS = ("scr", "P", "Q")


def step_statement(document: Any) -> StepStatement:
    """The statement of a document. Raises ValueError where it is none."""
    try:
        rows = tuple(StepRow(**_checked(row, _PAIRS)) for row in document["rows"])
        matrix = tuple(tuple(float(value) for value in row) for row in document["P"])
        rest = {name: value for name, value in document.items() if name not in ("rows", "P")}
        return StepStatement(**_checked(rest, ()), rows=rows, P=matrix)
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise ValueError(f"is not what certify writes ({error})") from error


def _checked(values: dict[str, Any], pairs: tuple[str, ...]) -> dict[str, Any]:
    """Values of the right kinds, lists as tuples. Raises ValueError."""
    found = {}
    for name, value in values.items():
        if name in pairs:
            low, high = value
            good, value = is_number(low) and is_number(high), (low, high)
        elif name in _TEXTS:
            good = value is None or isinstance(value, str)
        elif name in _TRUTHS:
            good = isinstance(value, bool)
        else:
            good = value is None or is_number(value)
        if not good:
            raise ValueError(f"{name}: {value!r}")
        found[name] = value
    return found
