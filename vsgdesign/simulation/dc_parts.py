"""The dc link in the body of a loop: what the bridge can make at a sample, what acts, and the link after it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from vsgdesign.codegen.blocks import Part, Writer, joined
from vsgdesign.codegen.expressions import Number
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.records import Kinds
from vsgdesign.equations.dc_control import (
    ClampSettings,
    ClampState,
    DroopSettings,
    RestCurve,
    clamped,
    clamped_rest,
    reactive_rest,
    turned_with_link,
)
from vsgdesign.equations.dc_link import (
    ActingVoltage,
    BridgeCharge,
    DcSettings,
    DcState,
    acting_voltage,
    bridge_limit,
    dc_step,
    dc_step_switched,
    duty_voltage,
    held_law,
    link_ends,
)
from vsgdesign.equations.dc_source_interface import DcSourceLaw
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.dc_rest import series_of
from vsgdesign.simulation.axes import headed
from vsgdesign.simulation.circuit_sample import PlantState
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.study import Study

LEAST_OF_NETWORKS = 2.0
"""By how much filter and grid current may move in a sampling period with a load or a fault, rad, at least."""


class DcKind(NamedTuple):
    """What a loop has a source for: its law, and the kinds of its memory and of its constants (NamedTuples)."""

    law: DcSourceLaw
    memory: Any
    constants: Any
    clamps: bool = False
    """Whether the controller asks for no more power than the source can give."""
    compensates: bool = True
    """Whether the modulation divides by the measured voltage of the link."""
    order: int = 0
    """Of the series that move filter and link together, where the voltage of the link moves that of the bridge
    (:eq:`dc-edges`); 0: it does not, because an averaged bridge compensates it."""
    turns: float = 0.0
    """By how much filter and grid current may move in a sampling period, rad, for this order."""
    held: bool = False
    """Whether the bridge's voltage is held over a sample although there is an order: an averaged bridge compensates it,
    and only the link needs how the currents move with a network."""

    droops: bool = False
    """Whether the controller turns with the link's voltage."""

    @property
    def records(self) -> dict[Any, dict[str, Any]]:
        """The records in fields whose type hint says Any."""
        return {DcState: {"memory": self.memory}, DcSettings: {"source": self.constants}}

    @property
    def state(self) -> list[str]:
        """Names of what moves."""
        return [f"dc.{path}" for path in Kinds(self.records).paths(DcState)]

    @property
    def clamp(self) -> list[str]:
        """Names of what the clamp remembers; none without one."""
        return [f"clamp.{name}" for name in ClampState._fields] if self.clamps else []

    @property
    def logged(self) -> list[str]:
        """Names of what is logged."""
        return self.state + self.clamp

    @property
    def settings(self) -> list[str]:
        """Names of its constants."""
        found = [f"link.{path}" for path in Kinds(self.records).paths(DcSettings)]
        found += [f"clamp_of.{name}" for name in ClampSettings._fields] if self.clamps else []
        found += [f"rest_of.{name}" for name in RestCurve._fields] if self.clamps else []
        return found + ([f"droop_of.{name}" for name in DroopSettings._fields] if self.droops else [])

    @property
    def moves(self) -> list[tuple[str, str]]:
        """(input, output) of what moves."""
        found = [(name, name.replace("dc.", "dc_after.", 1)) for name in self.state]
        return found + [(name, name.replace("clamp.", "clamp_after.", 1)) for name in self.clamp]

    def limit(self) -> Part:
        """The largest voltage of the bridge, from that of the link at the sample. Its output is ``bridge_max``."""
        called = {"v": "dc.v" if self.compensates else "link.V_dc", "per_volt": "link.limit"}
        return Part(headed(flat_block(bridge_limit), bridge_limit="bridge_max"), called)

    def asks(self, records: Mapping[Any, Mapping[str, Any]], state: Mapping[str, str]) -> list[Part]:
        """What the source can give at the sample, and the power that the loops are asked for. ``state``: where the
        controller's state is. Its output is ``clamped_P``."""
        can_give = self.law.can_give
        called = {f"memory.{name.removeprefix('dc.memory.')}": name for name in self.state}
        called |= {f"c.{name.removeprefix('link.source.')}": name for name in self.settings}
        limits = Part(headed(flat_block(can_give), source_limits="limits"), called | {"hold": "clamp_of.hold"})
        own = {f"settings.{name}": f"clamp_of.{name}" for name in ClampSettings._fields}
        own |= {f"gains.{name}": f"power_gains.{name}" for name in PowerLoopGains._fields}
        return [limits, Part(headed(flat_block(clamped, kinds=records), P_ref="clamped_P"), own | dict(state))]

    def rests(self, called: Mapping[str, str]) -> list[Part]:
        """Where the power rests with what the source can give at the sample. ``called``: where the power is that is
        asked for. Its outputs are ``P_rest_now`` and ``Q_rest_now``, the Q of this power."""
        block = headed(flat_block(clamped_rest), clamped_rest="P_rest_now")
        curve = {"P": "P_rest_now"} | {f"curve.{name}": f"rest_of.{name}" for name in RestCurve._fields}
        reactive = Part(headed(flat_block(reactive_rest), reactive_rest="Q_rest_now"), curve)
        return [Part(block, {"own": "clamp_of.own"} | dict(called)), reactive]

    def drooped(self) -> list[Part]:
        """The angle of the next sample and the frequency with the droop of the link's voltage; nothing without one. Its
        outputs are those of :func:`vsgdesign.equations.dc_control.turned_with_link`."""
        if not self.droops:
            return []
        called = {"theta": "following.theta", "omega": "said.omega", "v": "dc.v", "V_dc": "link.V_dc"}
        called |= {"per_volt": "droop_of.per_volt", "T_s": "settings.T_s"}
        return [Part(headed(flat_block(turned_with_link)), called)]

    @property
    def angle(self) -> str:
        """Where the angle of the next sample is."""
        return "turned_theta" if self.droops else "following.theta"

    def acts(self, asked: dict[str, str]) -> Part:
        """What becomes of the voltage that was asked for. ``asked``: where its axes are. Its output is ``acting``."""
        called = {f"asked.{axis}": asked[f"applied.{axis}"] for axis in ActingVoltage._fields}
        called |= {"v": "dc.v", "per_volt": "link.limit", "V_dc": "link.V_dc"}
        block = flat_block(acting_voltage if self.compensates else duty_voltage)
        return Part(headed(block, acting_voltage="acting"), called)

    def moved(
        self, after: str, asked: dict[str, str], before: str = "x", acting: str = "acting", *, switched: bool = False
    ) -> Part:
        """The link at the end of the interval. ``after``, ``before``: what the circuit's states are called at its end
        and at its beginning; ``asked``: where the voltage is that was asked for; ``acting``: and that which acts.
        ``switched``: whether the circuit may be switched in it."""
        called = self._link | {f"after.{name}": f"{after}.{name}" for name in PlantState._fields}
        called |= {f"x.{name}": f"{before}.{name}" for name in PlantState._fields}
        called |= {f"v_b.{axis}": f"{acting}.{axis}" for axis in ActingVoltage._fields}
        called |= {f"asked.{axis}": asked[f"applied.{axis}"] for axis in ActingVoltage._fields}
        step = dc_step_switched if switched else dc_step
        called |= {f"charge.{axis}": f"charge_now.{axis}" for axis in BridgeCharge._fields}
        block = flat_block(step, fixed={"source": self.law}, kinds=self.records)
        return Part(headed(block, dc_state="dc_after"), called)

    @property
    def kept(self) -> list[str]:
        """What a unit of a plant keeps of its sample for the link until the next one: the circuit's states, the voltage
        that was asked for, and that there was a sample."""
        found = [f"began.{name}" for name in PlantState._fields]
        return [*found, *(f"asked.{axis}" for axis in ActingVoltage._fields), "begun"]

    def at_sample(self, block: Block, asked: dict[str, str], *, switched: bool = False) -> Block:
        """The sample of a unit of a plant, ``block``, with its link. Between two samples others sample, too, so the
        link is moved when the unit samples again: from what was kept. Before its first sample it rests. ``switched``:
        whether the circuit is switched in the run.

        Of the link at the sample the outputs are ``dc_now.…``, of what acts from the sample on ``acting.…``."""
        applied = {f"applied.{axis}": f"asked.{axis}" for axis in ActingVoltage._fields}
        line, now = Writer(), {name: name.replace("dc.", "dc_now.", 1) for name in self.state}
        begun = line.input("begun")
        for before, after in self.moves[: len(now)]:
            there = line.does(">", begun, Number(0.5))
            line.output(now[before], line.does("select", there, line.input(after), line.input(before)))
        line.output("begun_after", line.does("max", begun, Number(1.0)))
        acts = self.acts(asked)
        return joined(
            self.moved("x", applied, "began", "held", switched=switched),
            Part(line.block()),
            Part(block, now),
            Part(acts.block, {key: now.get(value, value) for key, value in acts.called.items()}),
        )

    def holds(self) -> Part:
        """The law of the source over the interval. Its outputs are ``held.…``."""
        block = flat_block(held_law, fixed={"source": self.law}, kinds=self.records)
        heads = {name: f"held.{name}" for name, _ in block.outputs}
        return Part(headed(block, **heads), self._link)

    @property
    def absent(self) -> frozenset[str]:
        """What the law of the source does not have: its values are zero, whatever the numbers are."""
        block = flat_block(held_law, fixed={"source": self.law}, kinds=self.records)
        return frozenset(name for name, value in block.outputs if isinstance(value, Number) and value.value == 0.0)

    def ends(self, asked: dict[str, str]) -> Part:
        """The link at the end of the interval, from what was summed up in it (``ran.…``)."""
        called = self._link | {f"asked.{axis}": asked[f"applied.{axis}"] for axis in ActingVoltage._fields}
        called |= {"v_end": "ran.v", "voltage": "ran.voltage", "squares": "ran.squares", "energy": "ran.taken"}
        fixed = {"source": self.law, "compensates": self.compensates}
        return Part(headed(flat_block(link_ends, fixed=fixed, kinds=self.records), dc_state="dc_after"), called)

    @property
    def _link(self) -> dict[str, str]:
        """What an equation's arguments of the link are called in a loop."""
        called = {f"state.{name.removeprefix('dc.')}": name for name in self.state}
        return called | {f"dc.{name.removeprefix('link.')}": name for name in self.settings}


def dc_kind(link: DcLink | None) -> DcKind | None:
    """What feeds the dc link."""
    if link is None:
        return None
    return DcKind(link.kind.law, *link.kind.records, link.clamps, link.compensates, droops=link.droops)


def dc_kind_of(study: Study, *, switched: bool, networks: bool = False) -> DcKind | None:
    """The same with the order of the series, where the link of a study moves the voltage of the bridge; ``networks``:
    whether more than a grid may be connected, which may be faster. Raises
    InfeasibleStudyError where the link follows its source too fast for it."""
    kind = dc_kind(study.dc)
    held = kind is not None and kind.compensates and not switched
    if kind is None or (held and not networks):
        return kind
    order, turns = series_of(study, LEAST_OF_NETWORKS if networks else 0.0)
    return kind._replace(order=order, turns=turns, held=held)
