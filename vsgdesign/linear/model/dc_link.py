"""The dc link in the full-order model: its voltage, the power of the bridge in the period before, and its source.

As long as the bridge is not at its limit and compensates the link's voltage, and the controller does not turn with it,
the link does not act on the circuit: its modes stand beside those of an ideal link, and what happens in the circuit
drives them (:eq:`dc-battery-mode`). Without compensation the link acts on the circuit, and both are moved together
(:eq:`dc-edges`).
"""

from __future__ import annotations

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
from vsgdesign.linear.model.link_interval import Interval, SourceLaw, link_over

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
