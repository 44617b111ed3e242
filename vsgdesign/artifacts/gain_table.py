"""The gain table: what a design hands to a runtime and to a reviewer, as data."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.artifacts.certificate_record import CertificateRecord
from vsgdesign.artifacts.definitions import NAMES_OF_BEFORE
from vsgdesign.artifacts.design_inputs import design_hash
from vsgdesign.artifacts.files import plain, sorted_plain
from vsgdesign.artifacts.guarded_file import content_hash
from vsgdesign.equations.power_flow import Lags
from vsgdesign.equations.power_loops import PowerLoopGains

if TYPE_CHECKING:  # reading a table reads no study files
    from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

KIND = "vsgdesign gain table"
SCHEMA = 3

COLUMNS = {
    "poles": ("k_1", "d_1", "k_2", "q", "share_P", "share_Q"),
    "inertia": ("H", "zeta", "k_2", "q", "share_P", "share_Q"),
}
"""Normalised columns by law. q (D_q = q·D) is the published structure's alone, zero in the others."""

RATES = {"k_1": 2, "d_1": 1, "k_2": 1}
"""Power of the time scale that makes a column dimensionless; columns that are not here are stored as they are."""


_DOCUMENTS = "specification", "provenance", "inputs", "design_inputs"


@dataclass(frozen=True, kw_only=True)
class TableBase:
    """The system for which the table is made: the converter's rating and filter, the source, the basis of its SCR
    axis."""

    S_rated: float
    """VA."""
    V_rated_rms: float
    """Phase to neutral, V."""
    omega_n: float
    """Nominal angular frequency, rad/s."""
    V_g_rms: float
    """Grid source that the design point is solved with, V."""
    R_2: float = 0.0
    L_2: float = 0.0
    """Grid-side inductor, part of the path between control point and source: Ω, H."""
    scr_basis: str = "impedance"
    """``impedance`` or ``reactance``."""
    tau_P: float = 0.0
    tau_Q: float = 0.0
    """Time constants of the power filters that the margins are taken with, s; with the delay of a notch, if there is
    one."""
    R_t: float = 0.0
    X_t: float = 0.0
    omega_t: float = 0.0
    """Transient impedance, Ω, and its corner, rad/s. A table that was made without one in its model has zeros."""

    def __post_init__(self) -> None:
        _to_floats(self)

    @property
    def lags(self) -> Lags:
        """What stands between the power loops and the power flow."""
        return Lags(*(getattr(self, name) for name in Lags._fields))


@dataclass(frozen=True)
class ValidityBox:
    """Where the table's promises hold, each as (least, largest): SCR on the table's basis, X/R, P (W), Q (var),
    V (phase rms, V). ``error``: relative error of R̂ and of X̂, each anywhere within ± it; ``error_Z``: the error of
    each relative to \\|Z\\|. The larger of the two counts (:eq:`error-set`)."""

    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    P: tuple[float, float]
    Q: tuple[float, float]
    V_rms: tuple[float, float]
    error: float = 0.0
    error_Z: float = 0.0

    def __post_init__(self) -> None:
        _to_floats(self)


@dataclass(frozen=True, eq=False, kw_only=True)
class GainTable:
    """Gains over SCR (n rows) × X/R (m columns). Two tables are equal where their ``sha256`` is.

    Everything per cell is (n, m). Arrays may be given as nested lists; they become read-only. Nothing is judged
    here: ``write_table_file`` and ``read_table_file`` of :mod:`vsgdesign.artifacts.gain_table_file` refuse what is
    not a table.

    A cell is ``met`` (every promise of the specification holds), ``relaxed`` (the best there is, some promise
    given up) or ``outside`` (no operating point there, or outside the static limits). ``columns`` has a number in
    every cell, also outside (:func:`fill_outside`), because cells beside a border are interpolated with their
    neighbours. ``gains`` (all eight) are NaN where the design point has no operating point, ``price`` may be NaN
    outside, and a margin wherever it is not known.
    """

    name: str
    structure: str
    """A name of equations.structures.STRUCTURES."""
    law: str
    """``poles``: k_1, d_1 are columns. ``inertia``: H (s) and zeta are, k_1 and d_1 follow from them."""
    study: str
    """Name of the study it was designed for."""
    study_hash: str
    """Content hash of that study's document, for information: it changes with every title and event."""
    base: TableBase
    D_p: float
    """P–f droop, W·s/rad; the angle-damped structure's alone, 0 in the others."""
    D_q: float
    """Q–V droop, var/V (rms); 0 in the published structure, whose droop is q·D."""
    P_design: float
    Q_design: float
    """Operating point of ``gains``, W and var."""
    time_scale: float
    """Seconds; the specification's settling time. 1 where there is none: then numbers are those in SI."""
    scr: Array
    """(n,), strictly increasing."""
    x_over_r: Array
    """(m,), strictly increasing."""
    columns: dict[str, Array]
    """Dimensionless normalised columns of the law, COLUMNS: k_1·T², d_1·T, k_2·T with T the time scale; H in s."""
    gains: PowerLoopGains
    """SI gains at the design point and the exact grid, eight arrays."""
    status: NDArray[np.str_]
    """``met``, ``relaxed`` or ``outside``."""
    active: NDArray[np.str_]
    """Which constraint stops the design from being better; empty where none or outside."""
    price: Array
    """Cost of the active constraint, ≥ 0, in the unit of the objective."""
    margins: dict[str, Array] = field(default_factory=dict)
    """Figures per cell. Names of docs/gain-table-file.md are understood (checked, drawn); others are carried."""
    specification: dict[str, Any] = field(default_factory=dict)
    validity: ValidityBox
    certificate: CertificateRecord | None = None
    """The proof over its box, or the reason why there is none. None if no proof was tried."""
    provenance: dict[str, str] = field(default_factory=dict)
    """Versions of what made it."""
    inputs: dict[str, str] = field(default_factory=dict)
    """Hashes of what it was made from, by name."""
    design_inputs: dict[str, Any] = field(default_factory=dict)
    """The inputs of its design (:mod:`vsgdesign.artifacts.design_inputs`). They are empty for a table made by hand."""
    between: dict[str, Any] | None = None
    """The result of the last check between the nodes: ``points``, ``outside``, ``promised``, ``seed`` and
    ``broken``; with a battery on the dc link ``link``, the charges and the voltages over which its nodes are judged."""
    causes: list[dict[str, Any]] = field(default_factory=list)
    """The reasons why relaxed cells give up a promise (:mod:`vsgdesign.design.table`)."""
    safe_place: tuple[float, float] | None = None
    """SCR on the table's basis and X/R of the place at which a schedule waits without estimates (:eq:`safe-place`).
    None: that of the structure in the box (:func:`vsgdesign.runtime.guards.safe_scr`)."""
    verification: dict[str, Any] | None = None
    """What random cases in EMT showed (:func:`vsgdesign.artifacts.gain_table_file.verification_record`); None: none
    were simulated."""
    full_order: dict[str, Any] | None = None
    """What was proved of the sampled full-order loop (:class:`vsgdesign.certificate.FullOrderProof`); None: nothing was
    tried."""

    def __post_init__(self) -> None:
        for name, kind in (("scr", float), ("x_over_r", float), ("price", float), ("status", str), ("active", str)):
            object.__setattr__(self, name, _fixed(getattr(self, name), kind))
        order = COLUMNS.get(self.law, ())
        columns = sorted(self.columns.items(), key=lambda item: order.index(item[0]) if item[0] in order else 99)
        object.__setattr__(self, "columns", {name: _fixed(values) for name, values in columns})
        object.__setattr__(self, "margins", {name: _fixed(self.margins[name]) for name in sorted(self.margins)})
        object.__setattr__(self, "gains", PowerLoopGains(*(_fixed(value) for value in self.gains)))
        for name in (*_DOCUMENTS, "between", "causes", "verification", "full_order"):
            object.__setattr__(self, name, sorted_plain(getattr(self, name)))
        _to_floats(self)

    def __eq__(self, other: object) -> bool:
        return self.sha256 == other.sha256 if isinstance(other, GainTable) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.sha256)

    @property
    def shape(self) -> tuple[int, int]:
        """Lengths of the SCR and X/R axes."""
        return len(self.scr), len(self.x_over_r)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(n, m), which cells are a design: not outside."""
        return self.status != "outside"

    @property
    def parameters(self) -> dict[str, Array]:
        """The columns in SI: k_1 in 1/s², d_1 and k_2 in 1/s, H in s."""
        return from_dimensionless(self.columns, self.time_scale)

    @property
    def design_hash(self) -> str:
        """Over what the design depended on; empty where the table does not keep that."""
        return design_hash(self.design_inputs)

    @property
    def figures(self) -> dict[str, Array]:
        """The margins, whichever version wrote them, by the names of
        :data:`vsgdesign.artifacts.definitions.DEFINITIONS`."""
        return {NAMES_OF_BEFORE.get(name, name): values for name, values in self.margins.items()}

    @property
    def sha256(self) -> str:
        """Over the canonical JSON of everything in the file but itself."""
        return content_hash(table_document(self))

    def around(self, scr: float, x_over_r: float) -> tuple[list[int], list[int]]:
        """Rows and columns of the nodes between which a grid lies; of the last ones beyond the table's edge."""
        pairs = ((self.scr, scr), (self.x_over_r, x_over_r))
        ends = (int(np.clip(np.searchsorted(axis, at), 1, len(axis) - 1)) for axis, at in pairs)
        rows, columns = ([k - 1, k] for k in ends)
        return rows, columns


def base_of(study: Study, scr_basis: str | None = None) -> TableBase:
    """The base of a table for a study's converter; ``scr_basis``: of the table's axis, if not the study's."""
    c, f = study.converter, study.filter
    return TableBase(
        S_rated=c.S_rated,
        V_rated_rms=c.V_rated_rms,
        omega_n=c.omega_n,
        V_g_rms=study.grid_source.V_g_rms,
        R_2=f.R_2,
        L_2=f.L_2,
        scr_basis=scr_basis or study.scr_basis,
        **study.power_lags._asdict(),
    )


def base_differences(base: TableBase, other: TableBase, name: str) -> list[str]:
    """Fields in which two bases differ, a sentence each; ``name`` says whose the other is. What the other does not know
    yet (NaN: of inner loops that are not designed) does not differ."""
    found = []
    for f in fields(TableBase):
        mine, its = getattr(base, f.name), getattr(other, f.name)
        if not (mine == its or (isinstance(mine, float) and (its != its or abs(mine - its) <= 1e-12 * abs(mine)))):
            found.append(f"base.{f.name} is {mine}, {name} has {its}")
    return found


def to_dimensionless(parameters: dict[str, Array], time_scale: float) -> dict[str, Array]:
    """Columns for :class:`GainTable` from normalised parameters in SI (k_1 in 1/s², d_1 and k_2 in 1/s)."""
    return {name: np.asarray(values) * time_scale ** RATES.get(name, 0) for name, values in parameters.items()}


def from_dimensionless(columns: dict[str, Array], time_scale: float) -> dict[str, Array]:
    """The inverse of :func:`to_dimensionless`."""
    return {name: np.asarray(values) / time_scale ** RATES.get(name, 0) for name, values in columns.items()}


def fill_outside(values: ArrayLike, valid: ArrayLike) -> Array:
    """(n, m) values with every cell that is not valid taking those of the nearest valid one.

    Nearest in steps along the axes; of equally near ones the stronger grid (larger SCR, then larger X/R), since
    a schedule made for a stronger grid is the safe side. Raises ValueError where no cell is valid.
    """
    values, mask = np.array(values, dtype=float), np.asarray(valid, dtype=bool)
    known = np.argwhere(mask)
    if len(known) == 0:
        raise ValueError("no cell is valid: there is nothing to fill the others with")
    for i, j in np.argwhere(~mask):
        distance = np.abs(known - (i, j)).sum(axis=1)
        nearest = np.lexsort((-known[:, 1], -known[:, 0], distance))[0]
        values[i, j] = values[tuple(known[nearest])]
    return values


def table_document(table: GainTable) -> dict[str, Any]:
    """The table in JSON's types, as its file has it, without the sha256."""
    plainly = {f.name: getattr(table, f.name) for f in fields(GainTable)}
    plainly |= {name: dict(vars(plainly[name])) for name in ("base", "validity")}
    if table.validity.error_Z == 0.0:  # a file from before there was such an error keeps its bytes and its hash
        del plainly["validity"]["error_Z"]
    if not table.base.lags.yields:  # the same of one without a transient impedance
        for name in ("R_t", "X_t", "omega_t"):
            del plainly["base"][name]
    if table.verification is None:  # the same of one from before tables were verified
        del plainly["verification"]
    if table.full_order is None:  # the same of one without a full-order proof
        del plainly["full_order"]
    if table.safe_place is None:  # and of one from before a safe place was searched
        del plainly["safe_place"]
    plainly["gains"] = plainly["gains"]._asdict()
    plainly["certificate"] = None if table.certificate is None else table.certificate.document
    for name in ("columns", "gains", "margins"):
        plainly[name] = {key: values.tolist() for key, values in plainly[name].items()}
    for name in ("scr", "x_over_r", "status", "active", "price"):
        plainly[name] = plainly[name].tolist()
    return plain({"kind": KIND, "schema": SCHEMA} | plainly)


def _to_floats(instance: Any) -> None:
    """Integers and NumPy scalars in a frozen instance's fields, also in pairs, become floats: equal is equal."""
    for name, value in vars(instance).items():
        if isinstance(value, tuple) and not hasattr(value, "_fields"):
            object.__setattr__(instance, name, tuple(_number(item) for item in value))
        else:
            object.__setattr__(instance, name, _number(value))


def _number(value: Any) -> Any:
    return float(value) if isinstance(value, Real) and not isinstance(value, bool) else value


def _fixed(values: ArrayLike, kind: type = float) -> NDArray[Any]:
    array = np.array(values, dtype=kind)
    array.flags.writeable = False
    return array
