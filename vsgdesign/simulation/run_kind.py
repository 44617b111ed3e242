"""The kind of a run: all that the loop of runs depends on, and how the numbers of a loop are named."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from vsgdesign.codegen.records import Kinds
from vsgdesign.equations.controller import ControllerSettings, ControllerState
from vsgdesign.equations.limiters import LimiterLaw
from vsgdesign.simulation import watched_sample
from vsgdesign.simulation.axes import Axes, states_of
from vsgdesign.simulation.circuit_sample import Coefficients
from vsgdesign.simulation.dc_parts import DcKind

FAULT, RELAY, SYNC = "fault", "relay", "sync"
"""Instants that only a run can tell: a current into a fault passes through zero, a relay closes a breaker, a converter
has set itself to the grid behind its breaker."""

STEP, DISTURBANCE = "step", "disturbance"
"""What is watched of a run: a step of a reference, judged by the mean of its power over some samples; anything else."""

TAKEN_COLUMNS = ("P_pcc", "Q_pcc", "i_sq", "i_s_sq", "sum_P", "sum_Q")
"""What is kept besides where figures are taken of every sample, W, var and A² peak: the powers at the PCC, the squared
lengths of i_g and i_s, and sums of the powers (:func:`vsgdesign.simulation.watched_sample.taken`)."""

RINGS_OF_TAKEN = ("P_ago", "sums_after.P"), ("Q_ago", "sums_after.Q")
"""What is read again of the sums of the powers, for their means."""

LARGEST_DEGREE = len(Coefficients._fields) - 1
"""Of an edge polynomial of a circuit whose axes are alike. A stiffer one goes the way of two axes."""


class Bridge(NamedTuple):
    """The bridge of a run: where its samples lie on the carrier (none: averaged), and its modulation."""

    slopes: tuple[str, ...] = ()
    zero_sequence: bool = False
    delayed: bool = False


class Kind(NamedTuple):
    """What a body depends on. Runs of one kind share a loop."""

    law: LimiterLaw
    memory: Any
    """The kinds of the limiter's memory and of its constants: NamedTuples."""
    constants: Any
    bridge: Bridge
    axes: Axes | None = None
    """None: both axes are alike."""
    sensors: bool = False
    field: bool = False
    """Whether a field estimator sends its probe and listens."""
    added: bool = False
    """Whether the source has more than its fundamental."""
    ramped: bool = False
    """Whether the loop itself moves the source on a ramp."""
    moved: bool = False
    """Whether all that a source does is fed, as in a run of its own: it wanders, or what turns with it is on a ramp."""
    waves: int = 0
    """So many components of the source turn in the loop itself (:class:`vsgdesign.simulation.timeline.Waves`)."""
    taken: bool = False
    """Whether what figures need is taken of every sample (:func:`vsgdesign.simulation.watched_sample.taken`). Nothing
    but a grid is connected then, and nothing is watched or sought."""
    watch: str = ""
    """What is watched: STEP, DISTURBANCE or nothing."""
    own_rest: bool = False
    """Whether it is judged by the rest to which it comes, which is known at its end alone: its powers are logged until
    then."""
    network: bool = False
    """Whether more than a grid may be connected: the watched power at the PCC is then that of its circuit."""
    second_inductor: bool = True
    """Of the filter; it decides where the watched power of a step is."""
    cut: tuple[str, ...] = ()
    """Of a loop for single samples in whose interval events fall: where each piece lies on the carrier. An averaged
    bridge has one interval for all pieces together."""
    waits: bool = False
    """Whether a run stands still where a cycle of its field estimator has ended, until the runs beside it are there,
    too. Alone, the loop ends there."""
    seeks: tuple[str, ...] = ()
    """Of the instants that only a run can tell, those that the loop finds: FAULT, RELAY, SYNC. A run in which one is
    found stands still before the interval in which it lies, and the loop ends after this sample."""
    dc: DcKind | None = None
    """What feeds the dc link; None: an ideal one."""
    together: bool = False
    """Of runs that may wait: whether no cycle ends before the last sample of the loop. Then none has to stand still."""

    @property
    def coupled(self) -> bool:
        """Whether the dc link is moved together with the circuit within a sample."""
        return self.dc is not None and self.dc.order > 0

    @property
    def edged(self) -> bool:
        """Whether the circuit's responses to edges are needed."""
        return bool(self.bridge.slopes) or (self.dc is not None and self.dc.order > 0 and not self.dc.held)

    @property
    def in_pieces(self) -> bool:
        """Whether an interval in which events fall is computed piece by piece, by a loop of its own."""
        return bool(self.bridge.slopes) or self.coupled

    @property
    def reached(self) -> str:
        """What the circuit's states at the end of a sample are called."""
        if self.coupled:
            return "coupled"
        return "arrived" if self.added else "moved"

    @property
    def records(self) -> dict[Any, dict[str, Any]]:
        """The records in fields whose type hint says Any."""
        return {ControllerState: {"limiter": self.memory}, ControllerSettings: {"limiter": self.constants}}

    def names(self, record: Any, head: str) -> list[str]:
        """The numbers of a record under a name."""
        return names_of(record, head, self.records)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the circuit's states."""
        return states_of(self.axes)

    @property
    def watched(self) -> tuple[Any, Any] | None:
        """The records of what is watched, and of what is demanded of it."""
        return _WATCHES.get(self.watch)

    @property
    def rings(self) -> tuple[tuple[str, str], ...]:
        """Powers that are read again some samples later: (input, output). The mean of a step that is judged by its own
        rest is taken from its log."""
        if self.taken:
            return RINGS_OF_TAKEN
        if self.watch == STEP and self.own_rest:
            return ()
        return {STEP: (("power_ago", "power"),), DISTURBANCE: (("P_ago", "said.P"), ("Q_ago", "said.Q"))}.get(
            self.watch, ()
        )


_WATCHES: dict[str, tuple[Any, Any]] = {
    STEP: (watched_sample.StepWatch, watched_sample.StepDemand),
    DISTURBANCE: (watched_sample.DisturbanceWatch, watched_sample.DisturbanceDemand),
}


def names_of(record: Any, head: str, records: Mapping[Any, Mapping[str, Any]] | None = None) -> list[str]:
    """The numbers of a record under a name, in the order of its fields. ``records``: those in fields whose type hint
    says Any."""
    return [f"{head}.{path}" for path in Kinds(records or {}).paths(record)]
