"""The lookup of many converters at once: places, normalised parameters and gains of many grids, on arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.runtime.interpolation import blend, corner_weights, locate
from vsgdesign.runtime.lookup import GainLookup

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

_ZERO_CORNER = (0.0,) * len(NormalisedGains._fields)


class ManyPlaces(NamedTuple):
    """Places with what follows from them alone: it is computed again where a place has moved."""

    scr: Array
    r_over_x: Array
    R: Array
    """Resistance (Ω) and reactance (Ω) from the control point to the grid's source."""
    X: Array
    normalised: Array
    """(6, N): the fields of NormalisedGains."""
    designed: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ManyLookups:
    """A lookup for arrays of places (:class:`vsgdesign.runtime.lookup.GainLookup`)."""

    lookup: GainLookup
    _scr: Array = field(init=False)
    _r_over_x: Array = field(init=False)
    _columns: tuple[Array, ...] = field(init=False)
    """Six flat arrays over the nodes; 0 where a node has no design."""
    _designed: NDArray[np.bool_] = field(init=False)

    def __post_init__(self) -> None:
        nodes = [node for row in self.lookup.nodes for node in row]
        values = np.array([node or _ZERO_CORNER for node in nodes])
        object.__setattr__(self, "_scr", np.array(self.lookup.scr))
        object.__setattr__(self, "_r_over_x", np.array(self.lookup.r_over_x))
        object.__setattr__(self, "_columns", tuple(np.ascontiguousarray(column) for column in values.T))
        object.__setattr__(self, "_designed", np.array([node is not None for node in nodes]))

    def coordinates(self, R_g: Any, L_g: Any) -> tuple[Array, Array]:
        """SCR and R/X of grids (:eq:`scr`)."""
        lookup = self.lookup
        scr = SCR_BASES[lookup.scr_basis].scr(R_g, L_g, lookup.Z_base, lookup.omega)
        return scr, R_g / (lookup.omega * L_g)

    def grid(self, scr: Any, r_over_x: Any) -> tuple[Array, Array]:
        """R_g (Ω) and L_g (H) of places (:eq:`scr`)."""
        return SCR_BASES[self.lookup.scr_basis].grid(scr, 1.0 / r_over_x, self.lookup.Z_base, self.lookup.omega)

    def places(self, scr: Array, r_over_x: Array) -> ManyPlaces:
        """Everything that follows from places alone (:eq:`bilinear`)."""
        lookup, columns = self.lookup, len(self._r_over_x)
        row, column = locate(self._scr, scr), locate(self._r_over_x, r_over_x)
        weights = corner_weights(row.fraction, column.fraction)
        low, high = row.low * columns, row.high * columns
        corners = low + column.low, low + column.high, high + column.low, high + column.high
        designed = np.ones(len(scr), dtype=bool)
        if not self._designed.all():
            for at, weight in zip(corners, weights, strict=True):
                designed &= self._designed[at] | (weight == 0.0)
        normalised = np.stack([blend(weights, *(values.take(at) for at in corners)) for values in self._columns])
        R_g, L_g = self.grid(scr, r_over_x)
        return ManyPlaces(scr, r_over_x, R_g + lookup.R_2, lookup.omega * (L_g + lookup.L_2), normalised, designed)

    def moved(self, before: ManyPlaces, scr: Array, r_over_x: Array) -> ManyPlaces:
        """The places that follow on others: those that have moved are computed, the others are kept."""
        at = np.flatnonzero((scr != before.scr) | (r_over_x != before.r_over_x))
        if len(at) == 0:
            return before
        if 2 * len(at) > len(scr):
            return self.places(scr, r_over_x)
        return with_lanes(before, self.places(scr[at], r_over_x[at]), at)

    def gains(self, places: ManyPlaces, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        """Gains at measured powers and voltage, (N,) each (:eq:`structure-gains`). Where nothing is designed they mean
        nothing."""
        lookup = self.lookup
        A, B, C, D = scheduled_jacobian(P, Q, V_rms, places.R, places.X)
        normalised = NormalisedGains(*places.normalised)
        found = STRUCTURES[lookup.structure].gains(
            A, B, C, D, normalised, lookup.D_p, lookup.D_q, lookup.S_rated, lookup.omega, lookup.law == "inertia"
        )
        return PowerLoopGains(*(filled(value, len(P)) for value in found))


def everywhere(state: Any, count: int) -> Any:
    """A state, or gains, with the same value in every lane."""
    return type(state)(
        *(everywhere(value, count) if isinstance(value, tuple) else np.full(count, value) for value in state)
    )


def taken(state: Any, lanes: NDArray[Any]) -> Any:
    """The same of some lanes."""
    return type(state)(*(taken(values, lanes) if isinstance(values, tuple) else values[..., lanes] for values in state))


def with_lanes(state: Any, new: Any, lanes: Whole) -> Any:
    """The same with some lanes replaced."""
    after = []
    for values, of_lanes in zip(state, new, strict=True):
        if isinstance(values, tuple):
            after.append(with_lanes(values, of_lanes, lanes))
            continue
        values = values.copy()
        values[..., lanes] = of_lanes
        after.append(values)
    return type(state)(*after)


def filled(value: Any, count: int) -> Array:
    return value if isinstance(value, np.ndarray) and value.shape == (count,) else np.full(count, value, dtype=float)
