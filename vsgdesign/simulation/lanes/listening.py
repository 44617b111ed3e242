"""A lane whose field estimator sends its probe and listens, up to the end of its cycle.

The cycles of the lanes end at different samples. A lane whose cycle has ended stands still until those of all others
have: then all are concluded at once, and every lane goes on from its own sample.
"""

from __future__ import annotations

from vsgdesign.codegen.blocks import Part, Writer, joined, with_outputs
from vsgdesign.codegen.expressions import Number
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.equations.field import FieldSettings, LockIn
from vsgdesign.parameters.study import Study
from vsgdesign.simulation import sample
from vsgdesign.simulation.field_feed import probe_of, settings_of_study
from vsgdesign.simulation.lanes.names import names_of
from vsgdesign.simulation.lanes.sample import measured_by

LISTENING = [*zip(names_of(LockIn, "lock"), names_of(LockIn, "heard"), strict=True), ("k", "k_after")]
"""What a listener moves beside the lane: its lock-in, and the number of the lane's own sample."""

SHARED_BY_LISTENERS = [*names_of(FieldSettings, "field"), "V_rated_rms", "allowed"]
"""What is the same for all listeners."""


def listener_values(study: Study) -> dict[str, float]:
    """The shared numbers of a study's field estimators, by name with ``__`` for the dot."""
    settings = {f"field__{name}": float(value) for name, value in settings_of_study(study)._asdict().items()}
    return settings | {"V_rated_rms": study.converter.V_rated_rms, "allowed": float(probe_of(study).send)}


def listening_body(body: Block, moving: tuple[tuple[str, str], ...], rings: tuple[tuple[str, str], ...]) -> Block:
    """The body of a lane with a listener. Where its cycle has ended, the lane and its rings stay as they are.

    ``moving`` and ``rings``: (input, output) of the lane itself. The angle that is watched is that of the commanded
    voltage, as a log has it. The limiter acted in a sample in which its count has grown.
    """
    circuit = {"R_c": "circuit.R_c"} if "circuit.R_c" in body.inputs else {}
    called = {"state.theta": "commanded_theta", "state.V": "commanded_V"}
    ends = {"following.theta": "next_theta", "following.V": "next_V"}
    before, after = [], []
    if ("watch.delta", "watched.delta") in moving:
        before.append(Part(_sum("watch.delta", "added_theta", "+", "commanded_delta")))
        after.append(Part(_sum("watched.delta", "added_theta", "-", "next_delta")))
        called["watch.delta"], ends["watched.delta"] = "commanded_delta", "next_delta"
    whole = joined(
        Part(_named(flat_block(sample.probing)), {"theta": "state.theta", "V_rms": "state.V"}),
        *before,
        Part(body, called),
        Part(_named(flat_block(measured_by), measurement="measured"), circuit),
        Part(_sum("watched.load.limited", "watch.load.limited", "-", "acted")),
        Part(_named(flat_block(sample.hearing)), {"theta": "commanded_theta"}),
        Part(_named(flat_block(sample.without_probe)), {"theta": "following.theta", "V_rms": "following.V"}),
        *after,
    )
    outputs = tuple(output for _, output in (*moving, *LISTENING, *rings))
    return with_outputs(joined(Part(whole), Part(_standing_still((*moving, *rings), ends))), outputs)


def _sum(one: str, other: str, operation: str, name: str) -> Block:
    line = Writer()
    line.output(name, line.does(operation, line.input(one), line.input(other)))
    return line.block()


def _standing_still(moving: tuple[tuple[str, str], ...], ends: dict[str, str]) -> Block:
    line = Writer()
    still = line.does(">", line.input("lock.closed"), Number(0.5))
    for before, after in (*moving, *LISTENING[:-1]):
        moved = line.input(ends.get(after, after))
        line.output(after, line.does("select", still, line.input(before), moved))
    k = line.input("k")
    line.output("k_after", line.does("select", still, k, line.does("+", k, Number(1.0))))
    return line.block()


def _named(block: Block, **heads: str) -> Block:
    """The block with results under their own names, or under those that are given for them."""

    def name(of: str) -> str:
        head, dot, rest = of.partition(".")
        head = head.removesuffix("_out")
        return f"{heads.get(head, head)}{dot}{rest}"

    return Block(block.inputs, block.lets, tuple((name(of), value) for of, value in block.outputs))
