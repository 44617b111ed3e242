"""The network behind the field estimators of many lanes: their posteriors in one product of matrices, and what is made
of them in one compiled loop."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.flat import flat_block
from vsgdesign.codegen.llvm import Loop, LoopSpec, best_lanes, compiled_loop, empty_rows
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.field import FieldAnswer, FieldFeatures, FieldSettings
from vsgdesign.equations.field.fusion import (
    FIRST_GATE,
    GateLimits,
    NetworkGate,
    Posterior,
    fused_answer,
    next_gate,
    step_refuted,
)
from vsgdesign.identification.field import FieldNetwork
from vsgdesign.simulation.lanes.before_steps import in_groups
from vsgdesign.simulation.run_kind import names_of

Array = NDArray[np.float64]


def spoken(
    gate: NetworkGate,
    answer: FieldAnswer,
    seen: FieldFeatures,
    posterior: Posterior,
    learning: Any,
    tracking: Any,
    doubting: Any,
    limits: GateLimits,
    settings: FieldSettings,
) -> tuple[NetworkGate, FieldAnswer]:
    """The answer of a cycle with the network behind the recursions, as
    :meth:`vsgdesign.identification.field.FieldNetwork.behind`. Returns (gate, answer).

    ``learning``, ``tracking`` and ``doubting`` are the network's squared radii in the three modes.
    """
    begun = next_gate(gate, answer.event)
    radius = np.where(answer.mode > 1.5, doubting, np.where(answer.mode > 0.5, tracking, learning))
    moved, told = fused_answer(answer, begun, posterior, step_refuted(seen), radius, limits, settings)
    return moved, told


class ManyNetworks:
    """A network behind ``groups`` times ``width`` estimators, with the gate of each."""

    def __init__(self, network: FieldNetwork, settings: FieldSettings, groups: int, width: int) -> None:
        self._network, self._loop = network, _loop(width)
        spec = self._loop.spec
        self._rows = empty_rows(spec, groups)
        self._rows[:, : len(FIRST_GATE)] = np.array(FIRST_GATE)[:, None]
        self._log = np.empty((groups, 1, len(spec.logged), width))
        known = dict(zip(names_of(GateLimits, "limits"), network.gate, strict=True))
        known |= dict(zip(names_of(FieldSettings, "settings"), numbers_of(settings), strict=True))
        known |= dict(zip(("learning", "tracking", "doubting"), network.radii, strict=True))
        self._constants = np.array([float(known[name]) for name in spec.uniform])

    def go_on(self, before: ManyNetworks) -> None:
        """Goes on where the same estimators in other groups have come to."""
        self._rows[:] = in_groups(before._rows, len(self._rows), self._rows.shape[2])

    def behind(self, concluded: Array) -> Array:
        """What the lanes of the first groups say, (groups, 14, width): the fields of FieldAnswer. ``concluded`` has
        those of the recursions' answers, and the features behind them."""
        groups, _, width = concluded.shape
        features = concluded[:, len(FieldAnswer._fields) :]
        outputs = self._network.outputs(features.swapaxes(1, 2).reshape(groups * width, -1))
        rows = self._rows[:groups]
        first = len(FIRST_GATE)
        rows[:, first : first + concluded.shape[1]] = concluded
        rows[:, first + concluded.shape[1] :] = outputs.reshape(groups, width, -1).swapaxes(1, 2)
        self._loop(0, 1, rows, self._constants, log=self._log[:groups], every=1)
        return self._log[:groups, 0]


@functools.cache
def _loop(width: int) -> Loop:
    block = flat_block(spoken)
    told = {"gate": NetworkGate, "answer": FieldAnswer, "seen": FieldFeatures, "posterior": Posterior}
    names = {prefix: names_of(record, prefix) for prefix, record in told.items()}
    shared = [name for name in block.inputs if not name.startswith(tuple(f"{prefix}." for prefix in told))]
    outputs = [name for name, _ in block.outputs]
    gates, said = outputs[: len(FIRST_GATE)], outputs[len(FIRST_GATE) :]
    lanes = best_lanes()
    return compiled_loop(
        LoopSpec(
            bodies=(block,),
            state=tuple(zip(names.pop("gate"), gates, strict=True)),
            constant=tuple(name for part in names.values() for name in part),
            uniform=tuple(shared),
            logged=tuple(said),
            lanes=lanes,
            vectors=width // lanes,
            strict=True,
        )
    )
