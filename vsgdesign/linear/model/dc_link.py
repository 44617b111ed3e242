"""The dc link in the full-order model: its voltage, the power of the bridge in the period before, and its source.

As long as the bridge is not at its limit, the link does not act on the circuit: its modes stand beside those of an
ideal link, and what happens in the circuit drives them (:eq:`dc-battery-mode`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import Kinds, numbers_of, record_like, zero_record
from vsgdesign.equations.dc_link import ActingVoltage, DcSettings, DcState, FilterSide, bridge_power, link_step
from vsgdesign.equations.dc_source_interface import DcSourceLaw

Array = NDArray[np.float64]


class LinkInModel(NamedTuple):
    """A dc link as the model needs it: the law of its source, the NamedTuple classes of its memory and of its
    constants, and which fields of the memory move. A charge counts as constant."""

    law: DcSourceLaw
    memory: type
    constants: type
    moving: tuple[str, ...]

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
        return (*settings, *(f"memory.{path}" for path in own.paths(self.memory)))

    def values(self, settings: DcSettings, state: DcState) -> list[float]:
        """The numbers of the parameters."""
        return [*numbers_of(settings), *numbers_of(state.memory)]

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
        numbers = [values[name] for name in self.parameters]
        count = len(DcSettings._fields) - 1
        own = len(numbers_of(zero_record(self.constants)))
        source = record_like(zero_record(self.constants), iter(numbers[count : count + own]))
        settings = DcSettings(*numbers[:count], source=source)
        memory = record_like(zero_record(self.memory), iter(numbers[count + own :]))
        memory = memory._replace(**{name: state[f"dc_{name}"] for name in self.moving})
        counted = dict.fromkeys(DcState._fields, 0.0)
        now = DcState(**counted | {"v": state["v_dc"], "p": state["p_dc"], "memory": memory})
        power = bridge_power(FilterSide(*before), FilterSide(*after), ActingVoltage(*v_b), settings)
        found = link_step(now, power, 0.0, settings, self.law)
        moved = {f"dc_{name}": getattr(found.memory, name) for name in self.moving}
        return {"v_dc": found.v, "p_dc": found.p, **moved}
