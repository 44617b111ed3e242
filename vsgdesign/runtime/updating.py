"""One update of the scheduler on plain floats: :mod:`vsgdesign.equations.scheduling` with the data of a lookup, which
is that of a schedule, and how the state is saved and restored."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.frames import base_impedance
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import (
    NO_DESIGN,
    ScheduleLaw,
    SchedulerInput,
    SchedulerState,
    ScheduleTable,
    gains_at,
    grid_at,
    normalised_at,
    place_of,
)
from vsgdesign.equations.scheduling import begun, told_state, updated
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime.guards import REASONS, SchedulerSettings
from vsgdesign.runtime.schedule import ClosedFormSchedule, on_floats
from vsgdesign.runtime.table import TableSchedule

_OUTSIDE = NO_DESIGN, 0.0, 0.0, 0.0, 0.0, 0.0
_MOST_KEPT = 32
_place_of, _grid_at = on_floats(place_of), on_floats(grid_at)
_normalised_at, _gains_at = on_floats(normalised_at), on_floats(gains_at)


@dataclass(frozen=True, eq=False, kw_only=True)
class GainLookup:
    """A schedule as a table over SCR and R/X. Made by :func:`gain_lookup`."""

    scr: tuple[float, ...]
    r_over_x: tuple[float, ...]
    nodes: tuple[tuple[tuple[float, ...] | None, ...], ...]
    """n × m nodes: NormalisedGains in SI, None where there is no design."""
    Z_base: float
    scr_basis: str
    omega: float
    R_2: float
    L_2: float
    structure: str
    law: str
    S_rated: float
    D_p: float
    D_q: float
    V_n_rms: float
    """Voltage that is assumed before the first measurement, V."""

    @cached_property
    def table(self) -> ScheduleTable:
        """The table as the equations take it."""
        nodes = [node or _OUTSIDE for row in self.nodes for node in row]
        return ScheduleTable(
            scr=self.scr,
            r_over_x=self.r_over_x,
            nodes=tuple(number for node in nodes for number in node),
            Z_base=self.Z_base,
            omega=self.omega,
            R_2=self.R_2,
            L_2=self.L_2,
            S_rated=self.S_rated,
            D_p=self.D_p,
            D_q=self.D_q,
            V_n=self.V_n_rms,
        )

    @cached_property
    def functions(self) -> ScheduleLaw:
        """The functions of the SCR's basis and of the structure."""
        basis = SCR_BASES[self.scr_basis]
        gains = STRUCTURES[self.structure].gains
        return ScheduleLaw(basis.scr, basis.grid, normalised_at, gains, self.law == "inertia")

    @cached_property
    def functions_of_floats(self) -> ScheduleLaw:
        """The same functions for plain floats. They remember their last results: a schedule mostly stays where it
        was."""
        law, table = self.functions, self.table
        found = lru_cache(_MOST_KEPT)(partial(_normalised_at, table))

        def normalised(_: ScheduleTable, scr: float, r_over_x: float) -> tuple[NormalisedGains, int]:
            return found(scr, r_over_x)

        scr, grid = (lru_cache(_MOST_KEPT)(on_floats(function)) for function in (law.scr, law.grid))
        return ScheduleLaw(scr, grid, normalised, on_floats(law.gains), law.by_inertia)

    def grid(self, scr: float, r_over_x: float) -> tuple[float, float]:
        """R_g (Ω) and L_g (H) of a place (:eq:`scr`)."""
        return _grid_at(self.table, scr, r_over_x, self.functions_of_floats)

    def coordinates(self, R_g: float, L_g: float) -> tuple[float, float]:
        """SCR on the table's basis and R/X of a grid with R_g (Ω) and L_g > 0 (H) (:eq:`scr`)."""
        return _place_of(self.table, R_g, L_g, self.functions_of_floats)

    def normalised(self, scr: float, r_over_x: float) -> NormalisedGains | None:
        """Normalised parameters (:eq:`bilinear`). The result is None where a node with a weight has no design."""
        normalised, designed = _normalised_at(self.table, scr, r_over_x)
        return normalised if designed else None

    def gains(
        self, normalised: NormalisedGains, scr: float, r_over_x: float, P: float, Q: float, V_rms: float
    ) -> PowerLoopGains:
        """Gains on the grid of a place at measured powers and voltage (:eq:`structure-gains`)."""
        return _gains_at(self.table, normalised, scr, r_over_x, P, Q, V_rms, self.functions_of_floats)


def gain_lookup(
    schedule: TableSchedule | ClosedFormSchedule, *, V_n_rms: float, S_rated: float = 0.0, scr_basis: str = "impedance"
) -> GainLookup:
    """The lookup of a table's schedule, or of a closed form as a table of one node.

    ``S_rated`` (VA) and ``scr_basis`` define the SCR of a closed form; a table has its own. V_n_rms is the nominal
    voltage in V.
    """
    if isinstance(schedule, TableSchedule):
        scr, r_over_x, Z_base, scr_basis = schedule.scr, schedule.r_over_x, schedule.Z_base, schedule.scr_basis
        columns = np.stack(schedule.columns, axis=-1).tolist()
        designed = schedule.valid.tolist()
    else:
        scr, r_over_x = np.ones(1), np.ones(1)
        Z_base = base_impedance(S_rated or schedule.S_rated, V_n_rms)
        columns, designed = [[list(map(float, schedule.normalised(0.0, 1.0)))]], [[True]]
    nodes = tuple(
        tuple(tuple(node) if good else None for node, good in zip(*pair, strict=True))
        for pair in zip(columns, designed, strict=True)
    )
    D_p, D_q = STRUCTURES[schedule.structure].droops(schedule.D_p, schedule.D_q)
    return GainLookup(
        scr=tuple(scr.tolist()),
        r_over_x=tuple(r_over_x.tolist()),
        nodes=nodes,
        Z_base=float(Z_base),
        scr_basis=scr_basis,
        omega=schedule.omega,
        R_2=schedule.R_2,
        L_2=schedule.L_2,
        structure=schedule.structure,
        law=schedule.law,
        S_rated=schedule.S_rated,
        D_p=D_p,
        D_q=D_q,
        V_n_rms=V_n_rms,
    )


__all__ = ["Answer", "Covariance", "advance", "first_state", "given_input", "start_state", "told_state"]

_updated, _begun = on_floats(updated), on_floats(begun)

Covariance = tuple[float, float, float]
"""var R_g (Ω²), cov(R_g, L_g) (Ω·H) and var L_g (H²)."""

NOT_KNOWN = 0.0, 0.0, 0.0


class Answer(NamedTuple):
    """The gains from now on, with the status bits and the reason of :mod:`vsgdesign.runtime.guards`."""

    gains: PowerLoopGains
    status: int
    reason: int
    scr: float
    """The place for which the gains are made."""
    r_over_x: float

    @property
    def why(self) -> str:
        """The reason in words. It is empty if no guard refused the estimate."""
        return REASONS[self.reason]


def first_state(lookup: GainLookup, settings: SchedulerSettings) -> SchedulerState:
    """The first state: at the safe place, without load, and without an estimate so far.

    Raises ArtifactError if the table has no design at the safe place.
    """
    scr, r_over_x = settings.safe_scr, settings.safe_r_over_x
    if lookup.normalised(scr, r_over_x) is None:
        raise ArtifactError(
            f"safe place SCR {scr:g}, R/X {r_over_x:g}: the table has no design there. Give another (safe_scr, "
            "safe_r_over_x) on the strong side."
        )
    return start_state(lookup, settings, 0.0, 0.0)[0]


def start_state(
    lookup: GainLookup, settings: SchedulerSettings, R_g: float, L_g: float, nearest: bool = False
) -> tuple[SchedulerState, bool]:
    """The state on a known grid, R_g in Ω and L_g in H, and whether the grid is in the box; else it is the first one.

    With ``nearest``, a grid outside the box is taken for the nearest place in it.
    """
    state, known = _begun(lookup.table, settings.limits, R_g, L_g, nearest, lookup.functions_of_floats)
    return state, bool(known)


def given_input(
    said: int,
    R_g: float,
    L_g: float,
    P: float,
    Q: float,
    V_rms: float,
    ticks: int,
    covariance: Covariance | None = None,
) -> SchedulerInput:
    """What an update is given. ``said`` is the reason why there is no estimate, or NO_REASON if R_g (Ω) and L_g (H) are
    an estimate, with its ``covariance`` if it is known. P (W), Q (var) and V (phase rms, V) are those of the power
    loops. ``ticks`` is the caller's 32-bit counter."""
    var_R, cov_RL, var_L = covariance or NOT_KNOWN
    known = 0 if covariance is None else 1
    return SchedulerInput(said, R_g, L_g, known, var_R, cov_RL, var_L, P, Q, V_rms, ticks & 0xFFFFFFFF)


def advance(
    lookup: GainLookup, settings: SchedulerSettings, state: SchedulerState, given: SchedulerInput
) -> tuple[SchedulerState, Answer]:
    """Makes one update. Returns the next state and the answer.

    Whatever the inputs are, the gains are those of a place and of powers within the box.
    """
    following, status, reason = _updated(lookup.table, settings.limits, state, given, lookup.functions_of_floats)
    return following, Answer(following.gains, status, reason, following.scr, following.r_over_x)


SCHEMA = 4

_WHOLE = ("started", "ticks", "age", "doubt", "told", "agreed", "refuted")


def state_document(state: SchedulerState, made_for: str) -> dict[str, Any]:
    """A state in JSON's types. ``made_for`` identifies the scheduler to which it belongs."""
    return {"schema": SCHEMA, "made_for": made_for} | state._asdict() | {"gains": list(state.gains)}


def state_of(document: dict[str, Any], made_for: str) -> SchedulerState:
    """The state of a document, with every number the same to the last bit.

    Raises ArtifactError if the state is not complete, has a newer schema, or was saved with another table.
    """
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        raise ArtifactError(f"state: it has schema {schema!r}, but this version reads {SCHEMA}; start afresh.")
    if document.get("made_for") != made_for:
        raise ArtifactError("state: it was saved with another table or other settings; start afresh.")
    values: dict[str, Any] = {}
    for name in SchedulerState._fields:
        value = document.get(name)
        if name == "gains":
            if not (isinstance(value, list) and len(value) == len(PowerLoopGains._fields) and all(map(_finite, value))):
                raise ArtifactError("state.gains: must be eight numbers; start afresh.")
            values[name] = PowerLoopGains(*map(float, value))
        elif name in _WHOLE:
            if not (isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**32):
                raise ArtifactError(f"state.{name} = {value!r}: must be a whole number of 32 bits; start afresh.")
            values[name] = value
        else:
            if not _finite(value):
                raise ArtifactError(f"state.{name} = {value!r}: must be a number; start afresh.")
            values[name] = float(value)  # type: ignore[arg-type]
    return SchedulerState(**values)


def _finite(value: object) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)
