"""The dc link in the full-order model, and over an interval in which its voltage moves that of the bridge.

As long as the bridge is not at its limit and compensates the link's voltage, and the controller does not turn with it,
the link does not act on the circuit: its modes stand beside those of an ideal link, and what happens in the circuit
drives them (:eq:`dc-battery-mode`). Without compensation the link acts on the circuit, and both are moved together.

The bridge connects the link to the filter with a constant switching vector s from one edge to the next: its voltage is
s·v, and the current that it takes from the link is 3/2 s·i_s (:eq:`dc-edges`). Filter, grid current and link are moved
together by their Taylor series from edge to edge. What else drives the grid current is a straight line between the ends
of the interval, which the circuit's step says. This is plain Python of numbers in lists: floats, traced or symbols.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import Kinds, numbers_of, record_like, zero_record
from vsgdesign.equations.dc_control import DroopSettings, turned_with_link
from vsgdesign.equations.dc_link import (
    ActingVoltage,
    DcSettings,
    DcState,
    FilterSide,
    bridge_power,
    held_law,
    link_ends,
    link_step,
)
from vsgdesign.equations.dc_source_interface import DcSourceLaw
from vsgdesign.equations.frames import SPACE_VECTOR_POWER

BENDS = 8
"""Terms of the series of 1/v and v², which change little in an interval."""


def sum_of(terms: Sequence[Any]) -> Any:
    """The terms added from the left."""
    return functools.reduce(operator.add, terms)


class SourceLaw(NamedTuple):
    """The current of a source from a sample to the next, as :class:`vsgdesign.equations.dc_source_interface.DcFlow` has
    it. What is the float 0.0 is left out."""

    v: Any
    """Voltage of the link at the sample, V."""
    current: Any
    slope: Any
    second: Any
    p_begin: Any
    p_middle: Any
    p_end: Any
    tilt: Any
    rate: Any
    """Conductances across the link over its capacitance, 1/s."""


class Edge(NamedTuple):
    """An edge of the bridge: where it is in the interval, 0 to 1, and by how much the switching vector changes."""

    place: Any
    alpha: Any
    beta: Any


class Interval(NamedTuple):
    """An interval, or one of those into which events cut that between two samples."""

    h: Any
    """s."""
    elapsed: Any
    share: Any
    """Where it begins between two samples, 0 to 1, and its length there."""
    x: Sequence[Any]
    """i_s, v_c and i_g at the beginning, each as (α, β), A and V peak."""
    near: Sequence[Mapping[int, Any]]
    """On each axis: the slope of i_g over the interval per number of x, A."""
    rest: Sequence[Sequence[Any]]
    """On each axis: what is left of this slope, as the coefficients of a polynomial in the place in the interval, A."""
    switching: Sequence[Any]
    """s at the beginning, on both axes."""
    edges: Sequence[Edge] = ()
    held: Sequence[Any] | None = None
    """The voltage of a bridge that compensates the link's, on both axes, V peak; the switching vector is then not
    read, and no state gets a response to the link. None: it is s·v."""


class LinkMoved(NamedTuple):
    """The link after an interval."""

    v: Any
    voltage: Any
    squares: Any
    """∫v dt, Vs, and ∫v² dt, V²s."""
    taken: Any
    """Energy that the bridge took, J."""
    moments: Sequence[Sequence[Any]]
    """On each axis: ∫ s (v − v_begin) k x^(k−1) dx for k = 1, 2, …, where x goes from 1 to −1."""


def link_over(v_begin: Any, of: Interval, source: SourceLaw, dc: DcSettings, *, order: int, nodes: int, degree: int):
    """The link over an interval (:eq:`dc-edges`): a :class:`LinkMoved`. ``order``: of the series; ``nodes``: of the
    sum over each piece with which its moments up to ``degree`` are formed."""
    places, weights = (0.5 * np.polynomial.legendre.leggauss(nodes)[k] + (0.5, 0.0)[k] for k in (0, 1))
    v, x, s = v_begin, list(of.x), list(of.switching)
    sums: list[Any] = []
    moments: list[list[Any]] = [[], []]
    begins = [0.0, *(edge.place for edge in of.edges)]
    ends = [*begins[1:], 1.0]
    for number, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        if number:
            edge = of.edges[number - 1]
            s = [s[0] + edge.alpha, s[1] + edge.beta]
        length = end - begin
        h = of.h * length if of.edges else of.h
        states, volts, current = _series(v, x, s, source, dc, of, (begin, length, h), order)
        voltage, squares, taken = _integrals(volts, current, held=of.held is not None)
        sums.append([h * voltage, h * squares, h * taken])
        size = [2.0 * length * weight for weight in weights.tolist()]
        shares = [] if of.held else _moments(volts, v_begin, begin, length, places.tolist(), size, degree)
        for k, of_piece in enumerate(shares):
            for axis in range(2):
                added = s[axis] * of_piece
                if number:
                    moments[axis][k] = moments[axis][k] + added
                else:
                    moments[axis].append(added)
        v, x = sum_of(volts), [sum_of(one) for one in states]
    voltage, squares, taken = (sum_of(column) for column in zip(*sums, strict=True))
    return LinkMoved(v, voltage, squares, taken, moments)


def _series(
    v: Any,
    x: Sequence[Any],
    s: Sequence[Any],
    source: SourceLaw,
    dc: DcSettings,
    of: Interval,
    piece: tuple[Any, Any, Any],
    order: int,
) -> tuple[list[list[Any]], list[Any], list[Any]]:
    """Coefficients of x, of the link and of the current into the bridge over a piece, whose length is 1. ``piece``:
    where it begins in the interval, its length there, and in s."""
    begin, length, h = piece
    states = [[one] for one in x]
    volts, current, inverse, bent = [v], [], [], []
    power = None if _nothing(source.p_begin, source.p_middle, source.p_end) else _power(source, of, begin, length)
    per_volt = [SPACE_VECTOR_POWER * one for one in of.held or s]  # with a voltage that is held: the power itself
    bends = not _nothing(source.slope, source.second)
    rest = [_shifted(one, begin, length) for one in of.rest]
    for n in range(order):
        step, share = h * (1.0 / (n + 1)), length * (1.0 / (n + 1))
        now = [one[n] for one in states]
        current.append(per_volt[0] * now[0] + per_volt[1] * now[1])
        if of.held is None:
            into = -current[n]
        else:
            inverse.append(_next_inverse(volts, inverse))
            into = -sum_of([current[k] * inverse[n - k] for k in range(n + 1)])
        if n == 0 and not _nothing(source.current):
            into = source.current + into
        if n < 2 and not _nothing(source.tilt):
            into = into + source.tilt * (of.share * length if n else of.elapsed + of.share * begin - 0.5)
        if power is not None and n <= BENDS:
            if of.held is None:
                inverse.append(_next_inverse(volts, inverse))
            into = into + sum_of([power[k] * inverse[n - k] for k in range(min(n, 2) + 1)])
        if bends and n <= BENDS:
            bent.append(volts[n] - source.v if n == 0 else volts[n])
            into = into + source.slope * bent[n]
            into = into + source.second * sum_of([bent[k] * bent[n - k] for k in range(n + 1)])
        for axis in range(2):
            i, c, g = (now[k + axis] for k in (0, 2, 4))
            node = c + dc.R_c * (i - g)
            slope = sum_of([one * now[k] for k, one in of.near[axis].items()])
            slope = slope + rest[axis][n] if n < len(rest[axis]) else slope
            drop = dc.R_1 * i + node
            if of.held is None:
                states[axis].append(step * dc.over_L_1 * (s[axis] * volts[n] - drop))
            else:
                states[axis].append(step * dc.over_L_1 * (of.held[axis] - drop if n == 0 else -drop))
            states[2 + axis].append(step * dc.over_C_f * (i - g))
            states[4 + axis].append(share * slope)
        volts.append(step * (dc.over_C * into - source.rate * volts[n]))
    return states, volts, current


def _shifted(c: Sequence[Any], begin: Any, length: Any) -> list[Any]:
    """The coefficients of a polynomial over a piece of its interval."""
    found, power = [], 1.0
    for k in range(len(c)):
        total = c[-1] * float(math.comb(len(c) - 1, k))
        for n in range(len(c) - 2, k - 1, -1):
            total = total * begin + c[n] * float(math.comb(n, k))
        found.append(total * power if k else total)
        power = power * length
    return found


def _power(source: SourceLaw, of: Interval, begin: Any, length: Any) -> list[Any]:
    """The power p of a source over a piece, as the parabola through its three values between two samples."""
    first = of.elapsed + of.share * begin
    whole = of.share * length
    line = 4.0 * source.p_middle - 3.0 * source.p_begin - source.p_end
    curve = 2.0 * (source.p_begin - 2.0 * source.p_middle + source.p_end)
    return _shifted([source.p_begin, line, curve], first, whole)


def _next_inverse(volts: Sequence[Any], inverse: Sequence[Any]) -> Any:
    """The next coefficient of 1/v."""
    n = len(inverse)
    return -inverse[0] * sum_of([volts[k] * inverse[n - k] for k in range(1, n + 1)]) if n else 1.0 / volts[0]


def _integrals(volts: Sequence[Any], current: Sequence[Any], *, held: bool) -> tuple[Any, Any, Any]:
    """Means of v, v² and v·i over a piece, from their series; ``held``: the third one is that of the power itself."""
    mean = sum_of([value * (1.0 / (n + 1)) for n, value in enumerate(volts)])
    rest = sum_of([volts[k] * volts[j] * (1.0 / (k + j + 1)) for k in range(1, 4) for j in range(1, 4)])
    squares = volts[0] * (2.0 * mean - volts[0]) + rest
    if held:
        return mean, squares, sum_of([one * (1.0 / (n + 1)) for n, one in enumerate(current)])
    taken = volts[0] * sum_of([one * (1.0 / (n + 1)) for n, one in enumerate(current)])
    for k in range(1, min(6, len(volts))):
        later = [one * (1.0 / (n + k + 1)) for n, one in enumerate(current) if n + k <= len(current)]
        taken = taken + volts[k] * sum_of(later)
    return mean, squares, taken


def _moments(
    volts: Sequence[Any], v_begin: Any, begin: Any, length: Any, places: list[float], size: list[Any], degree: int
) -> list[Any]:
    """∫ (v − v_begin) k x^(k−1) dx of a piece for k = 1 … ``degree``, from values at the nodes of Gauss."""
    found: list[Any] = []
    first = volts[0] - v_begin
    for place, weight in zip(places, size, strict=True):
        away = volts[-1]
        for one in volts[-2:0:-1]:
            away = away * place + one
        away = (away * place + first) * weight
        x = 1.0 - 2.0 * (begin + length * place)
        power = 1.0
        for k in range(degree):
            term = away * (power * (k + 1.0))
            if len(found) > k:
                found[k] = found[k] + term
            else:
                found.append(term)
            power = power * x
    return found


def _nothing(*values: Any) -> bool:
    return all(isinstance(value, float) and value == 0.0 for value in values)


Array = NDArray[np.float64]


NODES = 4
"""Of Gauss, with which the moments of a period are formed."""


class CircuitOfPeriod(NamedTuple):
    """What the link needs of the circuit over a period: di_g/dt per i_s, v_c and i_g of the same axis, 1/s; on each
    axis what is left of di_g/dt at the beginning and at the end, A/s; and the coefficients of the responses of i_s, v_c
    and i_g to an edge, from that of x on."""

    near: Sequence[Any]
    rest: Sequence[tuple[Any, Any]]
    edge: Sequence[Sequence[Any]]


class LinkInModel(NamedTuple):
    """A dc link as the model needs it: the law of its source, the NamedTuple classes of its memory and of its
    constants, and which fields of the memory move. A charge counts as constant."""

    law: DcSourceLaw
    memory: type
    constants: type
    moving: tuple[str, ...]
    order: int = 0
    """Of the series that move circuit and link together; 0: the bridge compensates the link's voltage."""
    droops: bool = False
    """Whether the frame turns with the link's voltage."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: the link's voltage, V, the power of the bridge in the period before, W, and what moves
        of the source."""
        return ("v_dc", "p_dc", *(f"dc_{name}" for name in self.moving))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the constants, and of what the source remembers."""
        own = Kinds({DcSettings: {"source": self.constants}, DcState: {"memory": self.memory}})
        settings = [f"link.{path}" for path in own.paths(DcSettings)]
        droop = ("droop",) if self.droops else ()
        return (*settings, *(f"memory.{path}" for path in own.paths(self.memory)), *droop)

    def values(self, settings: DcSettings, state: DcState, droop: DroopSettings) -> list[float]:
        """The numbers of the parameters."""
        return [*numbers_of(settings), *numbers_of(state.memory), *(numbers_of(droop) if self.droops else [])]

    def turned(self, theta: Any, omega: Any, state: Mapping[str, Any], values: Mapping[str, Any], T_s: Any) -> Any:
        """Angle of the next sample and frequency with the droop of the link's voltage."""
        if not self.droops:
            return theta, omega
        return turned_with_link(theta, omega, state["v_dc"], values["link.V_dc"], values["droop"], T_s)

    def at_rest(self, state: DcState) -> list[float]:
        """The numbers of the states."""
        return [state.v, state.p, *(getattr(state.memory, name) for name in self.moving)]

    def following(
        self,
        state: Mapping[str, Any],
        values: Mapping[str, Any],
        before: Sequence[Any],
        after: Sequence[Any],
        v_b: Sequence[Any],
    ) -> dict[str, Any]:
        """The states after a period, from the filter's states at both ends and the bridge voltage between them, all in
        one frame that does not turn; numbers or symbols."""
        now, settings = self._now(state, values)
        power = bridge_power(FilterSide(*before), FilterSide(*after), ActingVoltage(*v_b), settings)
        return self._found(link_step(now, power, 0.0, settings, self.law))

    def together(
        self,
        state: Mapping[str, Any],
        values: Mapping[str, Any],
        before: Sequence[Any],
        asked: Sequence[Any],
        of: CircuitOfPeriod,
    ) -> tuple[dict[str, Any], list[list[Any]]]:
        """The states after a period in which the link acts on the circuit, and on each axis what the change of its
        voltage adds to i_s, v_c and i_g. ``asked``: the bridge voltage that the controller asked for."""
        now, settings = self._now(state, values)
        law = SourceLaw(now.v, *held_law(now, settings, self.law))
        T = settings.T_s
        interval = Interval(
            h=T,
            elapsed=0.0,
            share=1.0,
            x=before,
            near=[{k + axis: T * one for k, one in zip((0, 2, 4), of.near, strict=True)} for axis in range(2)],
            rest=[[T * begin, T * (end - begin)] for begin, end in of.rest],
            switching=[one / settings.V_dc for one in asked],
        )
        ran = link_over(now.v, interval, law, settings, order=self.order, nodes=NODES, degree=len(of.edge))
        voltage = ActingVoltage(*asked)
        found = link_ends(
            now, voltage, ran.v, ran.voltage, ran.squares, ran.taken, settings, self.law, compensates=False
        )
        added = [
            [sum(one[k] * moment for one, moment in zip(of.edge, ran.moments[axis], strict=True)) for k in range(3)]
            for axis in range(2)
        ]
        return self._found(found), added

    def _now(self, state: Mapping[str, Any], values: Mapping[str, Any]) -> tuple[DcState, DcSettings]:
        numbers = [values[name] for name in self.parameters]
        count = len(DcSettings._fields) - 1
        own = len(numbers_of(zero_record(self.constants)))
        source = record_like(zero_record(self.constants), iter(numbers[count : count + own]))
        settings = DcSettings(*numbers[:count], source=source)
        memory = record_like(zero_record(self.memory), iter(numbers[count + own :]))  # a droop comes last
        memory = memory._replace(**{name: state[f"dc_{name}"] for name in self.moving})
        counted = dict.fromkeys(DcState._fields, 0.0)
        return DcState(**counted | {"v": state["v_dc"], "p": state["p_dc"], "memory": memory}), settings

    def _found(self, found: DcState) -> dict[str, Any]:
        moved = {f"dc_{name}": getattr(found.memory, name) for name in self.moving}
        return {"v_dc": found.v, "p_dc": found.p, **moved}
